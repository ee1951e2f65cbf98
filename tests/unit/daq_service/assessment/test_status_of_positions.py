"""Status of a position."""

from dataclasses import replace

import pytest

from daq_service.assessment.position_status import interval_at, status_of
from daq_service.catalogue.reader import LatestRows
from daq_service.catalogue.rows import AlarmRow, AssessmentRow, SetRow
from daq_service.settings.tree import Settings

SET = SetRow(
    set_index=0,
    position="B",
    method="solitary_wave",
    due_utc_ns=0,
    due_h=0.0,
    state="done",
    n_planned=1,
)
ECHO_SET = replace(SET, method="pulse_echo")


ALARM = AlarmRow(
    position="B",
    kind="wall_change",
    alarm_class="damage",
    priority="high",
    state="acknowledged",
    raised_utc_ns=0,
    raised_h=0.0,
    changed_utc_ns=0,
    message="3 of the last 5 sets at B are outliers",
    evidence={},
)
SHELVED = replace(ALARM, suppressed="shelved")
OUT_OF_SERVICE = replace(ALARM, suppressed="out_of_service")


def assessment_row(outlier):
    return AssessmentRow(
        set_index=0, position="B", due_h=0.0, in_baseline=False, limit_name="f_predictive", outlier=outlier
    )


@pytest.mark.parametrize(
    ("last_set", "assessment", "alarms", "status"),
    [
        (None, None, [], "no_data"),
        # It was enabled after this set: its alarms determine the present status.
        (replace(SET, state="disabled"), assessment_row(False), [], "normal"),
        (SET, assessment_row(False), [ALARM], "alarm"),
        (SET, assessment_row(False), [ALARM, replace(ALARM, kind="no_reflection")], "disabled"),
        (SET, assessment_row(True), [], "outlier"),
        (SET, assessment_row(False), [SHELVED], "shelved"),
        (ECHO_SET, None, [SHELVED], "shelved"),
        (SET, assessment_row(True), [SHELVED, OUT_OF_SERVICE], "out_of_service"),
        (SET, assessment_row(False), [OUT_OF_SERVICE, ALARM], "alarm"),
        (SET, assessment_row(False), [replace(OUT_OF_SERVICE, kind="transducer_disabled")], "disabled"),
        (SET, assessment_row(None), [replace(SHELVED, kind="not_assessed")], "not_assessed"),
        (SET, assessment_row(False), [], "normal"),
        (SET, replace(assessment_row(None), in_baseline=True), [], "collecting_baseline"),
        (SET, assessment_row(None), [], "not_assessed"),
        (SET, assessment_row(None), [replace(ALARM, kind="not_assessed")], "not_assessed"),
        (
            SET,
            assessment_row(None),
            [replace(ALARM, kind="not_assessed"), replace(ALARM, kind="few_valid_shots")],
            "alarm",
        ),
        (SET, None, [], "collecting_baseline"),
        (ECHO_SET, None, [], "normal"),
    ],
)
def test_a_position_has_the_expected_status(last_set, assessment, alarms, status):
    method = SET.method if last_set is None else last_set.method
    last = LatestRows(
        position="B", method=method, last_set=last_set, last_assessment=assessment, active_alarms=alarms
    )
    assert status_of(last) == status


def test_interval_follows_the_phases():
    schedule = Settings().schedule
    assert [interval_at(schedule, hour) for hour in (0.0, 75.0, 76.0, 400.0)] == [0.5, 0.5, 1.0, 1.0]
