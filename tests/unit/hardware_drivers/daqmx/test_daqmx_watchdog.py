"""The X Series watchdog guards each strike: started before the pulse, checked and stopped after it."""

from types import SimpleNamespace

import pytest

from hardware_drivers.daqmx.coil import Coil, _commit_watchdog
from hardware_drivers.daqmx.look import yield_board_findings
from hardware_drivers.daqmx.parameters import DaqmxParameters, TransducerWiring, WatchdogWiring
from hardware_drivers.daqmx.survey import Survey
from hardware_drivers.errors import AcquisitionTimeoutError


class Recorder:
    """Stands for a vendor object: notes what is asked of it, in order, together with its sibling."""

    def __init__(self, name, notes, *, expired=False):
        self._name, self._notes, self._expired = name, notes, expired

    def __getattr__(self, method):
        def note(*_):
            self._notes.append(f"{self._name}.{method}")

        return note

    @property
    def expired(self):
        self._notes.append(f"{self._name}.expired")
        return self._expired


def coil(notes, *, expired=False):
    return Coil(
        position="B",
        board=SimpleNamespace(label="PXIe-6396 01E18096"),
        task=Recorder("counter", notes),
        watchdog=Recorder("watchdog", notes, expired=expired),
        longest_s=0.01,
    )


def test_it_is_armed_before_the_pulse_and_disarmed_after_it():
    notes = []
    coil(notes).pulse()
    assert notes == [
        "watchdog.start", "counter.start", "counter.wait_until_done", "counter.stop",
        "watchdog.expired", "watchdog.stop",
    ]  # fmt: skip


def test_an_expired_watchdog_is_cleared_and_the_strike_is_missed():
    notes = []
    with pytest.raises(AcquisitionTimeoutError, match=r"expired .* watchdog\.timeout_s"):
        coil(notes, expired=True).pulse()
    assert notes[-3:] == ["watchdog.expired", "watchdog.clear_expiration", "watchdog.stop"]


def test_it_pulls_the_wired_lines_low():
    pytest.importorskip("nidaqmx")
    guarded = []

    class Watchdog:
        def cfg_watchdog_do_expir_states(self, states):
            guarded.extend((state.physical_channel, state.expiration_state.name) for state in states)

        def control(self, mode):
            assert guarded, "committed with its lines"

    wired = DaqmxParameters(
        transducers={"B": TransducerWiring(board_serial="01E18096")},
        watchdog=WatchdogWiring(board_serial="01E18096", lines=("port2/line4", "port2/line5")),
    )
    connection = SimpleNamespace(watchdog=lambda device, role, timeout_s: Watchdog())
    watchdog = wired.find_watchdog("1E18096")
    assert watchdog is not None
    _commit_watchdog(connection, watchdog, SimpleNamespace(name="Dev1", label="PXIe-6396 01E18096"))
    assert guarded == [("Dev1/port2/line4", "LOW"), ("Dev1/port2/line5", "LOW")]


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
