"""Status of a position."""

from dataclasses import replace

import pytest
from support.invented_rows import alarm_row, assessment_row, set_row

from daq_service.assessment.position_status import find_set_interval_h, find_status
from daq_service.catalogue.reader import LatestRows
from daq_service.settings.tree import Settings

SET = set_row()
ECHO_SET = replace(SET, method="pulse_echo")


ALARM = alarm_row(state="acknowledged", message="3 of the last 5 sets at B are outliers")
SHELVED = replace(ALARM, suppressed="shelved")
OUT_OF_SERVICE = replace(ALARM, suppressed="out_of_service")


def assessed(outlier):
    return assessment_row(0, outlier=outlier)


@pytest.mark.parametrize(
    ("last_set", "assessment", "alarms", "status"),
    [
        (None, None, [], "no_data"),
        # It was enabled after this set: its alarms determine the present status.
        (replace(SET, state="disabled"), assessed(False), [], "normal"),
        (SET, assessed(False), [ALARM], "alarm"),
        (SET, assessed(False), [ALARM, replace(ALARM, kind="no_reflection")], "disabled"),
        (SET, assessed(True), [], "outlier"),
        (SET, assessed(False), [SHELVED], "shelved"),
        (ECHO_SET, None, [SHELVED], "shelved"),
        (SET, assessed(True), [SHELVED, OUT_OF_SERVICE], "out_of_service"),
        (SET, assessed(False), [OUT_OF_SERVICE, ALARM], "alarm"),
        (SET, assessed(False), [replace(OUT_OF_SERVICE, kind="transducer_disabled")], "disabled"),
        (SET, assessed(None), [replace(SHELVED, kind="not_assessed")], "not_assessed"),
        (SET, assessed(False), [], "normal"),
        (SET, replace(assessed(None), in_baseline=True), [], "collecting_baseline"),
        (SET, assessed(None), [], "not_assessed"),
        (SET, assessed(None), [replace(ALARM, kind="not_assessed")], "not_assessed"),
        (
            SET,
            assessed(None),
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
    assert find_status(last) == status


def test_interval_follows_the_phases():
    schedule = Settings().schedule
    assert [find_set_interval_h(schedule, hour) for hour in (0.0, 75.0, 76.0, 400.0)] == [0.5, 0.5, 1.0, 1.0]
