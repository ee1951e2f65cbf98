"""Reject HDF5 files that refer to other files or claim more values than their bytes can hold.

HDF5 follows soft, external and user-defined links, external storage and virtual datasets wherever the file
names them, and loads filters from plug-ins. A file from an unknown source could so expose any file that the
reader may open. A set's file needs none of these, so each link and dataset is checked before reading.
"""

from __future__ import annotations

import math

from h5py import h5d, h5f, h5g, h5l, h5o, h5t, h5z

_MOST_INFLATED = 1032
"""Maximum expansion of deflated data (zlib, technical details)."""
_FILTERS = {h5z.FILTER_SHUFFLE, h5z.FILTER_DEFLATE, h5z.FILTER_FLETCHER32}
_TYPES = {h5t.INTEGER, h5t.FLOAT, h5t.STRING}
_DEEPEST = 6
_SPARE_ROWS = 4096
"""Tables of missed records may be longer than those of the records."""


_DatasetInfo = tuple[str, int, tuple[int, ...], bool, bool]
"""Name, bytes in memory, shape (empty for compact datasets, at most 64 KB), whether it holds records, whether
floats."""


class RefusedError(OSError):
    """A file contains what no set's file has; an OSError, as HDF5 raises for corruption."""


def require_plain_file(file: h5f.FileID, n_bytes: int) -> None:
    """Check that an open file contains only what a set's file has, without following or reading any of it.

    Parameters
    ----------
    n_bytes
        Size of the file.

    Raises
    ------
    RefusedError
        A link or a dataset leads elsewhere or in a circle, has a filter or a type that no set has, or claims
        more than the file can hold.
    """
    root = h5g.open(file, b"/")
    pending, groups = [("", root)], {h5o.get_info(root).addr}
    datasets: list[_DatasetInfo] = []
    while pending:
        parent, group = pending.pop()
        for child in group:
            name = f"{parent}/{child.decode(errors='replace')}"
            if group.links.get_info(child).type != h5l.TYPE_HARD:
                raise RefusedError(f"{name!r} is a link to elsewhere, which is not followed")
            item = h5o.open(group, child)
            if isinstance(item, h5d.DatasetID):
                datasets.append(_check_dataset(name, item))
                continue
            address = h5o.get_info(item).addr
            if not isinstance(item, h5g.GroupID) or address in groups or name.count("/") > _DEEPEST:
                raise RefusedError(f"{name!r} is a type, or a circle of groups, or deeper than {_DEEPEST}")
            groups.add(address)
            pending.append((name, item))
    claimed = sum(n for _, n, _, _, _ in datasets)
    if claimed > _MOST_INFLATED * n_bytes:
        raise RefusedError(f"its arrays claim {claimed} bytes, more than a file of {n_bytes} can hold")
    # A column is no longer than what the records, each a chunk of its own, explain.
    records = [shape for _, n, shape, is_record, _ in datasets if is_record and n]
    rows = _SPARE_ROWS + sum(shape[0] for shape in records)
    longest_axis = max(rows, *(shape[1] for shape in records), 0)
    for name, _, shape, _, is_float in datasets:
        maximum = longest_axis if is_float and len(shape) == 1 else rows
        if len(shape) > 2 or max(shape[:1], default=0) > maximum:
            raise RefusedError(f"{name!r} has the shape {shape}; the records explain {maximum}")


def _check_dataset(name: str, dataset: h5d.DatasetID) -> _DatasetInfo:
    """Check layout, filters, type and size of a dataset without reading its values; return its description.

    Raises `RefusedError` if a set's file has no such dataset.
    """
    properties = dataset.get_create_plist()
    layout = properties.get_layout()
    if layout == h5d.VIRTUAL or properties.get_external_count():
        raise RefusedError(f"the values of {name!r} are in other files, which are not followed")
    stored_bytes = dataset.get_storage_size()
    if layout == h5d.COMPACT and stored_bytes:  # HDF5 itself compares its shape with its bytes
        return name, stored_bytes, (), False, False
    filters = [properties.get_filter(number)[0] for number in range(properties.get_nfilters())]
    if not _FILTERS.issuperset(filters) or len(set(filters)) < len(filters):
        raise RefusedError(f"{name!r} has filters {filters}; a set has shuffle, deflate and Fletcher32 only")
    data_type = dataset.get_type()
    kind = data_type.get_class()
    if kind not in _TYPES or (kind == h5t.STRING and data_type.is_variable_str()):
        raise RefusedError(f"{name!r} has a type that no set has: numbers and texts of fixed length only")
    shape = dataset.shape
    chunk = properties.get_chunk() if layout == h5d.CHUNKED else shape
    claimed = max(math.prod(shape), math.prod(chunk)) * data_type.get_size()
    if claimed > stored_bytes * (_MOST_INFLATED if h5z.FILTER_DEFLATE in filters else 1):
        raise RefusedError(f"{name!r} claims {claimed} bytes; the file stores {stored_bytes} for them")
    return name, claimed, shape, len(shape) == 2 and chunk == (1, shape[1]), kind == h5t.FLOAT
