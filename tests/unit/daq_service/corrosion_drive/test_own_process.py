"""The supply process on a scripted supply and a manual clock, with and without a recorder."""

from collections.abc import Callable
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from threading import Event
from typing import Any

import pytest
from support.scripted_supply import ScriptedSupply, supply_parameters
from support.serial_rig import TestClock

from daq_service.clock import boot_name
from daq_service.corrosion_drive.charge import Charge, Command, DriveState
from daq_service.corrosion_drive.own_process import (
    GRACE_S,
    DriveProcess,
    decide_next_action,
    run_supply_process,
)
from daq_service.corrosion_drive.supply_state import (
    read_stored_state,
    read_supply_status,
    stamp_state,
    write_stored_state,
)
from daq_service.errors import RigError
from daq_service.processes.data_folder import DRIVE_FILE
from hardware_drivers.errors import ConnectionLostError

WATCHDOG_S = 600.0
PARAMETERS = supply_parameters(watchdog_timeout_s=WATCHDOG_S)
LOST = ConnectionLostError("the supply at COM4 is gone")
ON: dict[str, Any] = {"do": "energise", "author": "Ada", "voltage_v": None, "current_limit_a": None}


class UtcSteps(TestClock):
    """Clock whose UTC can be set."""

    def __init__(self):
        super().__init__()
        self.ahead_ns = 0

    def utc_ns(self):
        return self.now_ns + self.ahead_ns


class Bench:
    """One supply and the processes that own it one after the other."""

    def __init__(self, folder):
        self.folder, self.clock = folder, UtcSteps()
        self.locks = self.ports = 0
        self.supply = ScriptedSupply(self.clock)
        self.restart()

    def restart(self, **options):
        """Kill the process and start another one."""
        self.process = self.another(**options)

    def another(self, **options):
        return DriveProcess(
            self.lock, self.port, PARAMETERS, self.folder, supply_port="COM4", clock=self.clock, **options
        )

    @contextmanager
    def lock(self):
        self.locks += 1
        try:
            yield
        finally:
            self.locks -= 1

    @contextmanager
    def port(self):
        self.ports += 1
        try:
            yield self.supply
        finally:
            self.ports -= 1

    def ask(self, do="look", **values):
        return dict(self.process.answer_request({"id": 1, "do": do, **values}))

    def run(self, seconds, *, step_s=5.0):
        """Run the process alone."""
        for _ in range(round(seconds / step_s)):
            if self.process.leaves:
                return
            self.process.step()
            self.clock.advance(step_s)

    def active(self):
        return {condition["name"] for condition in self.ask()["conditions"] if condition["active"]}

    def energised(self):
        return sum(call.startswith("energise") for call in self.supply.calls)


@pytest.fixture
def bench(tmp_path):
    bench = Bench(tmp_path)
    bench.ask(**ON)
    bench.run(60.0)
    assert bench.supply.on
    return bench


@pytest.mark.parametrize(
    ("facts", "action"),
    [
        ({}, "stay"),
        ({"silent_s": 599.9}, "stay"),
        ({"silent_s": 600.0}, "switch off"),
        ({"silent_s": 900.0, "commanded": False, "pending": True, "alone_s": 900.0}, "stay"),
        ({"commanded": False}, "stay"),
        ({"commanded": False, "alone_s": 10.0}, "leave"),
        ({"commanded": False, "silent_s": 900.0}, "stay"),  # just started: its recorder will ask
        ({"commanded": False, "alone_s": 10.0, "stays": True}, "stay"),
        ({"commanded": False, "alone_s": 2.0, "watchdog_timeout_s": 2.0}, "leave"),
    ],
)
def test_the_next_action(facts, action):
    usual: dict[str, Any] = {
        "silent_s": 0.0,
        "alone_s": 0.0,
        "watchdog_timeout_s": WATCHDOG_S,
        "commanded": True,
        "pending": False,
        "stays": False,
    }
    assert decide_next_action(**{**usual, **facts}) == action


def test_an_unwatched_supply_is_switched_off_once_and_released(bench):
    bench.ask()
    bench.run(WATCHDOG_S - 5.0)
    assert bench.supply.on
    bench.run(WATCHDOG_S)
    assert not bench.supply.on
    assert bench.process.leaves
    kept = read_stored_state(bench.folder)
    assert (kept.output, kept.state.command) == ("off", None)
    assert kept.state.tripped.startswith("no recorder heartbeat for 600 s")
    # The next recorder finds it in the next process, and only a person's order ends it.
    bench.restart()
    bench.run(5.0)
    assert {"supply_watchdog_trip", "interlock_tripped"} <= bench.active()
    assert bench.energised() == 1
    bench.ask(**ON)
    bench.run(30.0)
    assert bench.active() == set()
    assert bench.supply.on


