"""Layout of the NeXus HDF5 file of one set.

::

    / NXroot            @default=entry @creator @solimon_format_version
    /entry NXentry      @default=preview, title, start_time, experiment_identifier, ..., purpose, due_h, ...
      instrument/<group>      NXdetector: sample rate, range, calibration polynomial (the truth);
                              attributes sensor_*: external calibration of the sensor
      <position>_waveforms    NXdata: waveform[shot, sample] in counts, time, shot_time, shot_id
      <position>_pulse_echo   NXdata: the same with record[shot, sample], gain, offset, averages
      truth                   NXcollection: true values of each record of a simulated rig (absent: none)
      settings                NXcollection: instrument settings of each record (absent: none)
      shots                   NXcollection: one row a record: key, stamps, checksum, flags, outcome
      missed                  NXcollection: strikes and echoes without a record (absent: none)
      positions               NXcollection: planned records, and why some are missing
      environment             NXcollection: supply and climate around the set (absent: none)
      features                NXdata: features and flags of each shot (these three: absent, or a copy)
      set_features            NXcollection: features of each transducer's set
      thickness               NXcollection: pulse-echo results
      preview                 NXdata: mean, min, max in volts of each transducer
      provenance              NXnote: JSON

Records of a position that differ in rate, length, type or calibration go to groups of their own
(``B_waveforms_2``): a set is never rejected for it. Results are a copy of the
catalogue's at the time of writing; without a journal the file is written before they are computed.
"""

from __future__ import annotations

import json
import uuid
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from daq_service.archive.draft import Node, add_field, add_group, build_draft_image, start_draft
from daq_service.clock import format_utc
from hardware_drivers.measurement import PulseEchoRecord, SetRecord, Shot, Waveform, compute_crc32
from hardware_drivers.nanoseconds import NS_PER_S
from hardware_drivers.units import find_unit

FORMAT_VERSION = "1.7"
"""Raised in its first number when an older reader would misunderstand the file."""
RESULTS = {"features": "shot_id", "set_features": "position", "thickness": "position"}
"""Tables of a set's results, each with its key column."""
CLIPPED = 1
"""Bit of ``shots/flags``."""
_PREVIEW_POINTS = 500

_EPOCH = "1970-01-01T00:00:00Z"

Record = Shot | PulseEchoRecord


@dataclass(frozen=True, slots=True, eq=False)
class _RecordGroup:
    """Records that share one array: same position, kind, rate, length, type and calibration."""

    name: str
    position: str
    records: list[Record]
    counts: NDArray[Any]
    """Shape (n_records, n_samples)."""

    @property
    def waveform(self) -> Waveform:
        """Return the waveform of the first record; all records share its sampling and calibration."""
        return self.records[0].waveform

    @property
    def is_echo(self) -> bool:
        """Return whether the records are pulse echoes; False for strikes."""
        return isinstance(self.records[0], PulseEchoRecord)

    @property
    def sampling(self) -> tuple[float, int, int]:
        """Return sampling rate in Hz, samples per record and samples before the trigger."""
        return self.waveform.sample_rate_hz, self.waveform.counts.size, self.waveform.pretrigger_samples


def build_set_image(record: SetRecord) -> bytes:
    """Build the bytes of the HDF5 file of a set with at least one record; equal sets give equal bytes.

    Raises ValueError if the provenance contains NaN or infinities, which JSON does not have, IndexError
    without a record.
    """
    groups = _group_records(record.records)
    root = start_draft(
        {
            "NX_class": "NXroot",
            "default": "entry",
            "creator": "solimon",
            "creator_version": _version(record),
            "solimon_format_version": FORMAT_VERSION,
        },
        {"file_time": format_utc(record.ended_utc_ns)},
    )
    entry = add_group(root, "entry", "NXentry", {"default": "preview"})
    _add_set_metadata(entry, record)
    _add_detectors(entry, record, groups)
    _add_records(entry, record, groups)
    _add_record_facts(entry, record, "truth")
    _add_record_facts(entry, record, "settings")
    _add_shot_table(entry, record)
    _add_misses(entry, record)
    _add_position_table(entry, record)
    _add_environment(entry, record)
    _add_results(entry, record)
    _add_preview(entry, groups)
    _add_provenance(entry, record)
    return build_draft_image(root)


