"""A set while it is recorded: an early end keeps its measurements."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np

from analysis.waves.features import ShotFeatures, extract_all, extract_features
from analysis.waves.quality_gate import SUPERSEDED, Attempt, RestrikeRule, outcomes
from daq_service.acquisition.schedule import DueSet
from daq_service.acquisition.take_set import Measurement, MissedShot, MissReason, ProgressOfSet
from daq_service.archive import MissedRecord, OpenSet, SetRecord
from hardware_drivers.errors import InstrumentError
from hardware_drivers.instruments import Acquired
from hardware_drivers.measurement import PulseEchoRecord, Shot, Waveform

log = logging.getLogger(__name__)

DRY_RUN = "dry_run"
"""Flag of a record of a rehearsal: noise at the input, since no coil was energised."""
NOT_ANALYSED = "not_analysed"
"""Flag of a shot on which the extraction failed: the record is stored and can be analysed later."""


@dataclass(slots=True, kw_only=True, eq=False)
class TakenSet:
    """Records, misses and features of the current set, and the results of the quality check.

    Attributes
    ----------
    retired
        Positions that were left out from the start, with the reason.
    features
        Features of each shot by its sequence.
    trouble
        Instrument error that ended the set; None: it was completed or stopped.
    """

    rule: RestrikeRule
    retired: Mapping[str, str] = field(default_factory=dict)
    shots: list[Shot] = field(default_factory=list)
    echoes: list[PulseEchoRecord] = field(default_factory=list)
    missed: list[MissedShot] = field(default_factory=list)
    features: dict[int, ShotFeatures] = field(default_factory=dict)
    restrikes: Counter[str] = field(default_factory=Counter)
    trouble: InstrumentError | None = None
    started_ns: int = 0
    ended_ns: int = 0

    def restore(self, opened: OpenSet) -> None:
        """Add the records that an earlier process stored of this set; features are added separately."""
        for record in opened.records:
            self.keep(record)
        for missed in opened.missed:
            reason: MissReason = "connection_lost" if missed.reason == "connection_lost" else "no_trigger"
            self.missed.append(MissedShot(key=missed.key, cause=missed.cause, reason=reason))
        taken: list[Shot | PulseEchoRecord | MissedRecord] = [*opened.records, *opened.missed]
        keys = [item.key for item in taken]
        self.restrikes.update(key.position for key in keys if key.attempt > 0)

    def progress(self, struck: Collection[str]) -> ProgressOfSet:
        """Return the progress of the set; ``struck`` are the positions that have strikers."""
        taken: list[Shot | PulseEchoRecord | MissedShot] = [*self.shots, *self.echoes, *self.missed]
        keys = [item.key for item in taken]
        return ProgressOfSet(
            started_ns=self.started_ns,
            tried=frozenset((key.position, key.shot_index) for key in keys),
            n_strikes=sum(key.position in struck for key in keys),
        )

    def is_complete(self, planned: Mapping[str, int]) -> bool:
        """Return whether every planned shot was tried; positions that were left out are ignored."""
        tried = Counter(position for position, _ in self.progress(()).tried)
        return all(tried[position] >= n for position, n in planned.items() if position not in self.retired)

    def keep(self, measurement: Measurement) -> None:
        """Add a measurement; a shot's features are added separately (`features`)."""
        if isinstance(measurement, MissedShot):
            log.warning("%s: %s", measurement.key, measurement.cause)
            self.missed.append(measurement)
        elif isinstance(measurement, Shot):
            self.shots.append(measurement)
        else:
            self.echoes.append(measurement)

    def wants_restrike(self, taken: Shot | MissedShot) -> bool:
        """Return whether the quality check repeats a strike, and count the repetition."""
        position = taken.key.position
        flags = ("missed",) if isinstance(taken, MissedShot) else self.features[taken.sequence].flags
        granted = self.rule.wants(flags, attempt=taken.key.attempt, restrikes_so_far=self.restrikes[position])
        if granted:
            self.restrikes[position] += 1
            log.info("%s is %s: struck once more", taken.key, ", ".join(flags))
        return granted

    @property
    def is_empty(self) -> bool:
        """Return whether the set has no record."""
        return not self.shots and not self.echoes

    def n_records(self, position: str) -> int:
        """Count the shots of a position that have a record (each once), or its pulse-echo records."""
        records: list[Shot | PulseEchoRecord] = [*self.shots, *self.echoes]
        return len({item.key.shot_index for item in records if _at(item, position)})

    def shortfall(self, position: str, n_planned: int, stop_reason: str) -> str:
        """Return why a position has fewer records than planned; empty if it has all.

        Parameters
        ----------
        stop_reason
            Why the set was ended without an instrument error.
        """
        if self.n_records(position) >= n_planned:
            return ""
        ended_by = stop_reason if self.trouble is None else str(self.trouble)
        missed = [item for item in self.missed if _at(item, position)]
        attempts: list[Shot | PulseEchoRecord | MissedShot] = [*self.shots, *self.echoes, *missed]
        tried = {item.key.shot_index for item in attempts if _at(item, position)}
        causes = [ended_by] if len(tried) < n_planned else []
        if missed and missed[0].cause not in causes:
            causes.append(f"{len(missed)} missed: {missed[0].cause}")
        return "; ".join(causes)

    def missed_records(self) -> list[MissedRecord]:
        """Return the attempts without a record, in the archive's form."""
        return [MissedRecord(key=item.key, cause=item.cause, reason=item.reason) for item in self.missed]

    def instrument_error(self) -> str:
        """Return the instrument error in the archive's form, ``class: message``; empty if there was none."""
        if self.trouble is None:
            return ""
        # A driver may raise a subclass; the archive stores the class that all drivers share.
        kinds = (kind for kind in type(self.trouble).__mro__ if kind.__module__ == InstrumentError.__module__)
        return f"{next(kinds).__name__}: {self.trouble}"

    def superseded(self) -> dict[int, str]:
        """Return the outcome of the shots that do not count, by sequence."""
        return superseded(self.shots, self.features)


