"""Which alarms take a transducer out of the plan."""

import pytest

from daq_service.alarms import ACTIVE_STATES
from daq_service.operator_commands import retired_positions


def alarm(position, kind, state="unacknowledged"):
    return {"position": position, "kind": kind, "state": state, "message": f"{kind} at {position}"}


def standing(*rows):
    return {(row["position"], row["kind"]): row for row in rows}


@pytest.mark.parametrize("kind", ["hole", "retired"])
@pytest.mark.parametrize("state", ACTIVE_STATES)
def test_a_standing_hole_or_retirement_takes_a_transducer_out(kind, state):
    assert retired_positions(standing(alarm("B", kind, state))) == {"B": f"{kind} at B"}


def test_a_reset_alarm_lets_it_strike_again():
    assert retired_positions(standing(alarm("B", "hole", "normal"), alarm("C", "retired", "normal"))) == {}


def test_one_of_two_standing_is_enough():
    rows = standing(alarm("B", "hole", "normal"), alarm("B", "retired"))
    assert retired_positions(rows) == {"B": "retired at B"}


def test_other_alarms_and_those_of_the_service_retire_nobody():
    rows = standing(alarm("B", "wall_change"), alarm("C", "no_data"), alarm(None, "rig_unavailable"))
    assert retired_positions(rows) == {}
