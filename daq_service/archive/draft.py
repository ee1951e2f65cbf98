"""Describe a NeXus file before it is made: files of equal structure are filled copies of one skeleton.

HDF5 takes far longer to create a dataset, its attributes and its scales than to write a few numbers into
it. A skeleton has everything but the values and the attributes that differ from file to file. It depends on
the structure alone, so the same content gives the same bytes, independent of earlier files.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import orjson
from h5py import h5d, h5f, h5g, h5o

from daq_service.archive import nexus
from daq_service.archive.nexus import Attribute

_SKELETONS = 32
"""Structures kept in memory, 0.2 MB each: they differ in the number of shots and the length of texts."""


@dataclass(slots=True, kw_only=True, eq=False)
class Node:
    """Group, dataset, or second name of a dataset in a draft.

    Attributes
    ----------
    draft
        All nodes in the order of their creation.
    attributes
        Those of every file of this structure.
    own_attributes
        Those that differ from file to file.
    stored
        Values of a dataset and their HDF5 type.
    link
        Path of the dataset that this second name leads to.
    """

    path: str
    draft: list[Node]
    attributes: dict[str, Attribute]
    own_attributes: Mapping[str, Attribute] = field(default_factory=dict)
    stored: nexus.Stored | None = None
    chunk: tuple[int, ...] | None = None
    axes: tuple[str, ...] = ()
    is_axis: bool = False
    link: str = ""

    def add(self, name: str, attributes: Mapping[str, Attribute], **facts: Any) -> Node:
        """Append a node with the path ``name`` below this one to the draft and return it.

        ``facts`` are the other fields of the node.
        """
        path = f"{self.path}/{name}".lstrip("/")
        self.draft.append(Node(path=path, draft=self.draft, attributes=dict(attributes), **facts))
        return self.draft[-1]

    @property
    def structure(self) -> tuple[object, ...]:
        """Return what selects the skeleton: path, type and shape, chunk, axes, link and attributes."""
        shape = self.stored and (self.stored[0].dtype.str, self.stored[0].shape)
        return self.path, shape, self.chunk, self.axes, self.is_axis, self.link, self.attributes


def start_draft(attributes: Mapping[str, Attribute], own_attributes: Mapping[str, Attribute]) -> Node:
    """Create a draft and return its root node; ``own_attributes`` are those that differ from file to file."""
    root = Node(path="", draft=[], attributes=dict(attributes), own_attributes=own_attributes)
    root.draft.append(root)
    return root


def add_group(
    parent: Node, name: str, nx_class: str, attributes: Mapping[str, Attribute] | None = None
) -> Node:
    """Add a group of a NeXus class, below ``parent``, to the draft and return its node."""
    return parent.add(name, {"NX_class": nx_class, **(attributes or {})})


def add_field(
    parent: Node,
    name: str,
    values: object,
    *,
    chunk: tuple[int, ...] | None = None,
    axes: Sequence[Node] = (),
    is_axis: bool = False,
    own_attributes: Mapping[str, Attribute] | None = None,
    **attributes: Attribute,
) -> Node:
    """Add a dataset to the draft and return its node; arguments as in `nexus.add_field`.

    ``own_attributes`` are those that differ from file to file.
    """
    return parent.add(
        name,
        attributes,
        own_attributes=own_attributes or {},
        stored=nexus.to_stored_form(values),
        chunk=chunk,
        axes=tuple(axis.path for axis in axes),
        is_axis=is_axis,
    )


def build_draft_image(root: Node) -> bytes:
    """Build the bytes of the HDF5 file that a draft describes; equal drafts give equal bytes.

    ``root`` is the node of `start_draft`. Fills a copy of the cached skeleton of the draft's structure.
    """
    key = orjson.dumps([node.structure for node in root.draft], option=orjson.OPT_SERIALIZE_NUMPY)
    file = nexus.open_image(
        _create_skeleton(_Structure(key, root.draft)).fill_values(root.draft), is_own=True, writable=True
    )
    try:
        for node in root.draft:
            chunk = node.stored and nexus.choose_chunk(node.stored[0], node.chunk)
            if not (chunk or node.own_attributes):
                continue
            target = h5o.open(file, node.path.encode() or b"/")
            if chunk and node.stored:
                nexus.write_field(target, node.stored, chunk)
            nexus.add_attributes(target, node.own_attributes)
        return nexus.read_image(file)
    finally:
        file.close()


@dataclass(frozen=True, slots=True)
class _Structure:
    """Key of a structure, by which skeletons are cached, and one draft that has it."""

    key: bytes
    draft: Sequence[Node] = field(compare=False)


@dataclass(frozen=True, slots=True, eq=False)
class _Skeleton:
    """Open file with everything but large arrays and own attributes.

    Its small datasets stay open: their values lie in their object headers, whose place never changes.
    """

    file: h5f.FileID
    small: Mapping[str, h5d.DatasetID]
    lock: threading.Lock

    def fill_values(self, draft: Sequence[Node]) -> bytes:
        """Write a draft's small values into the skeleton and return the bytes of the file.

        Holds the skeleton's lock meanwhile; values of an earlier draft are overwritten.
        """
        with self.lock:
            for node in draft:
                if node.path in self.small and node.stored is not None:
                    nexus.write_field(self.small[node.path], node.stored, node.chunk)
            return nexus.read_image(self.file)


@lru_cache(maxsize=_SKELETONS)
def _create_skeleton(structure: _Structure) -> _Skeleton:
    """Create the open HDF5 file of a structure, without values; the 32 last used are cached."""
    with nexus.new_image() as file:
        made: dict[str, h5g.GroupID | h5d.DatasetID] = {"": nexus.open_root(file)}
        nexus.add_attributes(made[""], structure.draft[0].attributes)
        for node in structure.draft[1:]:
            parent, _, name = node.path.rpartition("/")
            if node.link:
                made[parent].links.create_hard(name.encode(), file, node.link.encode())
            elif node.stored is None:
                made[node.path] = nexus.create_group(made[parent], name, node.attributes)
            else:
                axes = [made[axis] for axis in node.axes]
                made[node.path] = nexus.create_field(
                    made[parent], name, node.stored, node.chunk, axes, node.is_axis, node.attributes
                )
        image = nexus.read_image(file)
    file = nexus.open_image(image, is_own=True, writable=True)
    small = {
        node.path: h5d.open(file, node.path.encode())
        for node in structure.draft
        if node.stored is not None and nexus.choose_chunk(node.stored[0], node.chunk) is None
    }
    return _Skeleton(file, small, threading.Lock())
