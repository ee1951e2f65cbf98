"""Read the results of a test from its data folder through the catalogue and the archive.

Read only: a test that is still running may be read too. Names of positions, methods, limits and waveforms
are the folder's own; missing data stay empty, and the figures state that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq_service.archive import ArchiveError, FolderSetReader, SetReader, SetRecord, SetReference
from daq_service.catalogue import Catalogue, open_catalogue
from daq_service.catalogue.errors import NoDataYetError
from daq_service.catalogue.rows import AlarmRow, AssessmentRow, BaselineRow, FeatureRow, SetRow, ThicknessRow
from daq_service.errors import StorageError
from daq_service.processes.lost_catalogue import lost_reason

FloatArray = NDArray[np.float64]

PULSES = (
    "tof_pp_s", "tof_ac_s", "amplitude_ratio", "autocorrelation_coefficient", "psw_area_v_s", "tof_mf_s",
    "isw_amplitude_v", "psw_amplitude_v", "isw_time_s", "psw_time_s", "ssw_time_s", "isw_fwhm_s",
)  # fmt: skip
"""Columns of the catalogue that are drawn or compared."""
ASSESSED = ("distance_squared", "limit_f_predictive", "limit_mean_3sd")

TRACES = 25
"""Sets whose waveforms are drawn: enough for a trend, few enough to see single pulses."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Series:
    """Sets of one position in the order they were taken.

    Attributes
    ----------
    patch_m
        Assumed size of the corroded patch; None if not configured.
    set_index, hour_h
        Shape (n,).
    first_alarm_h
        Hour of the first alarm about the wall, None where there is none.
    """

    position: str
    label: str
    patch_m: float | None
    set_index: NDArray[np.int64]
    hour_h: FloatArray
    first_alarm_h: float | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SolitaryWaves(Series):
    """Sets of one solitary-wave transducer.

    Attributes
    ----------
    values
        By column of the catalogue, each float64 of shape (n,), NaN where not available: `PULSES` and
        `ASSESSED`.
    in_baseline, outlier, outlier_mean_3sd
        float64, shape (n,): 1 yes, 0 no, NaN where a set was not assessed.
    baseline
        Row of the catalogue, None before it is frozen.
    """

    values: Mapping[str, FloatArray]
    in_baseline: FloatArray
    outlier: FloatArray
    outlier_mean_3sd: FloatArray
    baseline: BaselineRow | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PulseEchoes(Series):
    """Readings of one ultrasonic probe; arrays of shape (n,), NaN where no echo was found.

    Attributes
    ----------
    delay_s, initial_thickness_m
        D and th_0 of eq. 17, as configured.
    element_separation_m
        Distance of the probe's elements that its path is corrected for; 0: eq. 17 without correction.
    """

    travel_time_s: FloatArray
    thickness_m: FloatArray
    thickness_loss_m: FloatArray
    delay_s: float | None
    element_separation_m: float
    initial_thickness_m: float | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trace:
    """Average of the accepted records of one position in one set.

    Attributes
    ----------
    time_s
        From the trigger, shape (n,).
    volts
        Shape (n,).
    n_records
        Records averaged.
    truth
        What the twin knows of the last of them; empty on a real rig.
    """

    position: str
    set_index: int
    hour_h: float
    time_s: FloatArray
    volts: FloatArray
    n_records: int
    truth: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evidence:
    """Results of a test so far.

    Attributes
    ----------
    from_twin
        The physics twin was behind it, so assumptions of the twin explain deviations.
    seed
        Of the twin; None for a real specimen.
    baseline_h
        Hours of the baseline as configured.
    traces
        By position: `TRACES` sets or fewer.
    trouble
        What could not be read, each a sentence.
    """

    folder: Path
    name: str
    configuration: Mapping[str, Any]
    configuration_hash: str
    solimon_version: str
    from_twin: bool
    seed: int | None
    baseline_h: float | None
    counts: Mapping[str, int]
    pulses: Mapping[str, SolitaryWaves]
    echoes: Mapping[str, PulseEchoes]
    traces: Mapping[str, Sequence[Trace]]
    trouble: tuple[str, ...] = ()

    @property
    def last_h(self) -> float:
        """Hour of the last set of any position."""
        series = (*self.pulses.values(), *self.echoes.values())
        return max((float(one.hour_h[-1]) for one in series if one.hour_h.size), default=0.0)


