"""Read the results of a test from its data folder through the catalogue and the archive.

Read only: a test that is still running may be read too. Names of positions, methods, limits and waveforms
are the folder's own; missing data stay empty, and the figures state that.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from daq_service.archive import ArchiveError, FolderSetReader, SetReader, SetRecord, SetReference
from daq_service.catalogue import Catalogue, open_catalogue
from daq_service.catalogue.errors import NoDataYetError
from daq_service.catalogue.rows import AlarmRow, AssessmentRow, BaselineRow, FeatureRow, SetRow, ThicknessRow
from daq_service.errors import StorageError
from daq_service.processes.lost_catalogue import describe_loss
from daq_service.settings.stored import restore_settings
from daq_service.settings.tree import PositionSettings, Settings
from hardware_drivers.methods import PULSE_ECHO, SOLITARY_WAVE

FloatArray = NDArray[np.float64]

PULSES = (
    "tof_pp_s", "tof_ac_s", "amplitude_ratio", "autocorrelation_coefficient", "psw_area_v_s", "tof_mf_s",
    "isw_amplitude_v", "psw_amplitude_v", "isw_time_s", "psw_time_s", "ssw_time_s", "isw_fwhm_s",
)  # fmt: skip
"""Columns of the catalogue that are drawn or compared."""
ASSESSED = (
    "in_baseline",
    "outlier",
    "outlier_mean_3sd",
    "distance_squared",
    "limit_f_predictive",
    "limit_mean_3sd",
)
ECHOES = ("travel_time_s", "thickness_m", "thickness_loss_m")

TRACES = 25
"""Sets whose waveforms are drawn: enough for a trend, few enough to see single pulses."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Series:
    """Sets of one position in the order they were taken.

    Attributes
    ----------
    settings
        Of the position.
    set_index, hour_h
        Shape (n,).
    values
        By column of the catalogue, each float64 of shape (n,), NaN where not available: `PULSES` and
        `ASSESSED` (1 yes, 0 no) of a solitary-wave transducer, `ECHOES` of an ultrasonic probe.
    baseline
        Row of the catalogue; None before it is frozen, and of a probe.
    alarms_h
        Hour of the first alarm about the wall by its kind; empty where there is none.
    """

    position: str
    settings: PositionSettings
    set_index: NDArray[np.int64]
    hour_h: FloatArray
    values: Mapping[str, FloatArray]
    baseline: BaselineRow | None
    alarms_h: Mapping[str, float]

    @property
    def first_alarm_h(self) -> float | None:
        """Return the hour of the first alarm about the wall, None where there is none."""
        return min(self.alarms_h.values(), default=None)


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
    truth: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evidence:
    """Results of a test so far.

    Attributes
    ----------
    from_twin
        The physics twin was behind it, so assumptions of the twin explain deviations.
    seed
        Of the twin; None for a real specimen.
    traces
        By position: `TRACES` sets or fewer.
    at_alarms
        By position: the sets that raised an alarm at any.
    trouble
        What could not be read, each a sentence.
    """

    folder: Path
    name: str
    settings: Settings
    configuration_hash: str
    solimon_version: str
    from_twin: bool
    seed: int | None
    counts: Mapping[str, int]
    pulses: Mapping[str, Series]
    echoes: Mapping[str, Series]
    traces: Mapping[str, Sequence[Trace]]
    at_alarms: Mapping[str, Sequence[Trace]] = field(default_factory=dict)
    trouble: tuple[str, ...] = ()

    @property
    def last_h(self) -> float:
        """Return the hour of the last set of any position; 0 without sets."""
        series = (*self.pulses.values(), *self.echoes.values())
        return max((float(one.hour_h[-1]) for one in series if one.hour_h.size), default=0.0)

    def find_true_loss_mm(self, position: str, hour_h: float) -> float | None:
        """Return the wall loss that the twin knows at the set of an alarm, in mm; None if it is not known."""
        truth = next((one.truth for one in self.at_alarms.get(position, ()) if one.hour_h == hour_h), {})
        if "depth_fraction" in truth:
            return 1e3 * truth["depth_fraction"] * self.pulses[position].settings.plate.thickness_m
        if "thickness_m" in truth:
            return 1e3 * (self.settings.ultrasound.initial_thickness_m - truth["thickness_m"])
        return None

    def describe_true_loss(self, position: str) -> str:
        """Describe the wall loss that the twin knows at the first alarm of a transducer in words."""
        loss_mm = self.find_true_loss_mm(position, self.pulses[position].first_alarm_h or 0.0)
        return f"true wall loss {'not known' if loss_mm is None else f'{loss_mm:.2f} mm'}"


