"""The recorder's client of the supply process: discovery, start, requests, and the channel."""

import socket
from contextlib import ExitStack, nullcontext
from typing import Any

import pytest
from support.machine import clock_in_seconds
from support.scripted_supply import ScriptedSupply, supply_parameters
from support.serial_rig import TestClock

from daq_service.clock import MachineClock
from daq_service.corrosion_drive.channel import HOST, Server, sign_message, verify_line
from daq_service.corrosion_drive.charge import Charge, Command, DriveState
from daq_service.corrosion_drive.guard import DriveGuard
from daq_service.corrosion_drive.own_process import DriveProcess, hash_supply_settings
from daq_service.corrosion_drive.remote import (
    COMES_WITHIN_S,
    ENDS_WITHIN_S,
    RemoteDrive,
    longest_answer_time_s,
)
from daq_service.corrosion_drive.supply_state import (
    Address,
    hold_supply_lock,
    read_stored_state,
    stamp_state,
    write_stored_state,
)
from daq_service.processes.data_folder import DRIVE_FILE
from hardware_drivers.errors import ConnectionLostError
from hardware_drivers.nanoseconds import NS_PER_S

KEY = b"k" * 32
PARAMETERS = supply_parameters()
PATIENCE = 2000
ON: dict[str, Any] = {"do": "energise", "author": "Ada", "voltage_v": None, "current_limit_a": None}


class Child:
    """Started process that does not come up."""

    returncode: int | None = None

    def poll(self):
        return self.returncode


class Bench:
    """Remote supply of a recorder and its process in one thread on a manual clock."""

    def __init__(self, folder):
        self.folder, self.now_s = folder, 0.0
        self.child, self.started, self.killed = Child(), 0, 0
        self.supply = ScriptedSupply(TestClock())
        self.process: DriveProcess | None = None
        self.server: Server | None = None
        self.life = ExitStack()
        self.remote = RemoteDrive(
            PARAMETERS,
            folder,
            self.start,
            supply_port="COM4",
            machine=MachineClock(mono_ns=lambda: round(self.now_s * NS_PER_S), sleep=self.pause),
            kill=self.is_killed,
        )

    def start(self):
        self.started += 1
        return self.child

    def comes_up(self, *, agreed: str = hash_supply_settings(PARAMETERS)):
        """Start the process."""
        self.server = self.life.enter_context(Server(KEY))
        address = Address(port=self.server.port, key=KEY.hex(), fingerprint=agreed)
        self.process = DriveProcess(
            lambda: hold_supply_lock(self.folder, address),
            lambda: nullcontext(self.supply),
            PARAMETERS,
            self.folder,
            supply_port="COM4",
        )
        self.life.callback(self.process.close)

    def is_killed(self, process=0):
        self.killed += 1
        self.life.close()
        self.server = self.process = None

    def pause(self, seconds):
        self.now_s += seconds
        if self.server is not None and self.process is not None:
            self.process.step()
            self.server.serve(seconds, self.process.answer_request)

    def wait_for_row(self, **row):
        """Tick until the row has these values."""
        for _ in range(PATIENCE):
            self.remote.tick()
            self.pause(0.01)
            latest = self.remote.build_row(0, 0.0)
            if all(getattr(latest, name) == value for name, value in row.items()):
                return
        pytest.fail(f"never told: {row}, but {latest}")

    def answer(self, reply, *, step_s=0.01):
        """Tick until the reply is complete; return its error."""
        for _ in range(PATIENCE):
            if reply.done or reply.error:
                return reply.error
            self.pause(step_s)
            self.remote.tick()
        pytest.fail("never answered")

    def active(self):
        return {found.name: found.values for found in self.remote.list_conditions() if found.active}


@pytest.fixture
def bench(tmp_path):
    bench = Bench(tmp_path)
    with bench.remote:
        bench.remote.store_catalogue_state(DriveState())
        yield bench
    bench.is_killed()