def _version(record: SetRecord) -> str:
    """Return the version of solimon that recorded the set; "" if the provenance does not name it."""
    return str(record.provenance.get("versions", {}).get("solimon", ""))


def _group_records(records: Sequence[Record]) -> list[_RecordGroup]:
    """Group records by position, kind, sampling and calibration, in the order of the first records.

    Further groups of a position get names with numbers from 2. Stacks the counts to (n_records, n_samples).
    """
    by_key: dict[tuple[Any, ...], list[Record]] = {}
    for record in records:
        waveform = record.waveform
        calibration = waveform.calibration
        key = (
            record.key.position,
            isinstance(record, PulseEchoRecord),
            waveform.counts.dtype.str,
            waveform.counts.size,
            waveform.sample_rate_hz,
            waveform.pretrigger_samples,
            calibration.coefficients_v.tobytes(),
            calibration.resolution_bits,
            calibration.range_v,
            calibration.date,
        )
        by_key.setdefault(key, []).append(record)
    groups: list[_RecordGroup] = []
    n_groups: dict[str, int] = {}
    for (position, is_echo, *_), members in by_key.items():
        base = f"{position}_pulse_echo" if is_echo else f"{position}_waveforms"
        n_groups[base] = n_groups.get(base, 0) + 1
        name = base if n_groups[base] == 1 else f"{base}_{n_groups[base]}"
        counts = np.stack([record.waveform.counts for record in members])
        groups.append(_RecordGroup(name, position, members, counts))
    return groups


def _add_set_metadata(entry: Node, record: SetRecord) -> None:
    """Add title, times, identifiers, program, set key, purpose, due time and instrument error of the set."""
    provenance = record.provenance
    configuration_hash = str(provenance.get("configuration_hash", ""))
    sequences = [shot.sequence for shot in record.records]
    # The identifier follows from the content, so every copy of a set has the same one.
    identity = f"{configuration_hash}/{record.set_key}/{record.started_utc_ns}/{sequences}"
    add_field(entry, "title", f"Set {record.set_key}, hour {record.due_h:g}")
    add_field(entry, "start_time", format_utc(record.started_utc_ns))
    add_field(entry, "end_time", format_utc(record.ended_utc_ns))
    add_field(entry, "entry_identifier_uuid", str(uuid.uuid5(uuid.NAMESPACE_OID, identity)))
    if test_uuid := provenance.get("experiment", {}).get("uuid"):
        add_field(entry, "experiment_identifier", test_uuid)
    add_field(entry, "program_name", "solimon", version=_version(record), configuration=configuration_hash)
    add_field(entry, "set_index", np.int64(record.set_index))
    add_field(entry, "unscheduled_index", np.int64(record.unscheduled_index))
    add_field(entry, "purpose", record.set_key.purpose)
    add_field(entry, "due_h", np.float64(record.due_h), units="h")
    if record.trouble:
        add_field(entry, "trouble", record.trouble, description="instrument error that ended the set early")
    for name in ("due_utc_ns", "started_utc_ns", "ended_utc_ns"):
        add_field(entry, name, np.int64(getattr(record, name)), units="ns", start=_EPOCH)


def _add_detectors(entry: Node, record: SetRecord, groups: Sequence[_RecordGroup]) -> None:
    """Add ``instrument`` with an NXdetector for each group: sampling, range, calibration, serial number.

    Raises KeyError for records of a position that the set does not have.
    """
    serial_numbers = {position.position: position.serial_number for position in record.positions}
    instrument = add_group(entry, "instrument", "NXinstrument")
    add_field(instrument, "name", record.rig_kind)
    for group in groups:
        waveform = group.waveform
        calibration = waveform.calibration
        scale, offset = _compute_nexus_scale(waveform)
        about_sensor = _list_sensor_calibration(record.provenance, group.position)
        about = {"position": group.position, **about_sensor}
        detector = add_group(instrument, group.name, "NXdetector", about)
        add_field(detector, "serial_number", serial_numbers[group.position])
        add_field(detector, "sample_rate", np.float64(waveform.sample_rate_hz), units="Hz")
        add_field(detector, "pretrigger_samples", np.int64(waveform.pretrigger_samples))
        add_field(detector, "input_range", np.float64(calibration.range_v), units="V")
        add_field(detector, "resolution_bits", np.int64(calibration.resolution_bits))
        power = add_field(detector, "power", np.arange(calibration.coefficients_v.size), is_axis=True)
        add_field(
            detector,
            "calibration_coefficients",
            calibration.coefficients_v,
            axes=[power],
            units="V",
            description="volts = sum of coefficient * counts**power",
        )
        add_field(detector, "calibration_date", calibration.date)
        add_field(detector, "scaling_factor", np.float64(scale), units="V")
        add_field(detector, "offset", np.float64(offset))


