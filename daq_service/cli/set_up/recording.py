"""Values of a configuration that plays back a recording, as far as its files show them."""

from __future__ import annotations

import re
from dataclasses import asdict, replace
from pathlib import Path

from pydantic import ValidationError

from daq_service.archive import FolderSetReader
from daq_service.catalogue.experiment_file import read_experiment_file
from daq_service.clock import format_utc
from daq_service.errors import UsageError
from daq_service.rig.playback import ArchivedShots
from daq_service.settings.stored import restore_settings
from daq_service.settings.tables import Tables
from hardware_drivers.errors import ConfigurationError
from hardware_drivers.methods import PULSE_ECHO, SOLITARY_WAVE
from hardware_drivers.nanoseconds import NS_PER_H
from hardware_drivers.playback.parameters import TdmsMapping
from hardware_drivers.playback.proposal import propose_mapping
from hardware_drivers.playback.tdms import open_tdms

OF_THE_TWIN = ("chain", "plate", "corrosion", "twin")
WILDCARD = re.compile(r"[*?[]")


def build_playback_values(source: Path, usual: Tables) -> tuple[Tables, list[str]]:
    """Build the values that play back a recorded test or TDMS files, and lines that describe them.

    Parameters
    ----------
    source
        Data folder of a test, folder of TDMS files, one TDMS file, or a pattern of them.
    usual
        Values where the recording has none.

    Raises
    ------
    UsageError
        The source is missing or cannot be read, or its configuration is of another version.
    CatalogueError
        The experiment file of the test is corrupt.
    """
    fixed = next((n for n, part in enumerate(source.parts) if WILDCARD.search(part)), len(source.parts))
    files, source = "/".join(source.parts[fixed:]), Path(*source.parts[:fixed]).absolute()
    if not source.exists():
        raise UsageError(f"{source} is not there; give the folder or file of the recording")
    if source.is_file() and source.suffix.lower() != ".tdms":
        raise UsageError(
            f"{source} is a {source.suffix or 'nameless'} file; playback reads the data folder of a test, or "
            "TDMS files. Use `solimon features` for waveforms in other files."
        )
    lines: list[str] = []
    playback: Tables = {"source": str(source), "format": "archive"}
    if (source / "sets").is_dir():
        values = _read_test(source)
    else:
        mapping = replace(TdmsMapping(), files=files) if files else TdmsMapping()
        values, mapping, lines = _read_tdms(source, mapping, usual)
        table = {name: value for name, value in asdict(mapping).items() if value is not None}
        playback |= {"format": "tdms", "tdms": table}
    values = {
        name: table for name, table in (usual | values).items() if name in usual and name not in OF_THE_TWIN
    }
    for place in values["positions"].values():
        for name in OF_THE_TWIN:
            place.pop(name, None)
    # Not the folder of the recording, which may be next to the file.
    values["storage"] = {**values["storage"], "folder": "playback-data"}
    return {**values, "rig": {"kind": "playback", "playback": playback}}, lines


def _read_test(source: Path) -> Tables:
    """Return the configuration of a recorded test, with its hour 0; of a copy without one that of its sets.

    Raises UsageError if it is of another version or no set can be read, CatalogueError for a corrupt file.
    """
    experiment = read_experiment_file(source)
    recorded = experiment or ArchivedShots(FolderSetReader(source))
    try:
        values = restore_settings(recorded.configuration).model_dump(mode="json", exclude_none=True)
    except ValidationError as error:
        raise UsageError(f"{source} was recorded by a version with other keys: {error}") from error
    return {**values, "clock": {"kind": "simulated", "epoch": format_utc(recorded.epoch_utc_ns, 9)}}


def _read_tdms(source: Path, mapping: TdmsMapping, usual: Tables) -> tuple[Tables, TdmsMapping, list[str]]:
    """Return values and mapping that fit TDMS files, and lines that describe them.

    Files whose shots need keys that nobody can propose get the mapping only, and a line with the reason.
    Raises UsageError if the files cannot be read.
    """
    values: Tables = {"name": f"Playback of {source.stem}"}
    try:
        shots = open_tdms(source, mapping)
    except ConfigurationError:
        try:
            mapping = propose_mapping(source, mapping)
        except ConfigurationError as error:
            raise UsageError(f"the recording cannot be played back: {error}") from error
        try:
            shots = open_tdms(source, mapping)
        except ConfigurationError as error:
            return values, mapping, [f"not complete: {error}"]
    with shots:
        named = {name: re.sub(r"[\W_]", "", name, flags=re.ASCII)[-16:] for name in shots.positions}
        other = {"method": SOLITARY_WAVE}
        values["positions"] = {name: usual["positions"].get(name, other) for name in sorted(named.values())}
        probes = [name for name, place in values["positions"].items() if place["method"] == PULSE_ECHO]
        rename = {old: new for old, new in named.items() if old != new}
        mapping = replace(mapping, pulse_echo_positions=tuple(probes), rename=rename)
        times = sorted((key.set_index, place.utc_ns) for key, place in shots.places.items() if place.utc_ns)
        n_shots = 1 + max(
            (key.shot_index for key in shots.places if named[key.position] not in probes), default=0
        )
        n_sets = 1 + max(key.set_index for key in shots.places)
    schedule, baseline = dict(usual["schedule"]), dict(usual["baseline"])
    interval_h = schedule["phases"][0]["interval_h"]
    if times:
        (first, first_ns), last = times[0], times[-1][0]
        last_ns = next(utc_ns for set_index, utc_ns in times if set_index == last)
        if last > first:
            interval_h = max(1, round(60.0 * (last_ns - first_ns) / (last - first) / NS_PER_H)) / 60.0
        epoch_ns = first_ns - round((first + 1) * interval_h * NS_PER_H)
        values["clock"] = {"kind": "simulated", "epoch": format_utc(epoch_ns, 9)}
    schedule["phases"] = [{"until_h": n_sets * interval_h, "interval_h": interval_h}]
    schedule["shots_per_set"] = n_shots
    pause_s = 1800.0 * interval_h / (n_shots * len(named))
    schedule["shot_interval_s"] = min(schedule["shot_interval_s"], pause_s)
    baseline["hours"] = min(baseline["hours"], n_sets * interval_h / 2.0)
    baseline["minimum_valid_shots"] = min(baseline["minimum_valid_shots"], n_shots)
    methods = ", ".join(f"{name} ({place['method']})" for name, place in values["positions"].items())
    lines = [
        f"positions: {methods}",
        f"patterns: {mapping.file_pattern}, {mapping.group_pattern}, {mapping.channel_pattern}",
        f"sets: {n_sets} of {n_shots} shots, every {interval_h:.3g} h",
    ]
    return {**values, "schedule": schedule, "baseline": baseline}, mapping, lines