def _at(item: Shot | PulseEchoRecord | MissedShot | MissedRecord, position: str) -> bool:
    return item.key.position == position


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AnalysedWaveform(Waveform):
    """A waveform that comes with its features, computed by the process that computed the waveform."""

    features: ShotFeatures


def analysed(acquired: Sequence[Acquired | None]) -> list[Acquired | None]:
    """Extract the features of records together; where one fails, all come without."""
    waveforms = [one.waveform for one in acquired if one is not None]
    try:
        features = iter(extract_all(waveforms))
    except Exception:  # noqa: BLE001 the recorder tries each alone, and logs the one that fails
        return list(acquired)

    def with_features(waveform: Waveform) -> AnalysedWaveform:
        parts = {part.name: getattr(waveform, part.name) for part in fields(waveform)}
        return AnalysedWaveform(**parts, features=next(features))

    return [one and replace(one, waveform=with_features(one.waveform)) for one in acquired]


def features_of(shot: Shot) -> ShotFeatures:
    """Extract the features of a shot; a shot that cannot be analysed is flagged."""
    if isinstance(shot.waveform, AnalysedWaveform):
        return shot.waveform.features
    try:
        return extract_features(shot.waveform)
    except Exception:  # a fault of the analysis must never stop the acquisition; it is logged whole
        log.exception("shot %d (%s) could not be analysed", shot.sequence, shot.key)
        return ShotFeatures(flags=(NOT_ANALYSED,), valid=False, quality="bad")


def features_of_all(shots: Sequence[Shot]) -> list[ShotFeatures]:
    """Extract the features of many shots; the same as `features_of`, but faster."""
    try:
        return extract_all([shot.waveform for shot in shots])
    except Exception:  # noqa: BLE001 each is tried alone, which logs the one
        return [features_of(shot) for shot in shots]


def features_of_a_rehearsal(shot: Shot) -> ShotFeatures:
    """Return the only feature of a rehearsal's noise: its RMS about the mean, in V."""
    noise_rms_v = float(np.std(shot.waveform.volts()))
    return ShotFeatures(flags=(DRY_RUN,), valid=False, quality="bad", noise_rms_v=noise_rms_v)


def superseded(shots: list[Shot], features: dict[int, ShotFeatures]) -> dict[int, str]:
    """Return the outcome of the shots that are superseded by their repetition, by sequence."""
    superseded_shots: dict[int, str] = {}
    for position in {shot.key.position for shot in shots}:
        shots_here = [shot for shot in shots if shot.key.position == position]
        attempts = [
            Attempt(
                shot_index=shot.key.shot_index,
                attempt=shot.key.attempt,
                quality=features[shot.sequence].quality,
            )
            for shot in shots_here
        ]
        for shot, outcome in zip(shots_here, outcomes(attempts), strict=True):
            if outcome == SUPERSEDED:
                superseded_shots[shot.sequence] = outcome
    return superseded_shots


def due_of(record: SetRecord) -> DueSet:
    """Return the due time of a stored set, and the position of an unscheduled one."""
    return DueSet(
        set_index=record.set_index,
        unscheduled_index=record.unscheduled_index,
        due_h=record.due_h,
        due_utc_ns=record.due_utc_ns,
        position=record.positions[0].position if record.unscheduled_index else None,
    )


def n_missed(record: SetRecord, position: str) -> int:
    """Count the strikes or echoes of a position without a record."""
    return sum(_at(item, position) for item in record.missed)


def n_tried(record: SetRecord, position: str) -> int:
    """Count the shots of a position that were struck, with or without a record, without repetitions."""
    tried: list[Shot | MissedRecord] = [*record.shots, *record.missed]
    return sum(_at(item, position) and item.key.attempt == 0 for item in tried)


def n_restrikes(record: SetRecord, position: str) -> int:
    """Count the repetitions of a position's shots, with or without a record."""
    tried: list[Shot | MissedRecord] = [*record.shots, *record.missed]
    return sum(_at(item, position) and item.key.attempt > 0 for item in tried)
