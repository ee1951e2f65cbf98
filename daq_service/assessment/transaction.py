"""Catalogue rows of a set or a change, with their events."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import Any

from analysis.waves.quality_gate import ACCEPTED, SUPERSEDED
from daq_service.alarms.states import Change, Moment
from daq_service.archive import waveform_crc32
from daq_service.assessment.assessor import PositionResult
from daq_service.catalogue.rows import (
    AnnotationRow,
    BaselineRow,
    EnvironmentRow,
    EventRow,
    Outcome,
    SetRow,
    ShotRow,
)
from daq_service.catalogue.writer import SetCommit, payload_of
from hardware_drivers.measurement import PulseEchoRecord, SetKey, Shot


def shot_row(
    measurement: Shot | PulseEchoRecord, *, valid: bool, flags: Sequence[str], outcome: Outcome = ACCEPTED
) -> ShotRow:
    """Return the catalogue row of a stored record."""
    return ShotRow(
        sequence=measurement.sequence,
        set_index=measurement.key.set_index,
        unscheduled_index=measurement.key.unscheduled_index,
        position=measurement.key.position,
        shot_index=measurement.key.shot_index,
        attempt=measurement.key.attempt,
        utc_ns=measurement.stamp.utc_ns,
        mono_ns=measurement.stamp.mono_ns,
        boot_id=measurement.stamp.boot_id,
        crc32=waveform_crc32(measurement.waveform),
        valid=valid,
        flags=list(flags),
        outcome=outcome,
    )


class Transaction(SetCommit):
    """Rows that are stored together, with their events."""

    def add_position(
        self,
        its_set: SetRow,
        measurements: Sequence[Shot | PulseEchoRecord],
        position_result: PositionResult,
        moment: Moment,
        outcomes: Mapping[int, str] = MappingProxyType({}),
    ) -> None:
        """Add the result of a set at one position; ``outcomes`` name the records that are not accepted."""
        self.sets.append(its_set)
        for measurement in measurements:
            flags = position_result.shot_flags[measurement.sequence]
            valid = measurement.sequence not in position_result.invalid
            outcome: Outcome = SUPERSEDED if outcomes.get(measurement.sequence) == SUPERSEDED else ACCEPTED
            self.shots.append(shot_row(measurement, valid=valid, flags=flags, outcome=outcome))
        self.features += position_result.features
        self.thickness += position_result.thickness
        self.assessments += position_result.assessments
        add_event = partial(
            self._add_event, moment=moment, position=its_set.position, set_key=its_set.set_key
        )
        # A reader joins the row, so the event holds no copy; that of a collecting baseline is replaced later.
        add_event("sets", f"set_{its_set.state}", {})
        for feature in position_result.features:
            if feature.shot_index is None:
                add_event("features", "set_features", {})
        if position_result.thickness:
            add_event("thickness", "thickness_read", {})
        if position_result.baseline is not None:
            approved_ns = moment.utc_ns if position_result.baseline.state == "approved" else None
            baseline = replace(
                position_result.baseline, created_utc_ns=moment.utc_ns, approved_utc_ns=approved_ns
            )
            self.baselines.append(baseline)
            payload = payload_of(baseline, last="created_utc_ns")
            add_event("assessments", "baseline_frozen", payload)
        for assessment in position_result.assessments[-1:]:
            add_event("assessments", "set_assessed", payload_of(assessment) if assessment.in_baseline else {})

    def add_environment(self, row: EnvironmentRow, moment: Moment) -> None:
        """Add the readings of supply and climate probe around a set."""
        self.environment.append(row)
        self._add_event("environment", "environment_read", {}, moment, set_key=SetKey(row.set_index))

    def add_event(
        self,
        kind: str,
        payload: Mapping[str, Any],
        moment: Moment,
        *,
        position: str | None = None,
        topic: str = "service",
    ) -> None:
        """Add an event of the service itself, or of its computer."""
        self._add_event(topic, kind, payload, moment, position=position, set_key=moment.set_key)

    def add_alarm(self, change: Change, moment: Moment) -> None:
        """Add a change of an alarm; its event contains the id that the catalogue assigns."""
        self.alarm_of_event[len(self.events)] = len(self.alarms)
        self.alarms.append(change.row)
        author_of_change = {} if change.author is None else {"author": change.author}
        self._add_event(
            "alarms",
            change.event_kind,
            author_of_change | payload_of(change.row, last="id"),
            moment,
            position=change.row.position,
            set_key=moment.set_key,
        )

    def annotate(self, row: AnnotationRow, kind: str, moment: Moment) -> None:
        """Add a new or changed annotation with its event."""
        self.annotation_of_event[len(self.events)] = len(self.annotations)
        self.annotations.append(row)
        self._add_event("annotations", kind, payload_of(row, last="id"), moment, position=row.position)

    def change_baseline(self, row: BaselineRow, kind: str, moment: Moment) -> None:
        """Add a baseline that a person changed; the event contains the complete row."""
        self.baselines.append(row)
        self._add_event("assessments", kind, payload_of(row), moment, position=row.position)

    def _add_event(
        self,
        topic: str,
        kind: str,
        payload: Mapping[str, Any],
        moment: Moment,
        *,
        position: str | None = None,
        set_key: SetKey | None = None,
    ) -> None:
        """Add an event at a moment."""
        self.events.append(
            EventRow(
                utc_ns=moment.utc_ns,
                topic=topic,
                kind=kind,
                position=position,
                set_index=None if set_key is None else set_key.set_index,
                unscheduled_index=0 if set_key is None else set_key.unscheduled_index,
                payload=dict(payload),
            )
        )