def _list_sensor_calibration(provenance: Mapping[str, Any], position: str) -> dict[str, str | float]:
    """List the known values of a sensor's external calibration in the stored configuration, as attributes."""
    place = provenance.get("configuration", {}).get("positions", {}).get(position, {})
    calibration = place.get("calibration", {}).items()
    return {f"sensor_{name}": value for name, value in calibration if value not in (None, "")}


def _compute_nexus_scale(waveform: Waveform) -> tuple[float, float]:
    """Compute scale (V) and offset (counts) of NXdata for viewers: volts = (counts + offset) * scale.

    The offset is 0 if the scale is 0; higher coefficients of the calibration are left out.
    """
    constant, slope = (float(c) for c in waveform.calibration.coefficients_v[:2])
    return slope, constant / slope if slope else 0.0


def _add_records(entry: Node, record: SetRecord, groups: Sequence[_RecordGroup]) -> None:
    """Add an NXdata for each group of records: counts, time axis in s, shot times in s and shot ids.

    Pulse echoes also have gain (dB), offset (V) and averages. Each record is a chunk of its own.
    """
    time_axes: dict[tuple[float, int, int], Node] = {}
    start = format_utc(record.due_utc_ns)
    for group in groups:
        signal = "record" if group.is_echo else "waveform"
        data = add_group(
            entry,
            group.name,
            "NXdata",
            {"signal": signal, "axes": ["shot_time", "time"], "position": group.position},
        )
        scale, offset = _compute_nexus_scale(group.waveform)
        time = _add_time_axis(data, group, time_axes)
        shot_time = add_field(
            data,
            "shot_time",
            np.array([(shot.stamp.utc_ns - record.due_utc_ns) / NS_PER_S for shot in group.records]),
            is_axis=True,
            units="s",
            own_attributes={"start": start},
        )
        counts = group.counts
        add_field(
            data,
            signal,
            counts,
            chunk=(1, counts.shape[1]) if counts.shape[1] else None,
            axes=[shot_time, time],
            units="counts",
        )
        # Only NeXus fields hold the scale: a netCDF reader that applies `scale_factor` would give volts
        # with the unit of the counts.
        add_field(data, f"{signal}_scaling_factor", np.float64(scale), units="V")
        add_field(data, f"{signal}_offset", np.float64(offset), units="counts")
        add_field(data, "shot_id", _to_int64(shot.sequence for shot in group.records), axes=[shot_time])
        echoes = [echo for echo in group.records if isinstance(echo, PulseEchoRecord)]
        if echoes:
            add_setting = partial(add_field, data, axes=[shot_time])
            add_setting("gain", np.array([echo.gain_db for echo in echoes]), units="dB")
            add_setting("offset", np.array([echo.offset_v for echo in echoes]), units="V")
            add_setting("averages", _to_int64(echo.averages for echo in echoes))


def _to_int64(numbers: Iterable[int]) -> NDArray[np.int64]:
    """Convert integers to an int64 array, shape (n,)."""
    return np.fromiter(numbers, dtype=np.int64)


def _add_time_axis(
    data: Node,
    group: _RecordGroup,
    time_axes: dict[tuple[float, int, int], Node],
) -> Node:
    """Add the time axis of a group, in s from the trigger, and return it.

    Groups with equal sampling share one; ``time_axes`` has it by sampling and is updated.
    """
    if group.sampling in time_axes:
        axis = time_axes[group.sampling]
        data.add("time", {}, link=axis.path)
        return axis
    axis = add_field(
        data,
        "time",
        group.waveform.time_s(),
        is_axis=True,
        units="s",
        description="time from trigger",
        target=f"/entry/{group.name}/time",
    )
    time_axes[group.sampling] = axis
    return axis