def test_a_request_restarts_the_watchdog(bench):
    for _ in range(5):
        bench.ask()
        bench.run(WATCHDOG_S - 10.0)
    assert bench.supply.on
    assert bench.active() == set()


def test_a_step_of_utc_neither_switches_off_nor_keeps_on(bench):
    bench.ask()
    bench.clock.ahead_ns = 86_400 * 10**9
    bench.run(WATCHDOG_S - 5.0)
    assert bench.supply.on
    bench.clock.ahead_ns = -86_400 * 10**9
    bench.run(20.0)
    assert not bench.supply.on


def test_a_silent_supply_is_switched_off_before_the_process_ends(bench):
    bench.supply.error = LOST
    bench.run(10 * WATCHDOG_S)
    assert not bench.process.leaves
    assert read_supply_status(bench.folder).state == "unknown"
    assert read_supply_status(bench.folder).switch_off_pending
    bench.supply.error = None
    bench.run(60.0)
    assert not bench.supply.on
    assert bench.process.leaves
    assert not read_supply_status(bench.folder).switch_off_pending


def test_a_supply_without_power_after_the_switch_off_ends_the_process(bench):
    bench.ask("switch off", author="the end of the test")
    bench.supply.error = LOST
    bench.run(30.0)
    assert bench.process.leaves, "62 min were seen"


def test_a_killed_process_keeps_the_interlock(bench):
    bench.ask("trip", reason="hole at B")
    assert not bench.supply.on
    bench.supply.on = True  # at the front panel, while no process runs
    bench.restart()
    bench.run(20.0)
    assert not bench.supply.on
    assert bench.ask()["row"]["supply_tripped"] == "hole at B"


def test_a_killed_process_leaves_the_output_and_the_next_one_continues(bench):
    before = bench.ask()["row"]
    bench.process.store_state(at_once=True)
    bench.clock.advance(100.0)
    bench.restart()
    bench.run(60.0)
    after = bench.ask()["row"]
    assert bench.supply.on
    assert (bench.energised(), bench.supply.calls.count("make_safe")) == (1, 0)
    assert after["charge_coulomb"] > before["charge_coulomb"] > 0.0
    assert after["unknown_s"] >= 100.0
    assert bench.active() == set()


def test_a_restarted_process_counts_the_earlier_silence(bench):
    bench.ask()
    bench.run(WATCHDOG_S - 10.0)
    bench.process.store_state(at_once=True)
    bench.restart()
    bench.run(GRACE_S - 5.0)
    assert bench.supply.on, "a recorder that starts it has a moment to be heard"
    bench.run(20.0)
    assert not bench.supply.on


def test_a_late_command_is_rejected(bench):
    bench.ask("switch off", author="Ada")
    answer = bench.ask(**ON, until_boot_ns=bench.clock.now_ns - 1)
    assert answer["error"] == "it came too late, nothing was done"
    assert not bench.supply.on


# Hand-over ----------------------------------------------------------------------------------------


def hand_over(bench, port="COM4"):
    bench.ask("hand over", why="another configuration", supply_port=port)
    bench.process.step()


def test_handing_over_releases_port_and_lock_and_stays_until_the_successor_has_read(bench):
    hand_over(bench)
    assert (bench.locks, bench.ports) == (0, 0)
    assert "released" in bench.ask(**ON)
    old = bench.process
    bench.restart()  # the successor
    bench.run(5.0)
    old.step()
    old.step()
    assert old.leaves
    assert bench.supply.on
    assert bench.ask()["commanded"], "the command is still in force"
    assert "make_safe" not in bench.supply.calls


@pytest.mark.parametrize("successor", ["none", "with another port", "without rights"])
def test_without_a_successor_that_reads_it_switches_off_itself(bench, successor):
    hand_over(bench)
    old = bench.process
    if successor != "none":
        supply, bench.supply = bench.supply, ScriptedSupply(bench.clock)
        bench.supply.error = LOST
        bench.restart()
        bench.supply, new = supply, bench.process
        for _ in range(30):
            new.step()
            bench.clock.advance(0.1)
    bench.process = old
    bench.run(8.0, step_s=1.0)
    assert bench.supply.on is (successor == "none")
    bench.run(6.0, step_s=1.0)
    assert not bench.supply.on
    assert old.leaves
    kept = read_stored_state(bench.folder)
    assert successor != "none" or (kept.state.command, kept.output) == (None, "off")