def read_evidence(folder: Path, *, with_traces: bool = True) -> Evidence:
    """Read the sets, readings and averaged waveforms (traces) for the reproduction from a data folder.

    Unreadable sets are left out of the traces and listed in ``trouble``. Without ``with_traces`` no waveforms
    are read.

    Raises
    ------
    StorageError
        The folder holds no test, no set, one of another version, or is damaged.
    """
    try:
        with open_catalogue(folder) as catalogue:
            row = catalogue.read_experiment()
            settings = restore_settings(row.configuration)
            sets = catalogue.rows(SetRow)
            with_sets = {one.position for one in sets}
            series = [
                _read_series(catalogue, name, place)
                for name, place in settings.positions.items()
                if name in with_sets
            ]
            counts = catalogue.counts()
    except NoDataYetError as error:
        raise StorageError(
            describe_loss(folder)
            or f"{folder} holds no test; give --from the data folder of one (it has a file "
            "catalogue.sqlite), or leave --from out to run the paper's test on the twin"
        ) from error
    except ValidationError as error:
        raise StorageError(
            f"{folder} keeps a configuration that this version does not know: {error}; use the one that "
            "recorded it"
        ) from error
    if not counts["sets"]:
        raise StorageError(f"{folder} has no set yet; wait for the first one, or give another folder")
    stored = [row for row in sets if row.file is not None] if with_traces else []
    hours = [row.due_h for row in sets]
    archive, spread_h = FolderSetReader(folder), np.linspace(min(hours), max(hours), TRACES)
    traces, trouble = _average_selected_sets(archive, stored, spread_h)
    alarms_h = [hour_h for one in series for hour_h in one.alarms_h.values()]
    at_alarms, _ = _average_selected_sets(archive, stored, alarms_h)
    return Evidence(
        folder=folder,
        name=row.name,
        settings=settings,
        configuration_hash=row.configuration_hash,
        solimon_version=row.solimon_version,
        from_twin=settings.rig.on_twin,
        seed=settings.twin.seed if settings.rig.on_twin else None,
        counts=counts,
        pulses={one.position: one for one in series if one.settings.method == SOLITARY_WAVE},
        echoes={one.position: one for one in series if one.settings.method == PULSE_ECHO},
        traces=traces,
        at_alarms=at_alarms,
        trouble=trouble,
    )


def _read_series(catalogue: Catalogue, position: str, settings: PositionSettings) -> Series:
    """Read a position's sets as arrays by column (NaN if missing), its baseline and first damage alarm."""
    columns = {}
    if settings.method == PULSE_ECHO:
        found = catalogue.columns(ThicknessRow, ["set_index", "due_h", *ECHOES], position=position)
    else:
        found = catalogue.columns(FeatureRow, ["set_index", "due_h", *PULSES], position=position, scope="set")
        assessments = catalogue.columns(AssessmentRow, ["set_index", *ASSESSED], position=position)
        for name in ASSESSED:
            of_set = dict(zip(assessments["set_index"], assessments[name], strict=True))
            columns[name] = [of_set.get(index) for index in found["set_index"]]
    columns |= {name: found[name] for name in found if name not in ("set_index", "due_h")}
    alarms = sorted(catalogue.rows(AlarmRow, position=position), key=lambda row: -row.raised_h)
    return Series(
        position=position,
        settings=settings,
        set_index=np.array(found["set_index"], dtype=np.int64),
        hour_h=_to_float_array(found["due_h"]),
        values={name: _to_float_array(values) for name, values in columns.items()},
        baseline=catalogue.baseline(position),
        alarms_h={row.kind: row.raised_h for row in alarms if row.alarm_class == "damage"},
    )


def _to_float_array(values: Sequence[float | bool | None]) -> FloatArray:
    """Convert values to a float64 array; None becomes NaN."""
    return np.array([np.nan if value is None else float(value) for value in values], dtype=np.float64)


def _average_selected_sets(
    archive: SetReader, sets: Sequence[SetRow], at_h: Iterable[float]
) -> tuple[dict[str, list[Trace]], tuple[str, ...]]:
    """Average the records of the sets next to the hours ``at_h``, each once.

    Returns the traces by position, and a sentence for each set that cannot be read.
    """
    hours = np.array([row.due_h for row in sets])
    chosen = {int(np.argmin(np.abs(hours - hour))) for hour in at_h} if sets else ()
    traces: dict[str, list[Trace]] = {}
    trouble = []
    for row in (sets[index] for index in sorted(chosen)):
        try:
            record = archive.read_set(SetReference(str(row.file)), skip_damaged=True)
        except ArchiveError as error:
            trouble.append(f"set {row.set_index} is left out of the waveforms: {error}")
            continue
        for position in (place.position for place in record.positions):
            trace = _average_records(record, position)
            if trace is not None:
                traces.setdefault(position, []).append(trace)
    return traces, tuple(trouble)


def _average_records(record: SetRecord, position: str) -> Trace | None:
    """Average the accepted records of a set at a position sample by sample, in V; None if there are none.

    Records that differ from the first in length, rate or pretrigger are left out.
    """
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
