"""Write and read NeXus files in memory through h5py's low-level API, for speed.

Checksums protect all data: large arrays are chunked with Fletcher32, and `daq_service.archive.chunk`
filters each chunk; small ones and attributes are in object headers, which have a checksum since HDF5 1.8
(format specification, version 2 object headers). The index of the chunks has none: a waveform that it
locates wrongly fails its CRC-32. Strings of datasets have a fixed length, because the heap of variable ones
has no checksum. Strings of attributes are variable, since readers return no others as text: they are names
and units, which `daq_service.archive.verification` compares with the rest of the file.

A dataset's axes are dimension scales, so that netCDF readers know dimensions by name.

Types and property lists never change and cost as much as writing a number, so they are made once.
"""

from __future__ import annotations

import struct
import uuid
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache, lru_cache
from typing import Any

import h5py
import numpy as np
from h5py import h5a, h5d, h5ds, h5f, h5g, h5p, h5s, h5t
from numpy.typing import NDArray

from daq_service.archive.chunk import GZIP_LEVEL, encode_chunk
from daq_service.archive.plain import require_plain_file
from hardware_drivers.units import find_unit

_LARGEST_COMPACT_BYTES = 8192
"""Small arrays are in their object header: faster than a chunk, and shorter than its index."""
_TEXT_STEP_BYTES = 16
"""Texts end with zeros up to a multiple of it, so that few structures occur (`daq_service.archive.draft`)."""
_BLOCK_BYTES = 1 << 20
_TEXT = h5py.string_dtype()
_AS_STORED = ("<", "|")
"""First characters of the types whose memory layout equals that of the file."""

_HEAP = b"GCOL\1\0\0\0"
_HEAP_OBJECT = struct.Struct("<H6xQ")
"""Index and length of what follows."""
_LONGEST_TEXT_BYTES = 4096
"""Names and units are far shorter; any number of attributes may lead to the same text."""

Attribute = str | int | float | Sequence[str] | np.generic | NDArray[Any]
Stored = tuple[NDArray[Any], h5t.TypeID]
"""Values in the form in which they are stored, and their HDF5 type."""


@contextmanager
def new_image() -> Iterator[h5f.FileID]:
    """Create an empty HDF5 file in memory for the block, which reads its bytes; close it afterwards."""
    access = _create_memory_access()
    creation = h5p.create(h5p.FILE_CREATE)
    creation.set_obj_track_times(False)
    # HDF5 identifies open files by name, those in memory too; the name is not stored.
    file = h5f.create(uuid.uuid4().hex.encode(), h5f.ACC_TRUNC, fcpl=creation, fapl=access)
    try:
        yield file
    finally:
        file.close()


def _create_memory_access() -> h5p.PropFAID:
    """Create the access properties of HDF5 files in memory, written in formats of HDF5 1.8 to 1.10."""
    access = h5p.create(h5p.FILE_ACCESS)
    access.set_fapl_core(_BLOCK_BYTES, False)
    # The oldest format with checksums everywhere, up to what tools of the last ten years read.
    access.set_libver_bounds(h5f.LIBVER_V18, h5f.LIBVER_V110)
    return access


def open_root(file: h5f.FileID) -> h5g.GroupID:
    """Open the root group of an HDF5 file and return it."""
    return h5g.open(file, b"/")


def read_image(file: h5f.FileID) -> bytes:
    """Flush an open HDF5 file in memory and return a copy of its bytes."""
    h5f.flush(file)
    return bytes(file.get_file_image())


def open_image(image: bytes, *, is_own: bool = False, writable: bool = False) -> h5f.FileID:
    """Open the bytes of a file in memory, for reading unless ``writable``; the caller closes it.

    Parameters
    ----------
    is_own
         This process made the bytes, so they are not checked for links and sizes.

    Raises
    ------
    OSError
        It is damaged, or contains what no set's file has (`daq_service.archive.plain`).
    """
    if not is_own:
        require_finite_heaps(image)
    access = _create_memory_access()
    access.set_file_image(image)
    file = h5f.open(uuid.uuid4().hex.encode(), h5f.ACC_RDWR if writable else h5f.ACC_RDONLY, fapl=access)
    try:
        if not is_own:
            require_plain_file(file, len(image))
    except BaseException:
        file.close()
        raise
    return file


def require_finite_heaps(image: bytes) -> None:
    """Raise OSError for a file whose string heaps would make HDF5 loop forever or return endless texts.

    HDF5 steps from object to object of a global heap by the length in each (format specification, III.E)
    without checking it: in a page of zeros it loops forever. ``image`` holds the bytes of the file.

    Raises
    ------
    OSError
        The length of an object is zero, exceeds its heap, or exceeds any name; HDF5 raises the same class.
    """
    heap = image.find(_HEAP)
    while heap >= 0:
        offset, end = heap + 16, min(heap + int.from_bytes(image[heap + 8 : heap + 16], "little"), len(image))
        while offset + _HEAP_OBJECT.size <= end:
            index, length = _HEAP_OBJECT.unpack_from(image, offset)
            # Object 0 is the free space, header included; the others are padded to eight bytes.
            step = _HEAP_OBJECT.size + (length + 7) // 8 * 8 if index else length
            if not 0 < step <= end - offset or (index and length > _LONGEST_TEXT_BYTES):
                raise OSError(f"the object at byte {offset} of a heap of strings has the length {length}")
            offset += step
        heap = image.find(_HEAP, heap + 1)


