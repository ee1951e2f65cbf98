"""Write exported tables and waveforms as HDF5 files: a dataset per column with its unit and default plot."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from h5py.h5f import FileID
from h5py.h5g import GroupID
from numpy.typing import NDArray

from daq_service.archive.nexus import (
    Attribute,
    add_attributes,
    add_columns,
    add_field,
    add_group,
    new_image,
    open_root,
    read_image,
)


def build_table_image(
    name: str,
    columns: Mapping[str, NDArray[Any] | list[str]],
    *,
    signal: str | None,
    axis: str,
    facts_text: str,
) -> bytes:
    """Build the bytes of an HDF5 file with a table as ``entry/<name>``, an NXdata if there is a ``signal``.

    Parameters
    ----------
    columns
        By name, with equal lengths.
    signal
        Column of the y axis in the default plot; None: no plot.
    axis
        Column of the x axis (KeyError if missing).
    facts_text
        Provenance, stored as ``entry/facts``.
    """
    with new_image() as file:
        entry = _add_entry(file, name, facts_text)
        plot: dict[str, Attribute] = {} if signal is None else {"signal": signal, "axes": [axis]}
        group = add_group(entry, name, "NXcollection" if signal is None else "NXdata", plot)
        add_columns(group, {axis: columns[axis], **columns})
        return read_image(file)


def build_records_image(
    name: str,
    columns: Mapping[str, NDArray[Any] | list[str]],
    time_s: NDArray[np.float64],
    voltage_v: NDArray[np.float64],
    *,
    axis: str,
    facts_text: str,
) -> bytes:
    """Build the bytes of an HDF5 file of waveforms: ``entry/<name>``, the NXdata ``voltage_v[axis, time_s]``.

    Parameters
    ----------
    columns
         Columns with a value per waveform.
    voltage_v
        Shape (records, samples); ``time_s`` has shape (samples,).
    axis
        Column that identifies the waveforms.
    """
    with new_image() as file:
        plot: dict[str, Attribute] = {"signal": "voltage_v", "axes": [axis, "time_s"]}
        group = add_group(_add_entry(file, name, facts_text), name, "NXdata", plot)
        axis_field = add_columns(group, {axis: columns[axis], **columns})
        time = add_field(group, "time_s", time_s, is_axis=True, units="s", description="from the trigger")
        add_field(
            group, "voltage_v", voltage_v, chunk=(1, voltage_v.shape[1]), axes=[axis_field, time], units="V"
        )
        return read_image(file)


def _add_entry(file: FileID, name: str, facts_text: str) -> GroupID:
    """Add root attributes and the group ``entry`` with the facts; return ``entry``.

    Its default is the group ``name``.
    """
    add_attributes(open_root(file), {"NX_class": "NXroot", "default": "entry", "creator": "solimon"})
    entry = add_group(file, "entry", "NXentry", {"default": name})
    add_field(entry, "facts", facts_text)
    return entry
