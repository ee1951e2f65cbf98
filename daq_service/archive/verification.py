"""Check every meaningful byte of a set's file for corruption; nothing is written."""

from __future__ import annotations

import hashlib
import logging
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from daq_service.archive.errors import CorruptArchiveError, SetNotFoundError
from daq_service.archive.layout import build_set_image
from daq_service.archive.nexus import open_image
from daq_service.archive.reader import HDF5_ERRORS, examine_file, list_unreadable_parts, read_regular_file
from daq_service.archive.records import Damage
from hardware_drivers.measurement import SetRecord

log = logging.getLogger(__name__)

_FACTS_OF_POSITION = re.compile(r"entry/[^/@]+_(truth|settings)(/|$)")
_PREVIEW_TOLERANCE = 1e-6
"""Relative to the largest value: a mean summed in another order, as 32-bit floats."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CheckedFile:
    """Result of a check of a set's file.

    Attributes
    ----------
    record
         Readable part of the set; None if nothing is readable.
    damages
         Unreadable or contradictory parts.
    touched
         Its SHA-256 differs from the known one.
    sha256
         Its SHA-256; empty if the file cannot be read.
    """

    n_bytes: int
    record: SetRecord | None
    damages: list[Damage]
    touched: bool = False
    sha256: str = ""


def check_set_file(path: Path, *, sha256: str | None = None) -> CheckedFile:
    """Check a set's file to the last byte; list what is corrupt or contradictory instead of raising.

    Parameters
    ----------
    sha256
        SHA-256 of the file as written, in hexadecimal. None: unknown; then the file is rebuilt from its
        records and compared, so that redundant values (axes, factors, previews) must agree.

    Raises
    ------
    SetNotFoundError
        There is no such file.
    """
    try:
        content = read_regular_file(path)
    except FileNotFoundError as error:
        raise SetNotFoundError(f"there is no file {path}") from error
    except OSError as error:
        return CheckedFile(
            n_bytes=0, record=None, damages=[Damage(reason=f"it cannot be read ({error.strerror or error})")]
        )
    digest = hashlib.sha256(content).hexdigest()
    touched = sha256 is not None and digest != sha256
    try:
        record, damages = examine_file(path, content)
        rebuilt = None if record is None or damages or sha256 is not None else _rebuild_file(record)
        # Otherwise every byte equals the one that was written or rebuilt.
        if damages or touched or (sha256 is None and rebuilt != content):
            damages += list_unreadable_parts(path, content)
            if not damages and not touched:
                damages = [Damage(reason=reason) for reason in _list_contradictions(content, rebuilt)]
    except CorruptArchiveError as error:
        record, damages = None, [Damage(reason=str(error.__cause__ or error))]
    return CheckedFile(n_bytes=len(content), record=record, damages=damages, touched=touched, sha256=digest)


def _rebuild_file(record: SetRecord) -> bytes | None:
    """Rebuild the bytes of a set's file from its record; None, with a debug message, if any step fails."""
    try:
        return build_set_image(record)
    except Exception as error:  # noqa: BLE001 - a corrupt name or length can break any step of it
        log.debug("no file can be made of what was read: %s", error)
        return None


def describe_damage(path: Path, sha256: str | None = None) -> tuple[str, str]:
    """Describe the damage of a set file (empty: none) and compute its SHA-256; see `check_set_file`.

    Raises SetNotFoundError if there is no file; the SHA-256 is empty if it cannot be read.
    """
    checked = check_set_file(path, sha256=sha256)
    damages = [str(damage) for damage in checked.damages]
    touched = ["its SHA-256 is not that of the file that was written"] if checked.touched else []
    return "; ".join([*touched, *damages]), checked.sha256


def _list_contradictions(content: bytes, rebuilt: bytes | None) -> list[str]:
    """List the values in which a file differs from the one rebuilt from its records (None: not possible).

    Another version of a library may encode equal values in other bytes; then changes of unused bytes are
    not found, and the list is empty.
    """
    if rebuilt is None:
        return ["what can be read of it makes no set"]
    try:
        with (
            h5py.File(open_image(content)) as stored,
            h5py.File(open_image(rebuilt, is_own=True)) as expected,
        ):
            values, expected_values = _read_values(stored), _read_values(expected)
            same_format = stored.attrs["solimon_format_version"] == expected.attrs["solimon_format_version"]
    except HDF5_ERRORS as error:
        return [f"the structure of the file is damaged ({error})"]
    return [
        f"{name} does not match the rest of the file"
        for name in sorted({*values, *expected_values} if same_format else values)
        if not _equals(name, values, expected_values, same_format=same_format)
    ]


def _read_values(file: h5py.File) -> dict[str, Any]:
    """Read every array and attribute of a file by its path (``path@name``), without the format version.

    Groups have the value None. Raises one of `HDF5_ERRORS`.
    """
    values: dict[str, Any] = {}

    def add_item(name: str, item: Any) -> None:
        # The REFERENCE_LIST of an axis repeats the DIMENSION_LIST of the arrays that it belongs to.
        """Add the attributes of an item, and the values of a dataset, to the values by path."""
        attributes = {key: value for key, value in item.attrs.items() if key != "REFERENCE_LIST"}
        values.update({f"{name}@{key}": _to_comparable(file, value) for key, value in attributes.items()})
        values[name] = _to_comparable(file, item[()]) if isinstance(item, h5py.Dataset) else None

    add_item("", file)
    file.visititems(add_item)
    values.pop("@solimon_format_version", None)
    return values


def _to_comparable(file: h5py.File, value: object) -> object:
    """Convert a value for comparison: texts to str, references to target names, other values to arrays."""
    if isinstance(value, h5py.Reference):
        return file[value].name
    if isinstance(value, bytes):
        return value.decode(errors="replace")
    if isinstance(value, np.ndarray) and value.dtype.kind in "SO":
        return [_to_comparable(file, part) for part in value.flat]
    return value if isinstance(value, str) else np.asarray(value)


def _equals(name: str, stored: Mapping[str, Any], expected: Mapping[str, Any], *, same_format: bool) -> bool:
    """Return whether the values at the path ``name`` of a stored and an expected file agree.

    Previews may differ by 1e-6 of their largest value, all else not at all. With another format version,
    labels that are empty or not written any more, and truth or settings in groups of a position, count as
    equal.
    """
    if not same_format and "@" in name and (name not in expected or str(stored.get(name)) == ""):
        return True  # a label that is not written any more, or was left empty
    if not same_format and name not in expected and _FACTS_OF_POSITION.match(name):
        return True  # up to format 1.6; its values are in the rebuilt tables, and headers have checksums
    if name not in stored or name not in expected:
        return False
    value, wanted = stored[name], expected[name]
    if not (isinstance(value, np.ndarray) and isinstance(wanted, np.ndarray)):
        return type(value) is type(wanted) and bool(value == wanted)
    if (
        "/preview/" in name
        and "@" not in name
        and value.shape == wanted.shape
        and value.dtype == wanted.dtype
    ):
        scale = float(np.max(np.abs(wanted), initial=0.0))
        return bool(np.all(np.abs(value - wanted) <= _PREVIEW_TOLERANCE * scale))
    return (value.dtype, value.shape, value.tobytes()) == (wanted.dtype, wanted.shape, wanted.tobytes())