def _add_record_facts(entry: Node, record: SetRecord, kind: Literal["truth", "settings"]) -> None:
    """Add table ``kind`` with a row per record and a column per fact, unless no record has facts.

    The attribute ``known`` marks the records that have a fact; the others have NaN or an empty text.
    """
    facts: list[Mapping[str, float | str]] = [getattr(shot, kind) for shot in record.records]
    names = sorted(set().union(*facts))
    if not names:
        return
    group = add_group(entry, kind, "NXcollection")
    axis = add_field(group, "shot_id", _to_int64(shot.sequence for shot in record.records), is_axis=True)
    for name in names:
        values = [fact.get(name) for fact in facts]
        if str in map(type, values):
            texts = ["" if value is None else str(value) for value in values]
            field = add_field(group, name, texts, axes=[axis])
        else:
            numbers = np.array(values, dtype=np.float64)  # None becomes NaN
            field = add_field(group, name, numbers, axes=[axis], units=find_unit(name))
        if None in values:
            field.attributes["known"] = np.array([value is not None for value in values], dtype=np.uint8)


def _add_misses(entry: Node, record: SetRecord) -> None:
    """Add table ``missed`` of the strikes and echoes without a record, unless there are none.

    Its columns are position, shot index, attempt, reason and cause.
    """
    if not record.missed:
        return
    table = add_group(entry, "missed", "NXcollection")
    axis = add_field(table, "row", np.arange(len(record.missed)), is_axis=True)
    add_column = partial(add_field, table, axes=[axis])
    add_column("position", [item.key.position for item in record.missed])
    for name in ("shot_index", "attempt"):
        add_column(name, _to_int64(getattr(item.key, name) for item in record.missed))
    add_column("reason", [item.reason for item in record.missed])
    add_column("cause", [item.cause for item in record.missed])


def _add_environment(entry: Node, record: SetRecord) -> None:
    """Add group ``environment`` with the available supply and climate values, unless there are none.

    Values that are None are left out.
    """
    known = {name: value for name, value in record.environment.items() if value is not None}
    if not known:
        return
    group = add_group(entry, "environment", "NXcollection")
    for name, value in sorted(known.items()):
        if isinstance(value, str):
            add_field(group, name, value)
        else:
            add_field(group, name, np.float64(value), units=find_unit(name))


def _add_shot_table(entry: Node, record: SetRecord) -> None:
    """Add table ``shots`` with key, time stamps, checksum, flags and outcome of each record."""
    records = record.records
    table = add_group(entry, "shots", "NXcollection")
    axis = add_field(table, "shot_id", _to_int64(shot.sequence for shot in records), is_axis=True)
    add_column = partial(add_field, table, axes=[axis])
    add_column("position", [shot.key.position for shot in records])
    for name in ("shot_index", "attempt"):
        add_column(name, _to_int64(getattr(shot.key, name) for shot in records))
    add_column("utc_ns", _to_int64(shot.stamp.utc_ns for shot in records), units="ns", start=_EPOCH)
    add_column(
        "mono_ns",
        _to_int64(shot.stamp.mono_ns for shot in records),
        units="ns",
        description="monotonic clock; comparable within one boot_id",
    )
    add_column("boot_id", [shot.stamp.boot_id for shot in records])
    add_column(
        "crc32",
        np.array([compute_crc32(shot.waveform) for shot in records], dtype=np.uint32),
        description="CRC-32 (zlib) of the counts, little-endian",
    )
    add_column(
        "flags",
        np.array([CLIPPED if shot.waveform.clipped else 0 for shot in records], dtype=np.uint8),
        flag_masks=np.uint8(CLIPPED),
        flag_meanings="clipped",
    )
    add_column(
        "outcome",
        [record.outcomes.get(shot.sequence, "accepted") for shot in records],
        description="accepted, or superseded by a repetition of the same shot",
    )


def _add_position_table(entry: Node, record: SetRecord) -> None:
    """Add table ``positions``: method, label, serial number, cause of missing records, planned and taken.

    The taken number counts every record of a position, superseded ones too.
    """
    positions = record.positions
    positions_of_records = [shot.key.position for shot in record.records]
    table = add_group(entry, "positions", "NXcollection")
    axis = add_field(table, "name", [row.position for row in positions], is_axis=True)
    add_column = partial(add_field, table, axes=[axis])
    for name in ("method", "label", "serial_number", "cause"):
        add_column(name, [getattr(row, name) for row in positions])
    add_column("n_planned", _to_int64(row.n_planned for row in positions))
    add_column("n_taken", _to_int64(positions_of_records.count(row.position) for row in positions))


