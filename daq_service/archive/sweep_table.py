"""Write the table of a sweep as an HDF5 file: one dataset per column, with its unit as attribute."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from h5py.h5g import GroupID
from numpy.typing import NDArray

from daq_service.archive.nexus import Attribute, add_attributes, add_field, add_group, new_image, read_image
from hardware_drivers.units import find_unit

_CHUNK_SAMPLES = 65_536


def build_sweep_image(
    *,
    swept: Mapping[str, NDArray[Any] | list[str]],
    results: Mapping[str, NDArray[np.float64]],
    status: list[str],
    forces: Sequence[tuple[NDArray[np.float64], float]] | None,
    facts: Mapping[str, Any],
    facts_text: str,
) -> bytes:
    """Build the bytes of the HDF5 file of a sweep.

    ``entry/swept`` and ``entry/results`` hold the columns, ``entry/status`` a text per row, and
    ``entry/facts`` their provenance as JSON; scalar facts are also attributes of ``entry``.
    ``entry/waveforms/force_n`` concatenates the forces: row i has ``n_samples[i]`` samples from
    ``first_sample[i]`` on, ``sample_interval_s[i]`` apart, the first at the striker's contact.

    Parameters
    ----------
    swept, results, status, forces, facts, facts_text
        Parts of a `daq_service.cli.sweep.table.SweepTable`.
    """
    with new_image() as file:
        add_attributes(file, {"default": "entry"})
        plain: dict[str, Attribute] = {
            name: value for name, value in facts.items() if isinstance(value, (str, int, float))
        }
        entry = add_group(file, "entry", "NXentry", plain)
        add_field(entry, "facts", facts_text)
        for name, columns in (("swept", swept), ("results", results)):
            group = add_group(entry, name, "NXcollection", {"column_order": list(columns)})
            for key, values in columns.items():
                add_field(group, key, values, units=find_unit(key.rpartition(".")[2]))
        add_field(entry, "status", status)
        if forces is not None:
            _add_waveforms(entry, forces)
        return read_image(file)


def _add_waveforms(entry: GroupID, forces: Sequence[tuple[NDArray[np.float64], float]]) -> None:
    """Add the forces of all rows in N, one after the other, with first sample, length and interval in s."""
    group = add_group(entry, "waveforms", "NXcollection")
    samples = np.array([force.size for force, _ in forces], dtype=np.int64)
    concatenated = np.concatenate([force for force, _ in forces])
    # A dataset without samples has no chunk.
    chunk = (min(_CHUNK_SAMPLES, concatenated.size),) if concatenated.size else None
    add_field(group, "force_n", concatenated, chunk=chunk, units="N")
    add_field(group, "first_sample", np.cumsum(samples) - samples, units="")
    add_field(group, "n_samples", samples, units="")
    add_field(group, "sample_interval_s", np.array([interval for _, interval in forces]), units="s")