def test_commands_are_sent_and_their_results_returned(bench):
    bench.comes_up()
    assert bench.answer(bench.remote.energise("Ada", voltage_v=5.0)) == ""
    assert bench.supply.on
    assert "energise 5 V 1 A" in bench.supply.calls
    bench.wait_for_row(supply_state="on", supply_quality="good")
    assert bench.active() == {}
    bench.remote.trip("hole at B")
    bench.wait_for_row(supply_tripped="hole at B", supply_state="off")
    assert not bench.supply.on
    assert "interlock_tripped" in bench.active()


def test_a_command_does_not_wait_for_its_answer(bench):
    bench.comes_up()
    bench.wait_for_row(supply_quality="good")
    bench.process = None  # it stalls
    before_s = bench.now_s
    reply = bench.remote.energise("Ada")
    bench.remote.switch_off("Ada")
    bench.remote.trip("hole at B")
    assert (reply.done, reply.error, bench.now_s) == (False, "", before_s)


def test_a_refusal_is_an_error_with_its_reason(bench):
    bench.comes_up()
    bench.supply.error = ConnectionLostError("the supply does not answer")
    assert "the supply does not answer" in bench.answer(bench.remote.energise("Ada"))


def test_a_missing_process_is_started_with_growing_intervals(bench):
    bench.remote.tick()
    assert bench.started == 1
    bench.now_s += 10.0
    bench.remote.tick()
    assert bench.started == 1, "it is coming up"
    bench.child.returncode = 1
    for _ in range(100):
        bench.now_s += 1.0
        bench.remote.tick()
    assert 4 <= bench.started <= 8


def test_a_missing_first_response_raises_an_alarm_after_a_while(bench):
    bench.remote.tick()
    row = bench.remote.build_row(3, 1.5)
    assert (row.set_index, row.supply_state, row.supply_quality) == (3, "unknown", "stale")
    assert bench.active() == {}
    bench.now_s += COMES_WITHIN_S
    assert bench.active()["supply_not_responding"]["read_error"] == "its process does not respond"


def test_a_missing_process_gives_an_unknown_state_with_its_age(bench):
    bench.comes_up()
    bench.answer(bench.remote.energise("Ada"))
    bench.wait_for_row(supply_state="on")
    unknown_s = bench.remote.build_row(0, 0.0).unknown_s or 0.0
    bench.is_killed()
    bench.wait_for_row(supply_state="unknown", supply_quality="no_communication")
    assert list(bench.active()) == ["supply_not_responding"]
    bench.now_s += 100.0
    row = bench.remote.build_row(0, 0.0)
    assert row.supply_age_s >= 100.0
    assert (row.unknown_s or 0.0) - unknown_s >= 100.0
    assert "nothing was sent to it" in bench.answer(bench.remote.energise("Ada"), step_s=1.0)
    bench.comes_up()
    bench.wait_for_row(supply_state="on")
    assert bench.active() == {}


def test_a_trip_that_reached_no_process_is_sent_first_to_the_next_one(bench):
    bench.comes_up()
    bench.answer(bench.remote.energise("Ada"))
    bench.is_killed()
    bench.remote.trip("hole at B")
    bench.remote.tick()
    assert bench.remote.build_row(0, 0.0).supply_tripped == "hole at B"
    assert bench.supply.on
    assert {"interlock_tripped", "supply_switch_off_pending"} <= bench.active().keys()
    assert bench.active()["interlock_tripped"]["unverified"] is True
    bench.comes_up()
    bench.wait_for_row(supply_state="off", supply_tripped="hole at B")
    assert not bench.supply.on
    assert list(bench.active()) == ["interlock_tripped"]
    assert bench.active()["interlock_tripped"]["unverified"] is None


