"""Rows and conditions with usual values: a test names the columns that matter to it."""

from __future__ import annotations

from typing import Any

from daq_service.alarms.states import Condition
from daq_service.catalogue.rows import AlarmRow, AssessmentRow, EventRow, FeatureRow, SetRow, ShotRow

HOUR_0_NS = 1_704_067_200_000_000_000
NS_PER_H = 3_600_000_000_000


def condition(present: bool = True, **values: Any) -> Condition:
    """Return a condition of a possible change of the wall at B."""
    usual = {"position": "B", "kind": "wall_change", "alarm_class": "damage", "priority": "high"}
    return Condition(**{**usual, "present": present, **values})


def alarm_row(position: str | None = "B", kind: str = "wall_change", **columns: Any) -> AlarmRow:
    """Return an unacknowledged alarm of hour 1."""
    usual = {
        "alarm_class": "damage",
        "priority": "high",
        "state": "unacknowledged",
        "raised_utc_ns": HOUR_0_NS,
        "raised_h": 1.0,
        "changed_utc_ns": HOUR_0_NS,
        "message": "B has changed",
        "evidence": {},
    }
    return AlarmRow(position=position, kind=kind, **{**usual, **columns})


def set_row(set_index: int = 0, position: str = "B", **columns: Any) -> SetRow:
    """Return a complete set of two shots, due in the hour of its index."""
    usual = {
        "method": "pulse_echo" if position == "A" else "solitary_wave",
        "due_utc_ns": HOUR_0_NS + set_index * NS_PER_H,
        "due_h": float(set_index),
        "state": "done",
        "n_planned": 2,
    }
    return SetRow(set_index=set_index, position=position, **{**usual, **columns})


def shot_row(set_index: int, position: str, shot_index: int, sequence: int, **columns: Any) -> ShotRow:
    """Return a valid shot without flags."""
    own = {"set_index": set_index, "position": position, "shot_index": shot_index, "sequence": sequence}
    usual = {"attempt": 0, "utc_ns": HOUR_0_NS + sequence, "mono_ns": sequence, "boot_id": "5d1f"}
    return ShotRow(**{**own, **usual, "crc32": 2**32 - 1, "valid": True, "flags": [], **columns})


def feature_row(set_index: int, position: str = "B", **columns: Any) -> FeatureRow:
    """Return features of a set, or of a shot if it is named."""
    own = {"set_index": set_index, "position": position, "due_h": float(set_index)}
    usual = {"shot_index": None, "sequence": None, "extractor_version": "1", "quality": "good", "n_valid": 1}
    return FeatureRow(**{**own, **usual, **columns})


def assessment_row(set_index: int, position: str = "B", **columns: Any) -> AssessmentRow:
    """Return the assessment of a set after the baseline."""
    own = {"set_index": set_index, "position": position, "due_h": float(set_index)}
    return AssessmentRow(**{**own, "in_baseline": False, "limit_name": "f_predictive", **columns})


def event_row(kind: str = "set_done", topic: str = "sets", **columns: Any) -> EventRow:
    """Return an event of hour 0."""
    return EventRow(**{"utc_ns": HOUR_0_NS, "topic": topic, "kind": kind, "payload": {}, **columns})
