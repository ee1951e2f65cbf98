"""Formats of an exported table. Streamed ones hold a page in memory, whole ones all rows.

============ ===========================================================================================
csv          RFC 4180: one header, units in the names; an empty cell is not available
parquet      null is not available; units in the fields' metadata, facts in the schema's (key ``solimon``)
arrow        the same as an Arrow IPC stream
npz          an array a column, and ``solimon``: the facts as JSON text
mat          MATLAB 5: a struct of columns named as the table, a struct ``units``, and ``facts`` as JSON text
h5           NXdata of the first chosen number over the hour, as silx and H5Web plot it
============ ===========================================================================================

In the last three a missing number is NaN, a missing integer or truth value -1, a missing text empty.
"""

from __future__ import annotations

import csv
import io
import json
import re
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from daq_service.archive.table_file import build_table_image
from daq_service.catalogue.published_columns import Form, PublishedColumn
from daq_service.errors import UsageError
from daq_service.settings.foreign_text import escape_spreadsheet_cell
from daq_service.web.tables.choice import Choice, Columns

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

MATLAB_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,62}")
_ARROW = {"number": "float64", "integer": "int64", "truth": "bool_"}

Arrow = Any
"""The package pyarrow, or a part of it: it has no types."""
Array = NDArray[np.generic]
Facts = Mapping[str, object]
Write = Callable[[Choice, Facts, Iterable[Columns]], Iterator[bytes]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Format:
    """File format; ``whole``: all rows are in memory while it is written."""

    media_type: str
    whole: bool
    write: Write


def format_facts(facts: Facts) -> str:
    """Serialize the facts of a file as JSON text with sorted keys."""
    return json.dumps(facts, sort_keys=True)


def _write_csv(choice: Choice, facts: Facts, pages: Iterable[Columns]) -> Iterator[bytes]:
    """Encode a table as CSV with a header row (UTF-8) and yield the bytes of each page; None is empty."""
    names = [column.name for column in choice.columns]
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(names)
    for page in pages:
        columns = [[format_cell(value) for value in page[name]] for name in names]
        writer.writerows(zip(*columns, strict=True))
        yield text.getvalue().encode()
        text.seek(0)
        text.truncate()


def format_cell(value: object) -> str:
    """Format a value as text of a CSV cell; None is empty, and spreadsheet formulas are escaped."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return escape_spreadsheet_cell(value)
    return repr(value) if isinstance(value, float) else str(value)


class _Drain(io.RawIOBase):
    """Buffer between a writer and the response, emptied after each page."""

    def __init__(self) -> None:
        self._waiting = bytearray()
        self._place = 0

    def writable(self) -> bool:
        """Return True: libraries may write to this file object."""
        return True

    def write(self, content: ReadableBuffer) -> int:
        """Append bytes to the buffer; return their number."""
        n_bytes = len(memoryview(content).cast("B"))
        self._waiting += content
        self._place += n_bytes
        return n_bytes

    def tell(self) -> int:
        """Return the number of bytes written so far, drained ones included."""
        return self._place

    def drain_bytes(self) -> bytes:
        """Return the bytes since the last call and clear the buffer."""
        content = bytes(self._waiting)
        self._waiting.clear()
        return content


def _create_arrow_writer(kind: str) -> Write:
    """Return the function that writes tables in the format ``kind``, ``parquet`` or ``arrow``."""

    def write_arrow(choice: Choice, facts: Facts, pages: Iterable[Columns]) -> Iterator[bytes]:
        """Encode a table and yield the bytes of each page; raise UsageError without pyarrow."""
        arrow = import_pyarrow()
        schema = arrow.schema(
            [build_arrow_field(arrow, column) for column in choice.columns],
            metadata={"solimon": format_facts(facts)},
        )
        batches = ([to_arrow(arrow, field.type, page[field.name]) for field in schema] for page in pages)
        yield from encode_arrow(arrow, kind, schema, batches)

    return write_arrow


def encode_arrow(
    arrow: Arrow, form: str, schema: Arrow, batches: Iterable[Sequence[Arrow]]
) -> Iterator[bytes]:
    """Encode batches as ``parquet`` or ``arrow`` (``form``) and yield the bytes written after each batch.

    The last part ends the file. Each batch has one array per field of the schema.
    """
    drain = _Drain()
    if form == "parquet":
        from pyarrow import parquet

        writing = parquet.ParquetWriter(drain, schema)
    else:
        writing = arrow.ipc.new_stream(drain, schema)
    with writing as writer:
        for arrays in batches:
            writer.write(arrow.record_batch(arrays, schema=schema))
            yield drain.drain_bytes()
    yield drain.drain_bytes()


def build_arrow_field(arrow: Arrow, column: PublishedColumn) -> Arrow:
    """Build the Arrow field of a column, with its unit as metadata; times are UTC in ns."""
    kind = arrow.timestamp("ns", tz="UTC") if column.form == "time" else None
    kind = kind or getattr(arrow, _ARROW.get(column.form, "string"))()
    return arrow.field(column.name, kind, metadata={"unit": column.unit} if column.unit else None)


def to_arrow(arrow: Arrow, of_type: Arrow, values: Sequence[object]) -> Arrow:
    """Convert the values of a column to an Arrow array of a type; None becomes null.

    RFC 3339 text is converted if the type is a time. Raises a pyarrow error for a value of another type.
    """
    if arrow.types.is_timestamp(of_type):
        return arrow.array(values, type=arrow.string()).cast(of_type)
    return arrow.array(values, type=of_type)


def import_pyarrow(otherwise: str = "take csv, npz, mat or h5") -> Arrow:
    """Import and return the package pyarrow.

    Raises
    ------
    UsageError
        The package is not installed; the message names the alternative ``otherwise``.
    """
    try:
        import pyarrow as arrow
    except ImportError as error:
        raise UsageError(
            "Parquet and Arrow need the package pyarrow, which is not installed: pip install "
            f"'solimon[parquet]', or {otherwise}"
        ) from error
    return arrow


def _collect_arrays(columns: Sequence[PublishedColumn], pages: Iterable[Columns]) -> dict[str, Array]:
    """Join all pages of a table to one array of shape (rows,) per column; raise ValueError without a page."""
    parts = [[to_array(column.form, page[column.name]) for column in columns] for page in pages]
    joined = [np.concatenate(of_column) for of_column in zip(*parts, strict=True)]
    return dict(zip([column.name for column in columns], joined, strict=True))


def to_array(form: Form, values: list[object]) -> Array:
    """Convert the values of a column to an array of shape (rows,); missing ones are NaN, -1 or empty.

    The type is float64, int64, int8 (truth values) or text.
    """
    if form == "number":
        return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
    if form in ("integer", "truth"):
        numbers = [-1 if value is None else value for value in values]
        return np.array(numbers, dtype=np.int64 if form == "integer" else np.int8)
    return np.array(["" if value is None else value for value in values], dtype=np.str_)


def convert_texts_for_h5py(array: Array) -> Array | list[str]:
    """Convert an array of texts to a list, as h5py needs it; return other arrays unchanged."""
    return [str(text) for text in array] if array.dtype.kind == "U" else array


def _write_npz(choice: Choice, facts: Facts, pages: Iterable[Columns]) -> Iterator[bytes]:
    """Encode a table as NumPy file and yield its bytes as one part."""
    yield build_npz(_collect_arrays(choice.columns, pages), facts)


def build_npz(arrays: Mapping[str, Array], facts: Facts) -> bytes:
    """Return the bytes of a compressed NumPy file with an array per name and the facts as ``solimon``."""
    content = io.BytesIO()
    # `numpy.savez` has parameters of its own, such as ``file``, which is a column of sets.
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as members:
        for name, array in {**arrays, "solimon": np.array(format_facts(facts))}.items():
            with members.open(f"{name}.npy", "w") as member:
                np.lib.format.write_array(member, array, allow_pickle=False)
    return content.getvalue()


def _write_mat(choice: Choice, facts: Facts, pages: Iterable[Columns]) -> Iterator[bytes]:
    """Encode a table as MATLAB 5 file and yield its bytes as one part."""
    units = {column.name: column.unit for column in choice.columns if column.unit}
    yield build_mat(choice.table, _collect_arrays(choice.columns, pages), units, facts)


def build_mat(name: str, arrays: Mapping[str, Array], units: Mapping[str, str], facts: Facts) -> bytes:
    """Return the bytes of a MATLAB 5 file: a struct ``name`` of arrays, a struct ``units``, and ``facts``.

    Texts become cells.
    """
    # Imports SciPy only here: it would delay the start of a service by half a second.
    from scipy.io import savemat

    content = io.BytesIO()
    columns = {
        # Texts become cells: MATLAB would pad the rows of a matrix of letters with blanks.
        key: array.astype(np.object_) if array.dtype.kind == "U" else array
        for key, array in arrays.items()
    }
    stored = {name: columns, "units": units, "facts": format_facts(facts)}
    savemat(content, stored, long_field_names=True, oned_as="column", do_compression=True)
    return content.getvalue()


def _write_hdf5(choice: Choice, facts: Facts, pages: Iterable[Columns]) -> Iterator[bytes]:
    """Encode a table as HDF5 file and yield its bytes as one part.

    The default plot is the first chosen number over the hour; none without a number.
    """
    arrays = _collect_arrays(choice.columns, pages)
    names = choice.chosen or tuple(arrays)
    numbers = [c.name for c in choice.columns if c.form == "number" and c.unit != "h" and c.name in names]
    hours = next(name for name in ("due_h", "raised_h", "from_h") if name in arrays)
    yield build_table_image(
        choice.table,
        {name: convert_texts_for_h5py(array) for name, array in arrays.items()},
        signal=numbers[0] if numbers else None,
        axis=hours,
        facts_text=format_facts(facts),
    )


FORMATS: Mapping[str, Format] = {
    "csv": Format(media_type="text/csv", whole=False, write=_write_csv),
    "parquet": Format(
        media_type="application/vnd.apache.parquet", whole=False, write=_create_arrow_writer("parquet")
    ),
    "arrow": Format(
        media_type="application/vnd.apache.arrow.stream", whole=False, write=_create_arrow_writer("arrow")
    ),
    "npz": Format(media_type="application/x-npz", whole=True, write=_write_npz),
    "mat": Format(media_type="application/x-matlab-data", whole=True, write=_write_mat),
    "h5": Format(media_type="application/x-hdf5", whole=True, write=_write_hdf5),
}


def list_available_formats() -> list[str]:
    """Return the names of the formats that this installation can write; two need pyarrow."""
    from importlib.util import find_spec

    return [name for name in FORMATS if name not in ("parquet", "arrow") or find_spec("pyarrow")]