@pytest.mark.parametrize("command", ["energise", "switch_off"])
def test_a_process_that_stalls_is_killed_and_the_output_switched_off(bench, command):
    bench.comes_up()
    bench.answer(bench.remote.energise("Ada"))
    bench.process = None  # it stalls
    reply = getattr(bench.remote, command)("Ada")
    assert "what the output does is unknown" in bench.answer(reply, step_s=1.0)
    assert bench.killed == 1
    assert bench.now_s <= longest_answer_time_s(PARAMETERS) + 3.0
    assert "supply_switch_off_pending" in bench.active()
    bench.remote.tick()
    assert bench.started == 1, "another one"
    bench.comes_up()
    bench.wait_for_row(supply_state="off")
    assert not bench.supply.on
    assert bench.active() == {}


def test_a_stalled_process_is_replaced_also_without_a_command(bench):
    bench.comes_up()
    bench.answer(bench.remote.energise("Ada"))
    bench.process = None
    for _ in range(round(longest_answer_time_s(PARAMETERS)) + 3):
        bench.now_s += 1.0
        bench.remote.tick()
    assert bench.killed == 1
    bench.comes_up()
    bench.wait_for_row(supply_state="on")
    assert bench.supply.on, "the command is still in force"


def test_a_process_that_hands_over_is_shown_until_it_has_released_the_supply(bench):
    bench.comes_up(agreed="another")
    bench.supply.error = ConnectionLostError("gone")
    bench.remote.tick()
    bench.pause(0.01)
    bench.supply.error = None
    for _ in range(PATIENCE):
        bench.remote.tick()
        if bench.started:
            break
        bench.pause(0.01)
    assert bench.started == 1, "the lock is free for the successor"
    assert not bench.process.leaves, "the old one waits for it"


def test_a_process_with_an_old_command_is_notified_of_its_end(bench):
    bench.comes_up()
    bench.answer(bench.remote.energise("Ada"))
    old = (bench.folder / "drive.json").read_bytes()
    bench.answer(bench.remote.switch_off("Ada"))
    bench.is_killed()
    (bench.folder / "drive.json").write_bytes(old)  # the disk was full
    bench.supply.on = True  # at the front panel
    bench.comes_up()
    bench.wait_for_row(supply_state="off")
    assert not bench.supply.on


@pytest.mark.parametrize("process", ["stalls", "is gone"])
def test_at_the_end_a_process_that_does_not_answer_is_replaced_by_one_that_switches_off(bench, process):
    bench.comes_up()
    bench.answer(bench.remote.energise("Ada"))
    if process == "is gone":
        bench.is_killed()
    else:
        bench.process = None
    before_s = bench.now_s
    with pytest.raises(ConnectionLostError, match="another one switches off"):
        bench.remote.switch_off_at_end()
    assert bench.now_s - before_s <= ENDS_WITHIN_S + 0.1
    assert (bench.killed, bench.process) == (1, None)
    bench.comes_up()
    bench.process.step()
    assert not bench.supply.on


def test_a_command_without_an_answer_at_the_recorder_s_end_is_followed_by_a_switch_off(bench):
    bench.comes_up()
    bench.wait_for_row(supply_quality="good")
    asleep, bench.process = bench.process, None
    bench.remote.energise("Ada")
    bench.remote.__exit__()
    bench.process = asleep
    for _ in range(10):
        bench.pause(0.01)
    assert "energise 10 V 1 A" in bench.supply.calls
    assert not bench.supply.on


# The guard of a supervisor --------------------------------------------------------------------------


class Guarded(Bench):
    """Bench whose remote supply does not watch."""

    def __init__(self, folder):
        super().__init__(folder)
        self.remote = RemoteDrive(
            PARAMETERS,
            folder,
            self.start,
            watches=False,
            machine=clock_in_seconds(lambda: self.now_s),
            kill=self.is_killed,
        )
        self.guard = DriveGuard(
            folder, self.remote, check_every_s=600.0, machine=clock_in_seconds(lambda: self.now_s)
        )

    def look(self, seconds):
        for _ in range(round(seconds)):
            self.guard.check()
            self.pause(0.0)
            self.now_s += 1.0


@pytest.fixture
def guarded(tmp_path):
    guarded = Guarded(tmp_path)
    with guarded.remote:
        yield guarded
    guarded.is_killed()


