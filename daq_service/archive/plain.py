"""Refuse HDF5 files that lead to other files, or claim more values than their bytes can hold.

HDF5 follows soft, external and user-defined links, external storage and virtual datasets wherever the file
names them, and loads filters from plug-ins. A file of a stranger could so show any file that the reader may
open. A set's file needs none of that, so each link and dataset is looked at before the first value is read.
"""

from __future__ import annotations

import math

from h5py import h5d, h5f, h5g, h5l, h5o, h5t, h5z

_MOST_INFLATED = 1032
"""No deflated run holds more bytes for each of its own (zlib, technical details)."""
_FILTERS = {h5z.FILTER_SHUFFLE, h5z.FILTER_DEFLATE, h5z.FILTER_FLETCHER32}
_TYPES = {h5t.INTEGER, h5t.FLOAT, h5t.STRING}
_DEEPEST = 6
_SPARE_ROWS = 4096
"""Tables of what left no record may be longer than those of the records."""


_Found = tuple[str, int, tuple[int, ...], bool, bool]
"""Name, bytes in memory, shape (none of what lies in the object header: 64 KB at the most), whether it holds
records, whether floats."""


class RefusedError(OSError):
    """A file is no plain one; as HDF5 raises where it finds damage by itself."""


def require_plain(file: h5f.FileID, n_bytes: int) -> None:
    """Refuse what no set's file has, without following or reading any of it.

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
    found: list[_Found] = []
    while pending:
        place, group = pending.pop()
        for key in group:
            name = f"{place}/{key.decode(errors='replace')}"
            if group.links.get_info(key).type != h5l.TYPE_HARD:
                raise RefusedError(f"{name!r} is a link to elsewhere, which is not followed")
            item = h5o.open(group, key)
            if isinstance(item, h5d.DatasetID):
                found.append(_looked_at(name, item))
                continue
            address = h5o.get_info(item).addr
            if not isinstance(item, h5g.GroupID) or address in groups or name.count("/") > _DEEPEST:
                raise RefusedError(f"{name!r} is a type, or a circle of groups, or deeper than {_DEEPEST}")
            groups.add(address)
            pending.append((name, item))
    claimed = sum(n for _, n, _, _, _ in found)
    if claimed > _MOST_INFLATED * n_bytes:
        raise RefusedError(f"its arrays claim {claimed} bytes, more than a file of {n_bytes} can hold")
    # A column is no longer than what the records, each a chunk of its own, explain.
    records = [shape for _, n, shape, is_record, _ in found if is_record and n]
    rows = _SPARE_ROWS + sum(shape[0] for shape in records)
    longest_axis = max(rows, *(shape[1] for shape in records), 0)
    for name, _, shape, _, is_float in found:
        most = longest_axis if is_float and len(shape) == 1 else rows
        if len(shape) > 2 or max(shape[:1], default=0) > most:
            raise RefusedError(f"{name!r} has the shape {shape}; the records explain {most}")


def _looked_at(name: str, dataset: h5d.DatasetID) -> _Found:
    made = dataset.get_create_plist()
    layout = made.get_layout()
    if layout == h5d.VIRTUAL or made.get_external_count():
        raise RefusedError(f"the values of {name!r} are in other files, which are not followed")
    stored = dataset.get_storage_size()
    if layout == h5d.COMPACT and stored:  # HDF5 itself compares its shape with its bytes
        return name, stored, (), False, False
    filters = [made.get_filter(number)[0] for number in range(made.get_nfilters())]
    if not _FILTERS.issuperset(filters) or len(set(filters)) < len(filters):
        raise RefusedError(f"{name!r} has filters {filters}; a set has shuffle, deflate and Fletcher32 only")
    of_type = dataset.get_type()
    kind = of_type.get_class()
    if kind not in _TYPES or (kind == h5t.STRING and of_type.is_variable_str()):
        raise RefusedError(f"{name!r} has a type that no set has: numbers and texts of fixed length only")
    shape = dataset.shape
    chunk = made.get_chunk() if layout == h5d.CHUNKED else shape
    claimed = max(math.prod(shape), math.prod(chunk)) * of_type.get_size()
    if claimed > stored * (_MOST_INFLATED if h5z.FILTER_DEFLATE in filters else 1):
        raise RefusedError(f"{name!r} claims {claimed} bytes; the file stores {stored} for them")
    return name, claimed, shape, len(shape) == 2 and chunk == (1, shape[1]), kind == h5t.FLOAT
