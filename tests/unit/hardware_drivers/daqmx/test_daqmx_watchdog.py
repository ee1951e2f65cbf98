"""The X Series watchdog guards each strike: started before the pulse, checked and stopped after it."""

import pytest

from hardware_drivers.daqmx.look import yield_board_findings
from hardware_drivers.daqmx.parameters import DaqmxParameters, TransducerWiring, WatchdogWiring
from hardware_drivers.daqmx.survey import Survey


def two_boards(**changes):
    wiring = {
        "B": TransducerWiring(board_serial="01E18096"),
        "C": TransducerWiring(board_serial="01E18096", input="ai1", striker_serial="01E16086"),
    }
    return DaqmxParameters(transducers=wiring, **changes)


def watchdog(serial, *lines):
    return WatchdogWiring(board_serial=serial, lines=lines or ("port2/line4",))


def test_each_board_that_drives_a_coil_has_its_own():
    parameters = two_boards(watchdogs=(watchdog("1E18096"), watchdog("1E16086", "port2/line5")))
    assert parameters.find_watchdog("01E18096").lines == ("port2/line4",)
    assert parameters.find_watchdog("01e16086").lines == ("port2/line5",)
    assert parameters.find_watchdog("BEEF") is None
    assert two_boards(watchdog=watchdog("1E18096")).find_watchdog("01E16086") is None, "as it was before"


def test_watchdogs_that_contradict_each_other_are_refused():
    with pytest.raises(ValueError, match="watchdog and watchdogs are both given"):
        two_boards(watchdog=watchdog("1E18096"), watchdogs=(watchdog("1E16086"),))
    with pytest.raises(ValueError, match="watchdogs has board 01E18096 twice"):
        two_boards(watchdogs=(watchdog("1E18096"), watchdog("01E18096")))
    with pytest.raises(ValueError, match=r"watchdog.board_serial is BEEF; no coil is driven by that board"):
        two_boards(watchdogs=(watchdog("1E18096"), watchdog("BEEF")))


def test_a_board_that_drives_a_coil_without_a_watchdog_is_a_warning(monkeypatch):
    monkeypatch.setattr("hardware_drivers.daqmx.look.survey_rig", Survey)

    def looked(**changes):
        seen = yield_board_findings(two_boards(**changes), shot_interval_s=4.0)
        return {finding.subject: finding.state for finding in seen if "watchdog" in finding.subject}

    assert looked() == {}
    one = watchdog("1E18096")
    assert looked(watchdog=one) == {"watchdog": "ok", "watchdog of board 01E16086": "warn"}
    both = looked(watchdogs=(one, watchdog("1E16086", "port2/line5")))
    assert both == {"watchdog of board 01E18096": "ok", "watchdog of board 01E16086": "fail"}, (
        "PFI12 is line4"
    )