def test_a_supply_that_does_not_answer_is_switched_off_after_the_hand_over_when_it_does(bench):
    hand_over(bench)
    bench.supply.error = LOST
    bench.run(WATCHDOG_S)
    assert not bench.process.leaves
    bench.supply.error = None
    bench.run(10.0)
    assert (bench.process.leaves, bench.supply.on, bench.ports) == (True, False, 0)


def test_before_a_successor_with_another_port_it_switches_off(bench):
    bench.supply.error = LOST
    hand_over(bench, "COM5")
    bench.run(30.0)
    assert bench.ports == 1, "not released while the output may be on"
    assert "supply_switch_off_pending" in bench.active()
    bench.supply.error = None
    bench.run(30.0, step_s=1.0)
    assert (bench.ports, bench.supply.on, bench.process.leaves) == (0, False, True)


@pytest.mark.parametrize("port", ["COM4", "COM5"])
def test_a_port_at_which_it_never_read_the_supply_is_released_at_once(tmp_path, port):
    """The port may be wrong, and the next process may reach the supply."""
    write_stored_state(tmp_path, stamp_state(DriveState(must_switch_off=True), supply_port="COM7"))
    bench = Bench(tmp_path)
    bench.supply.error = LOST
    bench.run(60.0)
    hand_over(bench, port)
    assert (bench.locks, bench.ports) == (0, 0)


def test_the_process_ends_only_after_the_output_reads_off(bench):
    bench.supply.current_a = 0.95
    bench.run(0.5 * WATCHDOG_S)
    kept = read_stored_state(bench.folder)
    assert (bench.process.leaves, kept.output) == (True, "off")


def test_stopped_while_it_waits_for_a_successor_it_switches_off(bench):
    hand_over(bench)
    bench.process.end()
    assert not bench.supply.on


def test_an_invalid_request_gets_an_error_response(bench):
    assert "error" in bench.ask("energise")
    assert bench.energised() == 1


def test_a_full_disk_does_not_affect_the_supply_process(bench, monkeypatch):
    def full(*_):
        raise OSError("no space left on device")

    bench.process.store_state(at_once=True)
    monkeypatch.setattr("daq_service.corrosion_drive.own_process.write_stored_state", full)
    bench.ask()
    bench.run(50.0)
    assert bench.ask()["written_age_s"] == pytest.approx(50.0, abs=0.1)  # the clock's steps of 5 s
    bench.run(WATCHDOG_S + 60.0)
    assert not bench.supply.on


def test_a_disk_that_hangs_delays_neither_interlock_nor_unwatched_limit(tmp_path):
    bench, jobs = Bench(tmp_path), list[Callable[[], None]]()
    bench.restart(jobs=jobs.append)  # none of them ever ends
    bench.ask(**ON)
    bench.supply.current_a = 0.95
    bench.run(40.0)
    assert not bench.supply.on, "a short circuit"
    bench.supply.current_a = 0.2
    bench.ask(**ON)
    bench.run(WATCHDOG_S + 10.0)
    assert not bench.supply.on
    assert (len(jobs) > 1, read_stored_state(tmp_path)) == (True, None)


def test_the_process_switches_the_supply_off_when_it_ends(bench):
    bench.process.end()
    assert not bench.supply.on
    kept = read_stored_state(bench.folder)
    assert kept.state.tripped == "the supply process was stopped, no other one supervises the output"


@pytest.mark.parametrize("ending", [SystemExit(0), KeyboardInterrupt()], ids=repr)
def test_a_library_that_ends_the_process_does_not_leave_the_output_on(ending, tmp_path):
    class EndsOnce(ScriptedSupply):
        def read(self, timeout_s):
            if not self.calls:
                self._call("read")
                raise ending
            return super().read(timeout_s)

    supply = EndsOnce(TestClock())
    supply.on = True
    with pytest.raises(type(ending)):
        run_supply_process(
            PARAMETERS, tmp_path, lambda: nullcontext(supply), Event(), supply_port="COM4", stays=False
        )
    assert not supply.on


def test_the_process_reports_a_failed_switch_off_when_it_ends(bench):
    bench.supply.error = LOST
    with pytest.raises(RigError, match="may still be on; switch it off by hand") as unsafe:
        bench.process.end()
    assert unsafe.value.exit_code == 3


