"""An exported table as an HDF5 file: a column a dataset with its unit, plotted over the hour by viewers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray

from daq_service.archive.nexus import (
    Attribute,
    add_field,
    add_group,
    image_file,
    image_of,
    open_root,
    set_attributes,
)
from hardware_drivers.units import unit_of


def table_image(
    name: str,
    columns: Mapping[str, NDArray[Any] | list[str]],
    *,
    signal: str | None,
    axis: str,
    facts_text: str,
) -> bytes:
    """Return the bytes of the file: ``entry/<name>``, an NXdata where there is a ``signal``.

    Parameters
    ----------
    axis
        Column over which the signal is drawn.
    """
    with image_file() as file:
        set_attributes(open_root(file), {"NX_class": "NXroot", "default": "entry", "creator": "solimon"})
        entry = add_group(file, "entry", "NXentry", {"default": name})
        add_field(entry, "facts", facts_text)
        plot: dict[str, Attribute] = {} if signal is None else {"signal": signal, "axes": [axis]}
        group = add_group(entry, name, "NXcollection" if signal is None else "NXdata", plot)
        along = add_field(group, axis, columns[axis], is_axis=True, units=unit_of(axis))
        for key, values in columns.items():
            if key != axis:
                column = add_field(group, key, values, axes=[along])
                set_attributes(column, {"units": unit_of(key)} if unit_of(key) else {})
        return image_of(file)