def _add_results(entry: Node, record: SetRecord) -> None:
    """Add a table for each kind of results, sorted by column name; an empty one is omitted.

    The first value of a column decides whether it is text, without unit, or numbers.
    """
    for table, axis_name in RESULTS.items():
        columns = {name: list(values) for name, values in record.results.get(table, {}).items()}
        if not columns:
            continue
        plot_attributes = {"signal": "tof_pp_s", "axes": [axis_name]} if table == "features" else {}
        group = add_group(entry, table, "NXdata" if plot_attributes else "NXcollection", plot_attributes)
        axis = add_field(group, axis_name, _to_column_values(columns.pop(axis_name)), is_axis=True)
        for name, values in sorted(columns.items()):
            field = add_field(group, name, _to_column_values(values), axes=[axis])
            if not isinstance(values[0], str):
                field.attributes["units"] = find_unit(name)


def _to_column_values(values: list[float | str]) -> Any:
    """Convert a column of numbers to an array, return one of texts as it is; the first value decides."""
    return values if isinstance(values[0], str) else np.array(values)


def _add_preview(entry: Node, groups: Sequence[_RecordGroup]) -> None:
    """Add group ``preview``: mean, min and max in V over the records, at up to 500 times.

    One NXdata has one time axis, so it holds the groups that are sampled like the first transducer.
    """
    first = next((group for group in groups if not group.is_echo), groups[0])
    shown = [group for group in groups if group.sampling == first.sampling and group.is_echo == first.is_echo]
    width = max(1, -(-first.waveform.counts.size // _PREVIEW_POINTS))
    starts = np.arange(0, first.waveform.counts.size, width)
    names = [group.name.replace("_waveforms", "").replace("_pulse_echo", "") for group in shown]
    curves = [f"{name}_{kind}" for kind in ("mean", "min", "max") for name in names]
    preview = add_group(
        entry,
        "preview",
        "NXdata",
        {
            "signal": curves[0],
            "axes": ["time"],
            "title": "Mean, min and max of the shots",
            **({"auxiliary_signals": curves[1:]} if curves[1:] else {}),
        },
    )
    # Without `long_name` viewers label each curve with name and unit.
    time_s = first.waveform.time_s()[starts]
    time = add_field(preview, "time", time_s, is_axis=True, units="s", description="time from trigger")
    for name, group in zip(names, shown, strict=True):
        for kind, values in _compute_envelope(group, starts).items():
            add_field(preview, f"{name}_{kind}", values, axes=[time], units="V")


def _compute_envelope(group: _RecordGroup, starts: NDArray[np.int64]) -> dict[str, NDArray[np.float32]]:
    """Compute mean, min and max in V of all records between adjacent starts, shape (n_starts,) each.

    ``starts`` are increasing sample indices. Counts are reduced and then calibrated: an ADC's calibration is
    monotonic, and the difference that its curvature makes to a mean is invisible in a figure.
    """
    if not starts.size:
        return dict.fromkeys(("mean", "min", "max"), np.zeros(0, dtype=np.float32))
    counts = group.counts
    widths = np.diff(np.append(starts, counts.shape[1]))
    reduced = {
        "mean": np.add.reduceat(counts.mean(axis=0), starts) / widths,
        "min": np.minimum.reduceat(counts.min(axis=0), starts),
        "max": np.maximum.reduceat(counts.max(axis=0), starts),
    }
    calibrate = np.polynomial.Polynomial(group.waveform.calibration.coefficients_v)
    return {kind: calibrate(values).astype(np.float32) for kind, values in reduced.items()}


def _add_provenance(entry: Node, record: SetRecord) -> None:
    """Add group ``provenance`` with the provenance as JSON, keys sorted; ValueError for NaN or infinities."""
    text = json.dumps(dict(record.provenance), allow_nan=False, sort_keys=True)
    note = add_group(entry, "provenance", "NXnote")
    add_field(note, "type", "application/json")
    add_field(note, "description", "configuration, host and versions that made this set")
    add_field(note, "date", format_utc(record.ended_utc_ns))
    add_field(note, "data", [text], chunk=(1,), is_axis=True)