def test_a_supply_that_never_responded_is_given_up(tmp_path):
    bench = Bench(tmp_path)
    bench.supply.error = LOST
    bench.run(60.0)
    assert bench.process.leaves


@pytest.mark.parametrize("content", ["", "{}", "[]", '{"state": {"charge": 7}}'])
def test_a_state_that_cannot_be_read_counts_as_on(tmp_path, content):
    (tmp_path / DRIVE_FILE).write_text(content, encoding="utf-8")
    now = read_supply_status(tmp_path)
    assert (now is not None, now and now.switch_off_pending, now and now.state) == (True, True, "unknown")
    bench = Bench(tmp_path)
    bench.supply.on, bench.supply.error = True, LOST
    bench.run(2 * WATCHDOG_S)
    assert not bench.process.leaves
    bench.supply.error = None
    bench.run(10.0)
    assert not bench.supply.on


@pytest.mark.parametrize(("away_s", "on"), [(WATCHDOG_S - 10.0, True), (WATCHDOG_S + 10.0, False)])
def test_a_command_ends_when_no_process_ran_for_the_unwatched_limit(bench, away_s, on):
    bench.process.store_state(at_once=True)
    bench.clock.advance(away_s)
    bench.restart()
    bench.run(10.0)
    assert bench.supply.on is on
    assert ("supply_on_unexpectedly" in bench.active()) is not on


def test_a_command_ends_with_its_boot(bench, monkeypatch):
    monkeypatch.setattr("daq_service.corrosion_drive.own_process.boot_name", lambda: "another")
    bench.restart()
    bench.run(10.0)
    assert not bench.supply.on
    assert "supply_on_unexpectedly" in bench.active()


def test_a_state_of_an_older_version_is_read(tmp_path):
    state = '{"charge": {"coulomb": 1.5, "unknown_s": 0.0}, "tripped": "hole", "unwatched": true, '
    state += '"output_on": %s, "booked_utc_ns": 5}'
    stored_fields = (
        '"output": "off", "age_s": 1.0, "utc_ns": 1, "boot_ns": 1, "boot_id": "b", "heard_boot_ns": 1'
    )
    for output_on, command in (("true", Command()), ("false", None), ("null", None)):
        (tmp_path / DRIVE_FILE).write_text(
            f'{{"state": {state % output_on}, {stored_fields}}}', encoding="utf-8"
        )
        kept = read_stored_state(tmp_path)
        assert kept.state.command == command
        assert (kept.state.tripped, kept.state.latched) == ("hole", {"supply_watchdog_trip"})


def test_a_supply_that_is_on_is_never_given_up(tmp_path):
    write_stored_state(
        tmp_path, stamp_state(DriveState(command=Command()), boot_ns=10**18, heard_boot_ns=10**18)
    )
    bench = Bench(tmp_path)
    bench.supply.error = LOST
    bench.run(2 * WATCHDOG_S)
    assert not bench.process.leaves


# Stored state --------------------------------------------------------------------------------------


def test_the_stored_state_reads_back_equal(tmp_path):
    state = DriveState(
        charge=Charge(coulomb=1.5),
        tripped="hole",
        latched=frozenset({"a", "b"}),
        command=Command(voltage_v=5.0),
    )
    kept = stamp_state(state, output="off", age_s=1.0, heard_boot_ns=5, good_for_s=30.0)
    write_stored_state(tmp_path, kept)
    assert read_stored_state(tmp_path) == kept
    assert read_stored_state(tmp_path / "absent") is None


@pytest.mark.parametrize(
    ("changes", "age_s"),
    [
        (lambda kept: {"boot_ns": kept.boot_ns - 100 * 10**9}, 102.0),
        (lambda kept: {"boot_id": "another", "utc_ns": kept.utc_ns - 3600 * 10**9}, 3602.0),
        (lambda kept: {}, 2.0),  # a moment ago, but its process has gone
    ],
    ids=["in this boot", "before the reboot", "just now"],
)
def test_a_reader_gets_the_age_of_the_supply_state(tmp_path, changes, age_s):
    assert boot_name() is not None
    kept = stamp_state(DriveState(), output="on", age_s=2.0, good_for_s=30.0)
    write_stored_state(tmp_path, replace(kept, **changes(kept)))
    now = read_supply_status(tmp_path)
    assert now.age_s == pytest.approx(age_s, abs=20.0)  # a busy machine is late
    assert (now.state, now.quality, now.last, now.process) == ("unknown", "no_communication", "on", False)