@pytest.mark.parametrize(
    ("content", "starts"),
    [
        (None, 0),
        (b"{torn", 1),
        (stamp_state(DriveState(command=Command()), output="on"), 1),
        (stamp_state(DriveState(must_switch_off=True), output="unknown"), 1),
        (stamp_state(DriveState(), output="off"), 0),
    ],
    ids=["never", "unreadable", "on", "pending", "off"],
)
def test_the_guard_starts_a_process_where_the_output_may_be_on(guarded, content, starts):
    if isinstance(content, bytes):
        (guarded.folder / DRIVE_FILE).write_bytes(content)
    elif content is not None:
        write_stored_state(guarded.folder, content)
    guarded.look(20.0)
    assert guarded.started == starts


def test_the_guard_looks_again_at_an_output_that_was_off(guarded):
    write_stored_state(guarded.folder, stamp_state(DriveState(), output="off"))
    guarded.look(590.0)
    assert guarded.started == 0
    guarded.look(20.0)
    assert guarded.started == 1


def test_the_guard_replaces_a_process_that_stalls_and_is_no_recorder(guarded):
    guarded.comes_up()
    guarded.process.answer_request({"id": 1, **ON})
    heard_ns = guarded.process._heard_ns
    guarded.look(20.0)
    assert guarded.process._heard_ns == heard_ns
    assert guarded.killed == 0
    guarded.process = None
    guarded.look(longest_answer_time_s(PARAMETERS) + 5.0)
    assert guarded.killed == 1
    guarded.look(10.0)
    assert guarded.started == 1


def test_the_means_of_a_set_start_after_the_readings_of_its_row(bench):
    bench.comes_up()
    bench.answer(bench.remote.energise("Ada"))
    bench.wait_for_row(supply_state="on", voltage_max_v=10.0)
    bench.remote.restart_means()
    bench.wait_for_row(current_a=None)


def test_the_first_process_starts_from_the_catalogue_a_later_one_from_the_file(bench):
    (bench.folder / "drive.json").unlink()
    bench.remote.store_catalogue_state(DriveState(charge=Charge(coulomb=7.0)))
    bench.remote.store_catalogue_state(DriveState(charge=Charge(coulomb=1.0)))
    kept = read_stored_state(bench.folder)
    assert kept.state.charge.coulomb == 7.0


# The channel ---------------------------------------------------------------------------------------


def test_a_message_is_decoded_only_with_its_key():
    line = sign_message(KEY, {"id": 1, "do": "look"})
    assert verify_line(KEY, line) == {"id": 1, "do": "look"}
    assert verify_line(b"other", line) is None
    assert verify_line(KEY, line.replace(b"look", b"evil")) is None


@pytest.mark.parametrize(
    "data", [sign_message(b"other", {"id": 1}), b"x" * 200_000, b"\n"], ids=["key", "flood", "empty"]
)
def test_an_unauthenticated_client_is_disconnected_without_delaying_others(data):
    answered: list[Any] = []

    def answer(message):
        answered.append(message)
        return {"id": message["id"]}

    with Server(KEY) as server, socket.create_connection((HOST, server.port)) as silent:
        with socket.create_connection((HOST, server.port)) as stranger:
            stranger.settimeout(10.0)
            stranger.setblocking(False)
            rest = memoryview(data)
            for _ in range(PATIENCE):
                server.serve(0.0, answer)
                try:
                    rest = rest[stranger.send(rest) :] if rest else rest
                    if stranger.recv(1) == b"":
                        break
                except BlockingIOError:
                    continue
                except ConnectionError:
                    break
            else:
                pytest.fail("the stranger stays connected")
        with socket.create_connection((HOST, server.port)) as friend:
            friend.sendall(sign_message(KEY, {"id": 5}))
            for _ in range(PATIENCE):
                server.serve(0.01, answer)
                if answered:
                    break
            friend.settimeout(10.0)
            assert verify_line(KEY, friend.recv(1000)) == {"id": 5}
        assert silent.fileno() > 0
    assert answered == [{"id": 5}]
