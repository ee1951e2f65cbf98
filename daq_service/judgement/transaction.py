"""Catalogue rows of what was taken and what happened, built in one place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from analysis.waves.quality_gate import ACCEPTED
from daq_service.acquisition.schedule import DueSet
from daq_service.alarms.states import Change, Moment
from daq_service.archive import waveform_crc32
from daq_service.catalogue import SetCommit
from daq_service.judgement.solitary_wave import Assessment
from hardware_drivers.measurement import PulseEchoRecord, Shot


def set_row(
    due: DueSet,
    position: str,
    *,
    method: str,
    state: str,
    cause: str | None,
    n_planned: int,
    n_taken: int = 0,
    n_valid: int = 0,
    n_missed: int = 0,
    n_restrikes: int = 0,
    started_utc_ns: int | None = None,
    ended_utc_ns: int | None = None,
    file: str | None = None,
) -> dict[str, Any]:
    """Row of a planned set at one position: done, partial, missed or retired."""
    return {
        "set_index": due.set_index,
        "position": position,
        "method": method,
        "due_utc_ns": due.due_utc_ns,
        "due_h": due.due_h,
        "started_utc_ns": started_utc_ns,
        "ended_utc_ns": ended_utc_ns,
        "state": state,
        "cause": cause,
        "n_planned": n_planned,
        "n_taken": n_taken,
        "n_valid": n_valid,
        "n_missed": n_missed,
        "n_restrikes": n_restrikes,
        "file": file,
    }


def shot_row(
    measurement: Shot | PulseEchoRecord, *, valid: bool, flags: Sequence[str], outcome: str = ACCEPTED
) -> dict[str, Any]:
    """Row of a stored record."""
    return {
        "sequence": measurement.sequence,
        "set_index": measurement.key.set_index,
        "position": measurement.key.position,
        "shot_index": measurement.key.shot_index,
        "attempt": measurement.key.attempt,
        "utc_ns": measurement.stamp.utc_ns,
        "mono_ns": measurement.stamp.mono_ns,
        "boot_id": measurement.stamp.boot_id,
        "crc32": waveform_crc32(measurement.waveform),
        "valid": valid,
        "flags": list(flags),
        "outcome": outcome,
    }


class Transaction:
    """Rows that belong together: stored in one commit, told by its events."""

    def __init__(self) -> None:
        self.sets: list[dict[str, Any]] = []
        self.shots: list[dict[str, Any]] = []
        self.features: list[dict[str, Any]] = []
        self.thickness: list[dict[str, Any]] = []
        self.baselines: list[dict[str, Any]] = []
        self.verdicts: list[dict[str, Any]] = []
        self.environment: list[dict[str, Any]] = []
        self.alarms: list[dict[str, Any]] = []
        self.events: list[dict[str, Any]] = []

    def add_position(
        self,
        its_set: dict[str, Any],
        measurements: Sequence[Shot | PulseEchoRecord],
        assessment: Assessment,
        moment: Moment,
        outcomes: Mapping[int, str] = MappingProxyType({}),
    ) -> None:
        """Add what a set says of one position; ``outcomes`` name the records that are not accepted."""
        self.sets.append(its_set)
        for measurement in measurements:
            flags = assessment.shot_flags[measurement.sequence]
            valid = measurement.sequence not in assessment.invalid
            outcome = outcomes.get(measurement.sequence, ACCEPTED)
            self.shots.append(shot_row(measurement, valid=valid, flags=flags, outcome=outcome))
        self.features += assessment.features
        self.thickness += assessment.thickness
        self.verdicts += assessment.verdicts
        place = {"position": its_set["position"], "set_index": its_set["set_index"]}
        self._tell("sets", f"set_{its_set['state']}", its_set, moment, **place)
        for row in assessment.features:
            if row["shot_index"] is None:
                self._tell("features", "set_features", row, moment, **place)
        for row in assessment.thickness:
            self._tell("thickness", "thickness_read", row, moment, **place)
        if assessment.baseline is not None:
            baseline = {**assessment.baseline, "created_utc_ns": moment.utc_ns}
            self.baselines.append(baseline)
            self._tell("verdicts", "baseline_frozen", baseline, moment, **place)
        for row in assessment.verdicts[-1:]:
            self._tell("verdicts", "set_judged", row, moment, **place)

    def add_environment(self, row: dict[str, Any], moment: Moment) -> None:
        """Add what supply and climate probe said around a set."""
        self.environment.append(row)
        self._tell("environment", "environment_read", row, moment, set_index=row["set_index"])

    def tell(
        self, kind: str, payload: Mapping[str, Any], moment: Moment, *, position: str | None = None
    ) -> None:
        """Add an event of the service itself."""
        self._tell("service", kind, payload, moment, position=position, set_index=moment.set_index)

    def add_alarm(self, change: Change, moment: Moment) -> None:
        """Add an alarm's change; its event carries the id that the catalogue gives."""
        self.alarms.append(change.row)
        self._tell(
            "alarms",
            change.event_kind,
            change.row,
            moment,
            position=change.row["position"],
            set_index=moment.set_index,
            alarm_index=len(self.alarms) - 1,
        )

    def rows(self) -> SetCommit:
        """Return the rows in the catalogue's form."""
        return SetCommit(
            sets=self.sets,
            shots=self.shots,
            features=self.features,
            thickness=self.thickness,
            baselines=self.baselines,
            verdicts=self.verdicts,
            environment=self.environment,
            alarms=self.alarms,
            events=self.events,
        )

    def _tell(self, topic: str, kind: str, payload: Mapping[str, Any], moment: Moment, **where: Any) -> None:
        self.events.append(
            {"utc_ns": moment.utc_ns, "topic": topic, "kind": kind, "payload": dict(payload), **where}
        )