def read_evidence(folder: Path, *, with_traces: bool = True) -> Evidence:
    """Read a data folder.

    Raises
    ------
    StorageError
        The folder holds no test, one of another version, or is damaged.
    """
    try:
        with open_catalogue(folder) as catalogue:
            row = catalogue.experiment_row()
            configuration = row.configuration
            sets = catalogue.rows(SetRow)
            places = _places(configuration, sets)
            pulses = {
                name: _solitary_waves(catalogue, name, place)
                for name, place in places.items()
                if place["method"] == "solitary_wave"
            }
            echoes = {
                name: _pulse_echoes(catalogue, name, place, configuration)
                for name, place in places.items()
                if place["method"] == "pulse_echo"
            }
            counts = catalogue.counts()
    except NoDataYetError as error:
        raise StorageError(
            lost_reason(folder)
            or f"{folder} holds no test that has begun; give --from the data folder of one (it has a file "
            "catalogue.sqlite), or leave --from out to run the paper's test on the twin"
        ) from error
    if not counts["sets"]:
        raise StorageError(f"{folder} has no set yet; wait for the first one, or give another folder")
    traces, trouble = _traces(FolderSetReader(folder), sets) if with_traces else ({}, ())
    rig, twin = configuration.get("rig", {}), configuration.get("twin", {})
    from_twin = rig.get("kind") == "simulated" or bool(rig.get("on_doubles"))
    return Evidence(
        folder=folder,
        name=row.name,
        configuration=configuration,
        configuration_hash=row.configuration_hash,
        solimon_version=row.solimon_version,
        from_twin=from_twin,
        seed=twin.get("seed") if from_twin else None,
        baseline_h=configuration.get("baseline", {}).get("hours"),
        counts=counts,
        pulses=pulses,
        echoes=echoes,
        traces=traces,
        trouble=trouble,
    )


def _places(configuration: Mapping[str, Any], sets: Sequence[SetRow]) -> dict[str, dict[str, Any]]:
    """Return the positions with sets, each with its method."""
    methods = {row.position: row.method for row in sets}
    configured = configuration.get("positions", {})
    names = [name for name in configured if name in methods]
    names += sorted(set(methods) - set(names))
    return {name: {**configured.get(name, {}), "method": methods[name]} for name in names}


def _common(
    catalogue: Catalogue, position: str, place: Mapping[str, Any], columns: Mapping[str, Sequence[Any]]
) -> dict[str, Any]:
    """Return the fields of a `Series`."""
    alarms_h = [
        row.raised_h for row in catalogue.rows(AlarmRow, position=position) if row.alarm_class == "damage"
    ]
    return {
        "position": position,
        "label": place.get("label", ""),
        "patch_m": place.get("corrosion", {}).get("size_m"),
        "set_index": np.array(columns["set_index"], dtype=np.int64),
        "hour_h": _array(columns["due_h"]),
        "first_alarm_h": min(alarms_h, default=None),
    }


def _array(values: Sequence[float | bool | None]) -> FloatArray:
    """Return values as float64; None becomes NaN."""
    return np.array([np.nan if value is None else float(value) for value in values], dtype=np.float64)