def add_group(
    parent: h5g.GroupID, name: str, nx_class: str, attributes: Mapping[str, Attribute] | None = None
) -> h5g.GroupID:
    """Create a group with its NeXus class as attribute ``NX_class`` and return it.

    Raises ValueError if the name exists.
    """
    return create_group(parent, name, {"NX_class": nx_class, **(attributes or {})})


def create_group(parent: h5g.GroupID, name: str, attributes: Mapping[str, Attribute]) -> h5g.GroupID:
    """Create a group with attributes, without a time of creation, and return it; ValueError if it exists."""
    group = h5g.create(parent, name.encode(), gcpl=_create_group_properties())
    add_attributes(group, attributes)
    return group


def add_field(
    parent: h5g.GroupID,
    name: str,
    values: Any,
    *,
    chunk: tuple[int, ...] | None = None,
    axes: Sequence[h5d.DatasetID] = (),
    is_axis: bool = False,
    **attributes: Attribute,
) -> h5d.DatasetID:
    """Create a dataset of numbers or strings with its values and return it; ValueError if the name exists.

    Parameters
    ----------
    values
        Array or scalar of a NumPy type, a string, or a list of strings.
    chunk
        Its first length divides that of the values, the others are equal to theirs. None: one chunk above
        8192 bytes, else compact storage.
    axes
        One for each dimension, or none.
    is_axis
         Make it a dimension scale for other datasets.
    """
    stored = to_stored_form(values)
    dataset = create_field(parent, name, stored, chunk, axes, is_axis, attributes)
    write_field(dataset, stored, chunk)
    return dataset


def add_columns(
    group: h5g.GroupID, columns: Mapping[str, NDArray[Any] | list[str]], *, axis: h5d.DatasetID | None = None
) -> h5d.DatasetID | None:
    """Add a dataset per column with its unit; return the axis, which without ``axis`` is the first column.

    Columns have a value per row of the axis.
    """
    for name, values in columns.items():
        field = add_field(group, name, values, axes=[] if axis is None else [axis], is_axis=axis is None)
        axis = field if axis is None else axis
        add_attributes(field, {"units": find_unit(name)} if find_unit(name) else {})
    return axis


def create_field(
    parent: h5g.GroupID,
    name: str,
    stored: Stored,
    chunk: tuple[int, ...] | None,
    axes: Sequence[h5d.DatasetID],
    is_axis: bool,
    attributes: Mapping[str, Attribute],
) -> h5d.DatasetID:
    """Create a dataset with attributes and axes, without values, and return it; arguments as in `add_field`.

    ``stored`` has the array and its HDF5 type, of which only type and shape are used.
    """
    array, data_type = stored
    chunk = choose_chunk(array, chunk)
    properties = _create_compact_properties() if chunk is None else _create_chunked_properties(chunk)
    dataset = h5d.create(parent, name.encode(), data_type, _to_space(array.shape), dcpl=properties)
    if array.dtype.kind == "S":
        # Else xarray returns bytes (netCDF's convention for text of fixed length).
        attributes = {"_Encoding": "utf-8", **attributes}
    add_attributes(dataset, attributes)
    if is_axis:
        h5ds.set_scale(dataset, name.encode())
    for dimension, axis in enumerate(axes):
        h5ds.attach_scale(dataset, axis, dimension)
    return dataset


def write_field(dataset: h5d.DatasetID, stored: Stored, chunk: tuple[int, ...] | None) -> None:
    """Write all values to a dataset, in place of its present ones.

    Its shape, type and chunk must be those of ``stored``.
    """
    array, data_type = stored
    chunk = choose_chunk(array, chunk)
    if chunk is None:
        dataset.write(h5s.ALL, h5s.ALL, array, mtype=data_type)
    else:
        write_chunks(dataset, array, chunk)


def choose_chunk(array: NDArray[Any], chunk: tuple[int, ...] | None) -> tuple[int, ...] | None:
    """Return the given chunk, else the shape of an array above 8192 bytes; None for compact storage."""
    return array.shape if chunk is None and array.nbytes > _LARGEST_COMPACT_BYTES and array.ndim else chunk


def write_chunks(dataset: h5d.DatasetID, array: NDArray[Any], chunk: tuple[int, ...]) -> None:
    """Write an array of the stored type as filtered chunks of shape ``chunk`` along its first axis."""
    for first in range(0, array.shape[0], chunk[0]):
        offset = (first, *(0 for _ in chunk[1:]))
        dataset.write_direct_chunk(offset, encode_chunk(array[first : first + chunk[0]]))


