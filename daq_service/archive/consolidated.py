"""Write one HDF5 file of a complete test: records are views of the sets' files, tables are copied.

::

    / NXroot                  @default=entry @creator @creator_version @solimon_consolidated_version
    /entry NXentry            @default=<the first group of strikes>, title, start_time, program_name
      <position>_waveforms    NXdata: waveform[shot_id, time] in counts, and the columns of each table by shot
      <position>_pulse_echo   NXdata: the same with record[shot_id, time]
      <position>_sets         NXcollection: a row per set
      provenance              NXnote: JSON

Records of a position that differ in rate, length or type go to groups of their own (``B_waveforms_2``).
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from h5py.h5g import GroupID
from numpy.typing import NDArray

from daq_service.archive.nexus import (
    add_attributes,
    add_columns,
    add_field,
    add_group,
    new_image,
    open_root,
    read_image,
)
from daq_service.archive.reader import RecordGroup, list_record_groups, open_set_file, read_set_key
from daq_service.archive.records import SetReference
from hardware_drivers.measurement import Calibration, SetKey

CONSOLIDATED_VERSION = "1.0"

Column = NDArray[Any] | list[str]
Columns = Mapping[str, Column]


@dataclass(frozen=True, slots=True, kw_only=True)
class Sampling:
    """Sampling parameters that the records of one array share."""

    position: str
    is_echo: bool
    dtype: str
    n_samples: int
    sample_rate_hz: float
    pretrigger_samples: int

    @property
    def signal(self) -> str:
        """Return the name of the record array in its group: ``record`` (pulse echo) or ``waveform``."""
        return "record" if self.is_echo else "waveform"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Block:
    """Records of one set and one calibration, as stored in its file.

    Attributes
    ----------
    dataset
        Path of the array in the file, whose shape is (len(shot_ids), n_samples).
    """

    set_key: SetKey
    file: SetReference
    dataset: str
    shot_ids: Sequence[int]
    calibration: Calibration


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Facts:
    """Metadata of the test in a consolidated file; texts, and JSON-ready provenance.

    Attributes
    ----------
    maker_version, version
        Version of solimon that writes the file, and version that started the test.
    """

    title: str
    start_time: str
    maker_version: str
    version: str
    configuration_hash: str
    provenance: Mapping[str, Any]


def list_record_blocks(folder: Path, file: SetReference) -> list[tuple[Sampling, Block]]:
    """List the record arrays of a set's file, each with its sampling and block, without reading the records.

    Raises
    ------
    CorruptArchiveError, SetNotFoundError
        The file cannot be read, or is not there.
    """
    blocks = []
    with open_set_file(folder / file) as entry:
        for name in list_record_groups(entry):
            group = RecordGroup(entry, name)
            sampling = Sampling(
                position=group.position,
                is_echo="gain" in group.data,
                dtype=group.signal.dtype.str,
                n_samples=group.signal.shape[1],
                sample_rate_hz=group.sample_rate_hz,
                pretrigger_samples=group.pretrigger_samples,
            )
            block = Block(
                set_key=read_set_key(entry),
                file=file,
                dataset=str(group.signal.name),
                shot_ids=group.sequences,
                calibration=group.calibration,
            )
            blocks.append((sampling, block))
    return blocks


def build_consolidated_image(
    target: Path,
    folder: Path,
    facts: Facts,
    shots: Mapping[Sampling, tuple[Sequence[Block], Columns]],
    sets: Mapping[str, Columns],
) -> bytes:
    """Build the bytes of the consolidated file, with virtual datasets over the records of all sets.

    Parameters
    ----------
    target, folder
        Path of the new file, and the data folder: paths to the sets' files are relative to ``target``.
    shots
        Blocks in their order, and columns with a value per shot; at least one sampling (else ValueError).
    sets
        By position: columns with a value per set, the first one identifies the set.
    """
    with new_image() as file:
        root = {
            "NX_class": "NXroot",
            "default": "entry",
            "creator": "solimon",
            "creator_version": facts.maker_version,
        }
        add_attributes(open_root(file), {**root, "solimon_consolidated_version": CONSOLIDATED_VERSION})
        names = name_groups(shots)
        shown = names[min(names, key=lambda sampling: sampling.is_echo)]  # the first of strikes, if any
        entry = add_group(file, "entry", "NXentry", {"default": shown})
        add_field(entry, "title", facts.title)
        add_field(entry, "start_time", facts.start_time)
        configuration = facts.configuration_hash
        add_field(entry, "program_name", "solimon", version=facts.version, configuration=configuration)
        for sampling, (blocks, columns) in shots.items():
            _add_shots(entry, names[sampling], sampling, blocks, columns, _make_relative(target, folder))
        for position, columns in sets.items():
            add_columns(add_group(entry, f"{position}_sets", "NXcollection", {"position": position}), columns)
        note = add_group(entry, "provenance", "NXnote")
        add_field(note, "type", "application/json")
        add_field(note, "data", [json.dumps(dict(facts.provenance))], chunk=(1,), is_axis=True)
        return read_image(file)


def _make_relative(target: Path, folder: Path) -> str:
    """Return the path from the file's folder to the data folder, with slashes.

    It is absolute if the two are on different Windows drives.
    """
    target_folder, data_folder = target.parent.resolve(), folder.resolve()
    return (
        Path(os.path.relpath(data_folder, target_folder))
        if target_folder.drive == data_folder.drive
        else data_folder
    ).as_posix()


def name_groups(samplings: Iterable[Sampling]) -> dict[Sampling, str]:
    """Choose the group name of each record array; further samplings of a position get numbers from 2."""
    names, n_groups = dict[Sampling, str](), dict[str, int]()
    for sampling in samplings:
        base = f"{sampling.position}_{'pulse_echo' if sampling.is_echo else 'waveforms'}"
        n_groups[base] = n_groups.get(base, 0) + 1
        names[sampling] = base if n_groups[base] == 1 else f"{base}_{n_groups[base]}"
    return names


def _add_shots(
    entry: GroupID, name: str, sampling: Sampling, blocks: Sequence[Block], columns: Columns, folder: str
) -> None:
    """Add the group ``name`` of a record array: virtual dataset, time axis in s, calibration and columns.

    The rows are those of the blocks in their order; a missing file reads as the lowest count. ``folder`` is
    the path of the data folder as stored in the file.
    """
    shot_ids = np.concatenate([np.asarray(block.shot_ids, dtype=np.int64) for block in blocks])
    signal = sampling.signal
    group = add_group(
        entry, name, "NXdata", {"signal": signal, "axes": ["shot_id", "time"], "position": sampling.position}
    )
    time_s = (np.arange(sampling.n_samples) - sampling.pretrigger_samples) / sampling.sample_rate_hz
    time = add_field(group, "time", time_s, is_axis=True, units="s", description="time from trigger")
    shot = add_field(group, "shot_id", shot_ids, is_axis=True)
    layout = h5py.VirtualLayout((shot_ids.size, sampling.n_samples), dtype=sampling.dtype)
    row = 0
    for block in blocks:
        shape = len(block.shot_ids), sampling.n_samples
        # HDF5 takes %b for a number of its own.
        names = (name.replace("%", "%%") for name in (f"{folder}/{block.file}", block.dataset))
        source = h5py.VirtualSource(*names, shape, sampling.dtype)
        layout[row : row + shape[0]] = source
        row += shape[0]
    # Readers show this value where a set's file is missing: no real record is at the lowest count throughout.
    lowest = np.iinfo(sampling.dtype).min
    records = h5py.Group(group).create_virtual_dataset(signal, layout, fillvalue=lowest)
    add_attributes(records.id, {"units": "counts"})
    for dimension, axis in enumerate((shot, time)):
        h5py.h5ds.attach_scale(records.id, axis, dimension)
    _add_calibration(group, signal, blocks, shot)
    add_columns(group, columns, axis=shot)


def _add_calibration(group: GroupID, signal: str, blocks: Sequence[Block], shot: h5py.h5d.DatasetID) -> None:
    """Add the calibration of each shot to a group, since boards recalibrate themselves during a test.

    Coefficients in V, shape (n_shots, n_coefficients), padded with zeros; scaling factor in V and offset in
    counts for viewers. ``shot`` is the axis of the shots, ``signal`` the name of the record array.
    """
    length = max(block.calibration.coefficients_v.size for block in blocks)
    padded = [
        np.pad(b.calibration.coefficients_v, (0, length - b.calibration.coefficients_v.size)) for b in blocks
    ]
    coefficients = np.repeat(padded, [len(block.shot_ids) for block in blocks], axis=0)
    power = add_field(group, "power", np.arange(length), is_axis=True)
    add_field(group, "calibration_coefficients", coefficients, axes=[shot, power], units="V")
    constant, slope = coefficients[:, 0], coefficients[:, 1]
    offset = np.divide(constant, slope, out=np.zeros_like(slope), where=slope != 0.0)
    add_field(group, f"{signal}_scaling_factor", slope, axes=[shot], units="V")
    add_field(group, f"{signal}_offset", offset, axes=[shot], units="counts")