def _solitary_waves(catalogue: Catalogue, position: str, place: Mapping[str, Any]) -> SolitaryWaves:
    """Read the sets of a solitary-wave transducer."""
    columns = catalogue.columns(FeatureRow, ["set_index", "due_h", *PULSES], position=position, scope="set")
    assessments = catalogue.columns(
        AssessmentRow,
        ["set_index", "in_baseline", "outlier", "outlier_mean_3sd", *ASSESSED],
        position=position,
    )
    row_of = {index: row for row, index in enumerate(assessments["set_index"])}
    rows = [row_of.get(index) for index in columns["set_index"]]

    def assessed_values(name: str) -> FloatArray:
        return _array([None if row is None else assessments[name][row] for row in rows])

    return SolitaryWaves(
        **_common(catalogue, position, place, columns),
        values={name: _array(columns[name]) for name in PULSES}
        | {name: assessed_values(name) for name in ASSESSED},
        in_baseline=assessed_values("in_baseline"),
        outlier=assessed_values("outlier"),
        outlier_mean_3sd=assessed_values("outlier_mean_3sd"),
        baseline=catalogue.baseline(position),
    )


def _pulse_echoes(
    catalogue: Catalogue, position: str, place: Mapping[str, Any], configuration: Mapping[str, Any]
) -> PulseEchoes:
    """Read the sets of an ultrasonic probe."""
    names = ("travel_time_s", "thickness_m", "thickness_loss_m")
    columns = catalogue.columns(ThicknessRow, ["set_index", "due_h", *names], position=position)
    ultrasound = configuration.get("ultrasound", {})
    return PulseEchoes(
        **_common(catalogue, position, place, columns),
        travel_time_s=_array(columns["travel_time_s"]),
        thickness_m=_array(columns["thickness_m"]),
        thickness_loss_m=_array(columns["thickness_loss_m"]),
        delay_s=ultrasound.get("delay_s"),
        element_separation_m=ultrasound.get("element_separation_m") or 0.0,
        initial_thickness_m=ultrasound.get("initial_thickness_m"),
    )


def _traces(archive: SetReader, sets: Sequence[SetRow]) -> tuple[dict[str, list[Trace]], tuple[str, ...]]:
    """Average records of sets evenly spread over the hours, first and last included."""
    files = {row.set_index: SetReference(row.file) for row in sets if row.file is not None}
    hour_of = {row.set_index: row.due_h for row in sets}
    stored = sorted(files)
    hours = np.array([hour_of[index] for index in stored])
    wanted = np.linspace(hours[0], hours[-1], TRACES) if stored else np.empty(0)
    chosen = sorted({stored[int(np.argmin(np.abs(hours - hour)))] for hour in wanted})
    traces: dict[str, list[Trace]] = {}
    trouble = []
    for index in chosen:
        try:
            record = archive.read_set(files[index], skip_damaged=True)
        except ArchiveError as error:
            trouble.append(f"set {index} is left out of the waveforms: {error}")
            continue
        for position in (place.position for place in record.positions):
            trace = _average(record, position)
            if trace is not None:
                traces.setdefault(position, []).append(trace)
    return traces, tuple(trouble)


def _average(record: SetRecord, position: str) -> Trace | None:
    """Average the accepted records of a position."""
    accepted = [
        shot
        for shot in record.records
        if shot.key.position == position and record.outcomes.get(shot.sequence, "accepted") == "accepted"
    ]
    if not accepted:
        return None
    first = accepted[0].waveform
    alike = [
        shot
        for shot in accepted
        if (shot.waveform.counts.size, shot.waveform.sample_rate_hz, shot.waveform.pretrigger_samples)
        == (first.counts.size, first.sample_rate_hz, first.pretrigger_samples)
    ]
    samples = np.arange(first.counts.size) - first.pretrigger_samples
    return Trace(
        position=position,
        set_index=record.set_index,
        hour_h=record.due_h,
        time_s=samples / first.sample_rate_hz,
        volts=np.mean([shot.waveform.volts() for shot in alike], axis=0),
        n_records=len(alike),
        truth=alike[-1].truth,
    )