def read_field(parent: h5g.GroupID, name: str) -> NDArray[Any]:
    """Read a complete dataset as an array of its shape, strings as bytes; KeyError if it is missing.

    Much faster than h5py's high-level API for small datasets.
    """
    dataset = h5d.open(parent, name.encode())
    array = np.empty(dataset.shape, dtype=dataset.dtype)
    dataset.read(h5s.ALL, h5s.ALL, array)
    return array


def add_attributes(target: h5g.GroupID | h5d.DatasetID, attributes: Mapping[str, Attribute]) -> None:
    """Create attributes of a group or dataset; OSError if one of the names exists.

    Texts get strings of variable length, a list of texts a 1-D array; numbers are stored little-endian.
    """
    for name, value in attributes.items():
        if isinstance(value, str) or (isinstance(value, Sequence) and all(isinstance(v, str) for v in value)):
            text = np.array(value, dtype=_TEXT)
            attribute = h5a.create(target, name.encode(), _create_variable_type(), _to_space(text.shape))
            attribute.write(text, mtype=_create_number_type(_TEXT))
        else:
            array, data_type = to_stored_form(value)
            h5a.create(target, name.encode(), data_type, _to_space(array.shape)).write(array, mtype=data_type)


@cache
def _create_variable_type() -> h5t.TypeID:
    """Create the HDF5 type of UTF-8 strings of variable length, as attributes have it; cached."""
    return h5t.py_create(_TEXT, logical=True)


def to_stored_form(values: object) -> Stored:
    """Convert values to array and HDF5 type as stored: fixed-length UTF-8, or little-endian numbers."""
    if isinstance(values, str):
        return _encode_text(values)
    if isinstance(values, Sequence) and all(isinstance(v, str) for v in values):
        return _encode_texts([text.encode() for text in values])
    array = np.asarray(values)
    if not (array.dtype.str.startswith(_AS_STORED) and array.flags.c_contiguous):
        array = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<")).reshape(array.shape)
    return array, _create_number_type(array.dtype)


@lru_cache(maxsize=1024)
def _encode_text(text: str) -> Stored:
    """Encode a text as fixed-length array and HDF5 type; the 1024 last are cached, since names repeat."""
    return _encode_texts(text.encode())


def _encode_texts(values: bytes | list[bytes]) -> Stored:
    """Encode UTF-8 texts as array and HDF5 type, filled with zeros to a common multiple of 16 bytes.

    There is at least one zero at the end of each.
    """
    length = len(values) if isinstance(values, bytes) else max(map(len, values), default=0)
    n_bytes = (length // _TEXT_STEP_BYTES + 1) * _TEXT_STEP_BYTES
    return np.array(values, dtype=f"S{n_bytes}"), _create_text_type(n_bytes)


@lru_cache(maxsize=256)
def _create_text_type(n_bytes: int) -> h5t.TypeID:
    """Create the HDF5 type of zero-terminated UTF-8 strings of ``n_bytes`` bytes; cached."""
    data_type = h5t.C_S1.copy()
    data_type.set_size(n_bytes)
    data_type.set_cset(h5t.CSET_UTF8)
    data_type.set_strpad(h5t.STR_NULLTERM)
    return data_type


@cache
def _create_number_type(dtype: np.dtype[Any]) -> h5t.TypeID:
    """Create the HDF5 type of a NumPy type; cached. TypeError if HDF5 has none."""
    return h5t.py_create(dtype)


@cache
def _create_group_properties() -> h5p.PropGCID:
    """Create the creation properties of groups, without times; cached."""
    properties = h5p.create(h5p.GROUP_CREATE)
    properties.set_obj_track_times(False)
    return properties


@cache
def _create_compact_properties() -> h5p.PropDCID:
    """Create the creation properties of datasets that are stored in object headers; cached."""
    properties = h5p.create(h5p.DATASET_CREATE)
    # A file's bytes depend on its content alone, not on the moment of writing.
    properties.set_obj_track_times(False)
    properties.set_layout(h5d.COMPACT)
    return properties


@lru_cache(maxsize=256)
def _create_chunked_properties(chunk: tuple[int, ...]) -> h5p.PropDCID:
    """Create the creation properties of datasets with filtered, checksummed chunks; cached."""
    properties = h5p.create(h5p.DATASET_CREATE)
    properties.set_obj_track_times(False)
    properties.set_fill_time(h5d.FILL_TIME_NEVER)
    properties.set_chunk(chunk)
    properties.set_shuffle()
    properties.set_deflate(GZIP_LEVEL)
    properties.set_fletcher32()
    return properties


@lru_cache(maxsize=256)
def _to_space(shape: tuple[int, ...]) -> h5s.SpaceID:
    """Create the HDF5 dataspace of a shape, a scalar one for (); cached."""
    return h5s.create_simple(shape) if shape else h5s.create(h5s.SCALAR)
