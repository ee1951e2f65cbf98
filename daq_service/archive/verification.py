"""Look at every byte of a set's file that carries meaning; nothing is written."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from daq_service.archive.errors import CorruptArchiveError, SetNotFoundError
from daq_service.archive.layout import build_image
from daq_service.archive.nexus import opened_image
from daq_service.archive.reader import HDF5_ERRORS, examine, read_stored, unreadable_parts
from daq_service.archive.records import Damage, SetRecord

log = logging.getLogger(__name__)

_PREVIEW_TOLERANCE = 1e-6
"""Of the largest value: a mean in another order of summation, as 32-bit floats."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CheckedFile:
    """A set's file as it was found.

    Attributes
    ----------
    record
        What can be read of it; None: nothing.
    damages
        What cannot, or contradicts itself.
    touched
        Its SHA-256 is not the one that is known of it.
    sha256
        What it is; empty where the file cannot be read.
    """

    n_bytes: int
    record: SetRecord | None
    damages: list[Damage]
    touched: bool = False
    sha256: str = ""


def check_file(path: Path, *, sha256: str | None = None) -> CheckedFile:
    """Read a set's file to the last byte.

    Parameters
    ----------
    sha256
        Of the file as it was written, in hexadecimal. None: it is not known; then the file is made anew from
        its own records and compared, so that what it says twice (axes, factors, previews) must agree.

    Raises
    ------
    SetNotFoundError
        There is no such file.
    """
    try:
        content = read_stored(path)
    except FileNotFoundError as error:
        raise SetNotFoundError(f"there is no file {path}") from error
    except OSError as error:
        return CheckedFile(
            n_bytes=0, record=None, damages=[Damage(reason=f"it cannot be read ({error.strerror or error})")]
        )
    found = hashlib.sha256(content).hexdigest()
    touched = sha256 is not None and found != sha256
    try:
        record, damages = examine(path, content)
        made = None if record is None or damages or sha256 is not None else _made(record)
        # Else every byte is the one that was written, or that these records make.
        if damages or touched or (sha256 is None and made != content):
            damages += unreadable_parts(path, content)
            if not damages and not touched:
                damages = [Damage(reason=told) for told in _contradictions(content, made)]
    except CorruptArchiveError as error:
        record, damages = None, [Damage(reason=str(error.__cause__ or error))]
    return CheckedFile(n_bytes=len(content), record=record, damages=damages, touched=touched, sha256=found)


def _made(record: SetRecord) -> bytes | None:
    """Make the file anew; None: of what was read no file can be made."""
    try:
        return build_image(record)
    except Exception as error:  # noqa: BLE001 - a damaged name or length can break any step of it
        log.debug("no file can be made of what was read: %s", error)
        return None


def damage_of(path: Path, sha256: str | None = None) -> tuple[str, str]:
    """Say what is damaged in a set's file, empty: nothing, and its SHA-256; see `check_file`."""
    found = check_file(path, sha256=sha256)
    told = [str(damage) for damage in found.damages]
    touched = ["its SHA-256 is not that of the file that was written"] if found.touched else []
    return "; ".join([*touched, *told]), found.sha256


def _contradictions(content: bytes, made: bytes | None) -> list[str]:
    """Compare a file, value by value, with the one that its own records make.

    Another version of a library packs the same values into other bytes; then flips in bytes that hold
    nothing pass unseen.
    """
    if made is None:
        return ["what can be read of it makes no set"]
    try:
        with (
            h5py.File(opened_image(content)) as found,
            h5py.File(opened_image(made, is_own=True)) as expected,
        ):
            values, wanted = _values(found), _values(expected)
            same_format = found.attrs["solimon_format_version"] == expected.attrs["solimon_format_version"]
    except HDF5_ERRORS as error:
        return [f"the structure of the file is damaged ({error})"]
    return [
        f"{name} is not what the rest of the file says"
        for name in sorted({*values, *wanted} if same_format else values)
        if not _alike(name, values, wanted, same_format=same_format)
    ]


def _values(file: h5py.File) -> dict[str, Any]:
    """Every array and attribute by its path, the version of the format left out."""
    found: dict[str, Any] = {}

    def add(name: str, item: Any) -> None:
        # An axis tells in REFERENCE_LIST which arrays it belongs to: what their DIMENSION_LIST says already.
        attributes = {key: value for key, value in item.attrs.items() if key != "REFERENCE_LIST"}
        found.update({f"{name}@{key}": _plain(file, value) for key, value in attributes.items()})
        found[name] = _plain(file, item[()]) if isinstance(item, h5py.Dataset) else None

    add("", file)
    file.visititems(add)
    found.pop("@solimon_format_version", None)
    return found


def _plain(file: h5py.File, value: Any) -> Any:
    """Text however it is stored, a reference as the name of what it leads to, numbers as an array."""
    if isinstance(value, h5py.Reference):
        return file[value].name
    if isinstance(value, bytes):
        return value.decode(errors="replace")
    if isinstance(value, np.ndarray) and value.dtype.kind in "SO":
        return [_plain(file, part) for part in value.flat]
    return value if isinstance(value, str) else np.asarray(value)


def _alike(name: str, found: Mapping[str, Any], expected: Mapping[str, Any], *, same_format: bool) -> bool:
    if not same_format and "@" in name and (name not in expected or str(found.get(name)) == ""):
        return True  # a label that is not written any more, or was left empty
    if name not in found or name not in expected:
        return False
    left, right = found[name], expected[name]
    if not (isinstance(left, np.ndarray) and isinstance(right, np.ndarray)):
        return type(left) is type(right) and bool(left == right)
    if "/preview/" in name and "@" not in name and left.shape == right.shape and left.dtype == right.dtype:
        scale = float(np.max(np.abs(right), initial=0.0))
        return bool(np.all(np.abs(left - right) <= _PREVIEW_TOLERANCE * scale))
    return (left.dtype, left.shape, left.tobytes()) == (right.dtype, right.shape, right.tobytes())
