"""The recorder's side of the drive's process: found, started, asked; and the channel between them."""

import socket
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from support.scripted_supply import ScriptedSupply
from support.serial_rig import TestClock

from daq_service.corrosion_drive.channel import HOST, Server, opened, sealed
from daq_service.corrosion_drive.charge import Charge, DriveState
from daq_service.corrosion_drive.kept import Address, own_drive, read_kept
from daq_service.corrosion_drive.own_process import DriveProcess, fingerprint
from daq_service.corrosion_drive.remote import COMES_WITHIN_S, RemoteDrive, answered_within_s
from hardware_drivers.errors import ConfigurationError, ConnectionLostError
from hardware_drivers.serial_port.parameters import SerialLineParameters, SupplyParameters

KEY = b"k" * 32
PARAMETERS = SupplyParameters(line=SerialLineParameters(port="COM4"), identity="ANY", log_interval_s=10.0)
PATIENCE = 2000


class Child:
    """A process that was started and does not come up."""

    returncode: int | None = None

    def poll(self) -> int | None:
        return self.returncode


class Bench:
    """A recorder's remote drive, and its process in the same thread; time passes by hand."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.now_s = folder, 0.0
        self.child, self.started = Child(), 0
        self.supply = ScriptedSupply(TestClock())
        self.process: DriveProcess | None = None
        self.server: Server | None = None
        self.life = ExitStack()
        self.remote = RemoteDrive(
            PARAMETERS,
            folder,
            self.start,  # type: ignore[arg-type]
            mono_s=lambda: self.now_s,
            pause=self.pause,
        )

    def start(self) -> Child:
        self.started += 1
        return self.child

    def comes_up(self, *, agreed: str = fingerprint(PARAMETERS)) -> None:
        """Let the process begin."""
        self.server = self.life.enter_context(Server(KEY))
        address = Address(port=self.server.port, key=KEY.hex(), fingerprint=agreed)
        self.life.enter_context(own_drive(self.folder, address))
        self.process = DriveProcess(self.supply, PARAMETERS, self.folder)

    def is_killed(self) -> None:
        self.life.close()
        self.server = self.process = None

    def pause(self, seconds: float) -> None:
        self.now_s += seconds
        if self.server is not None and self.process is not None:
            self.process.step()
            self.server.serve(seconds, self.process.answer)

    def until_told(self, **row: Any) -> None:
        """Tick until the row says so."""
        for _ in range(PATIENCE):
            self.remote.tick()
            self.pause(0.01)
            told = self.remote.row(0, 0.0)
            if all(getattr(told, name) == value for name, value in row.items()):
                return
        pytest.fail(f"never told: {row}, but {told}")

    def active(self) -> dict[str, str]:
        return {found.name: found.message for found in self.remote.conditions() if found.active}


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(tmp_path)
    with bench.remote:
        bench.remote.begin(DriveState())
        yield bench
    bench.is_killed()


def test_orders_go_through_and_their_answers_come_back(bench: Bench) -> None:
    bench.comes_up()
    bench.remote.energise("Ada", voltage_v=5.0)
    assert bench.supply.on
    assert "energise 5 V 1 A" in bench.supply.calls
    bench.until_told(supply_state="on", supply_quality="good")
    assert bench.active() == {}
    assert bench.remote.trip("hole at B") is True
    assert not bench.supply.on
    bench.until_told(supply_tripped="hole at B", supply_state="off")
    assert "interlock_tripped" in bench.active()


def test_a_refusal_is_an_error_with_its_reason(bench: Bench) -> None:
    bench.comes_up()
    bench.supply.error = ConnectionLostError("the supply does not answer")
    with pytest.raises(ConfigurationError, match="the supply does not answer"):
        bench.remote.energise("Ada")


def test_where_nobody_is_a_process_is_started_and_again_ever_later(bench: Bench) -> None:
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


def test_before_the_first_answer_nothing_is_known_and_after_a_while_that_is_an_alarm(bench: Bench) -> None:
    bench.remote.tick()
    row = bench.remote.row(3, 1.5)
    assert (row.set_index, row.supply_state, row.supply_quality) == (3, "unknown", "stale")
    assert bench.active() == {}
    bench.now_s += COMES_WITHIN_S
    assert "the process of the drive does not answer" in bench.active()["supply_lost"]


def test_a_process_that_is_gone_is_unknown_at_once_with_its_age(bench: Bench) -> None:
    bench.comes_up()
    bench.remote.energise("Ada")
    bench.until_told(supply_state="on")
    unknown_s = bench.remote.row(0, 0.0).unknown_s or 0.0
    bench.is_killed()
    bench.until_told(supply_state="unknown", supply_quality="lost")
    assert list(bench.active()) == ["supply_lost"]
    bench.now_s += 100.0
    row = bench.remote.row(0, 0.0)
    assert row.supply_age_s is not None
    assert row.supply_age_s >= 100.0
    assert (row.unknown_s or 0.0) - unknown_s >= 100.0
    with pytest.raises(ConnectionLostError, match="nothing was sent to it"):
        bench.remote.energise("Ada")
    bench.comes_up()
    bench.until_told(supply_state="on")
    assert bench.active() == {}


def test_an_interlock_that_nobody_heard_is_told_first_when_the_process_is_back(bench: Bench) -> None:
    bench.comes_up()
    bench.remote.energise("Ada")
    bench.is_killed()
    assert bench.remote.trip("hole at B") is False
    assert bench.remote.row(0, 0.0).supply_tripped == "hole at B"
    assert bench.supply.on
    bench.comes_up()
    bench.until_told(supply_state="off", supply_tripped="hole at B")
    assert not bench.supply.on


def test_a_process_that_stands_still_is_waited_for_no_longer_than_it_may_take(bench: Bench) -> None:
    bench.comes_up()
    bench.until_told(supply_quality="good")
    bench.process = None  # it hears nothing more
    bench.remote.tick()
    before_s = bench.now_s
    with pytest.raises(ConnectionLostError):
        bench.remote.energise("Ada")
    assert bench.now_s - before_s <= COMES_WITHIN_S + answered_within_s(PARAMETERS) + 1.0
    assert not bench.supply.on


def test_an_order_that_is_not_answered_is_unknown_and_not_repeated(bench: Bench) -> None:
    bench.comes_up()
    bench.until_told(supply_quality="good")
    asleep, bench.process = bench.process, None
    with pytest.raises(ConnectionLostError, match="look before the order is given again"):
        bench.remote._order("energise", author="Ada", voltage_v=None, current_limit_a=None)
    bench.process = asleep
    assert asleep is not None
    for _ in range(50):
        bench.remote.tick()
        bench.pause(0.01)
    assert sum(call.startswith("energise") for call in bench.supply.calls) <= 1


def test_a_process_of_another_configuration_is_asked_to_hand_over_and_never_obeyed(bench: Bench) -> None:
    bench.comes_up(agreed="another")
    for _ in range(PATIENCE):
        bench.remote.tick()
        bench.pause(0.01)
        if bench.process is not None and bench.process.leaves:
            break
    assert bench.process is not None
    assert bench.process.leaves
    assert bench.remote.row(0, 0.0).supply_state == "unknown"


def test_the_means_of_a_set_begin_behind_the_readings_of_its_row(bench: Bench) -> None:
    bench.comes_up()
    bench.remote.energise("Ada")
    bench.until_told(supply_state="on", voltage_max_v=10.0)
    bench.remote.begin_window()
    bench.until_told(current_a=None)


def test_the_first_process_takes_over_what_the_catalogue_says_a_later_one_what_was_kept(bench: Bench) -> None:
    (bench.folder / "drive.json").unlink()
    bench.remote.begin(DriveState(charge=Charge(coulomb=7.0)))
    bench.remote.begin(DriveState(charge=Charge(coulomb=1.0)))
    kept = read_kept(bench.folder)
    assert kept is not None
    assert kept.state.charge.coulomb == 7.0


# The channel ---------------------------------------------------------------------------------------


def test_a_line_is_opened_with_the_key_that_sealed_it() -> None:
    line = sealed(KEY, {"id": 1, "do": "look"})
    assert opened(KEY, line) == {"id": 1, "do": "look"}
    assert opened(b"other", line) is None
    assert opened(KEY, line.replace(b"look", b"evil")) is None


@pytest.mark.parametrize(
    "said", [sealed(b"other", {"id": 1}), b"x" * 200_000, b"\n"], ids=["key", "flood", "empty"]
)
def test_a_stranger_is_sent_away_and_keeps_nobody_waiting(said: bytes) -> None:
    answered: list[Any] = []

    def answer(message: Any) -> Any:
        answered.append(message)
        return {"id": message["id"]}

    with Server(KEY) as server, socket.create_connection((HOST, server.port)) as silent:
        with socket.create_connection((HOST, server.port)) as stranger:
            stranger.settimeout(10.0)
            stranger.setblocking(False)
            rest = memoryview(said)
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
            friend.sendall(sealed(KEY, {"id": 5}))
            for _ in range(PATIENCE):
                server.serve(0.01, answer)
                if answered:
                    break
            friend.settimeout(10.0)
            assert opened(KEY, friend.recv(1000)) == {"id": 5}
        assert silent.fileno() > 0
    assert answered == [{"id": 5}]
