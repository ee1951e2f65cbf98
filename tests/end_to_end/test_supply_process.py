"""The supply process: when any other process ends, the supply is never left on unwatched."""

import os
import signal
import subprocess
import threading
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from support.command_line import SOLIMON, solimon_here
from support.notify_socket import notify_socket
from support.small_experiment import disturbed_rig, small_settings
from support.waiting import ended, until

from daq_service.catalogue import open_catalogue
from daq_service.catalogue.errors import NoDataYetError
from daq_service.catalogue.rows import AlarmRow, EnvironmentRow, EventRow, SetRow
from daq_service.cli.run import create_supply_client
from daq_service.cli.status.facts import describe_status
from daq_service.clock import WallClock
from daq_service.corrosion_drive.supply_state import read_supply_status
from daq_service.errors import RigError, StorageError
from daq_service.processes.data_folder import (
    DRIVE_LOCK,
    hold_recorder_lock,
    is_held,
    prepare_data_folder,
    read_lock_owner,
    write_configuration,
)
from daq_service.processes.heartbeat import read_heartbeat
from daq_service.recording.resources import Host, SessionOptions
from daq_service.recording.session import record_test
from daq_service.rig.open_rig import open_rig
from daq_service.settings.tree import Settings
from simulator.doubles.serial.instruments import SerialInstruments
from simulator.doubles.serial.link import find_missing_terminal_reason
from simulator.doubles.serial.supply import Cell, Supply

NO_TERMINALS = find_missing_terminal_reason()
pytestmark = pytest.mark.skipif(bool(NO_TERMINALS), reason=NO_TERMINALS or "available")

SECOND_H = 1.0 / 3600.0
WATCHED_S, WATCHDOG_S = 600.0, 1.0


@contextmanager
def without_supply(settings, clock, epoch_utc_ns):
    """Open the twin without the supply, which belongs to another process."""
    rig = settings.rig.model_copy(update={"supply": None})
    with open_rig(settings.model_copy(update={"rig": rig}), clock, epoch_utc_ns) as opened:
        yield opened


@dataclass
class Test:
    """Folder of a test and its supply, with recorders in this process and a supply process."""

    __test__ = False

    folder: Path
    instruments: SerialInstruments
    orders: list[int] = field(default_factory=list)

    def settings(self, *, watchdog_timeout_s=WATCHED_S, off_at_end=True):
        """Return settings of a set per second on the twin, with the supply."""
        return small_settings(
            clock={"kind": "wall"},
            schedule={
                "phases": [{"until_h": 600.0 * SECOND_H, "interval_h": SECOND_H}],
                "shots_per_set": 2,
                "shot_interval_s": 0.05,
            },
            baseline={"hours": 100.0},
            rig={
                "stall_timeout_s": 3.0,
                "supply": {
                    "line": {"port": str(self.instruments.supply_link.path), "reply_timeout_s": 5.0},
                    "identity": "SOLIMON,DC SUPPLY DOUBLE",
                    "log_interval_s": 0.2,
                    "off_at_end": off_at_end,
                    "watchdog_timeout_s": watchdog_timeout_s,
                },
            },
        )

    def order(self, kind, **arguments):
        with open_catalogue(self.folder) as catalogue:
            self.orders.append(catalogue.add_command("Ada", kind, arguments))

    def run(self, settings, *, after=None, rig=without_supply, stop=None):
        """Record to the end; act after the n-th set."""
        prepare_data_folder(self.folder)

        def notify(event, **values):
            if event == "progress":
                (after or {}).get(values["done"], lambda: None)()

        assert settings.rig.supply is not None
        near = create_supply_client(settings, settings.rig.supply, self.folder)
        with hold_recorder_lock(self.folder), near as drive:
            return record_test(
                settings,
                self.folder,
                rig,
                stop=stop or threading.Event(),
                report=notify,
                options=SessionOptions(remote_drive=drive),
                host=Host(listen_every_s=0.0, wall_clock=WallClock),
            )

    @contextmanager
    def note_first_set(self, settings):
        """Record in real time next to the test, until the test stops it."""
        stop = threading.Event()
        recorder = threading.Thread(target=self.run, args=(settings,), kwargs={"stop": stop})
        recorder.start()
        try:
            until(lambda: read_supply_status(self.folder), "the drive")
            yield
        finally:
            stop.set()
            ended(recorder, "the stop")

    def switch_on(self):
        """Switch the supply on, as an operator does who sees a set."""
        until(self.has_started, "the recorder")
        self.order("supply_on")
        until(lambda: self.answers() == ["done"], "the answer")

    def run_switched_on(self, settings):
        """Record in real time until an operator has switched the supply on and its charge is stored."""
        with self.note_first_set(settings):
            self.switch_on()
            until(self.has_charge, "a set with its charge")

    def switchings(self):
        return [change.on for change in self.instruments.list_output_changes()]

    def alarms(self):
        with open_catalogue(self.folder) as catalogue:
            return {row.kind: row for row in catalogue.rows(AlarmRow)}

    def has_started(self):
        """Return whether the recorder has reported a first set."""
        try:
            with open_catalogue(self.folder) as catalogue:
                return bool(catalogue.rows(SetRow, limit=1))
        except NoDataYetError:
            return False

    def charge_coulomb(self):
        with open_catalogue(self.folder) as catalogue:
            return max(row.charge_coulomb or 0.0 for row in catalogue.rows(EnvironmentRow))

    def has_charge(self):
        return self.charge_coulomb() > 0.0

    def answers(self):
        with open_catalogue(self.folder) as catalogue:
            rows = [catalogue.command(order) for order in self.orders]
        return [row.state for row in rows if row is not None]

    def drive(self):
        """Return the id of the running supply process."""
        return int(read_lock_owner(self.folder, DRIVE_LOCK).partition("\n")[0].removeprefix("process "))

    def drive_has_left(self):
        return is_held(self.folder, DRIVE_LOCK) is False

    def is_switched_off_unwatched(self):
        """Wait for the switch-off and check the status meanwhile."""
        until(lambda: not self.instruments.supply.on, "the unwatched supply is off")
        until(self.drive_has_left, "the process of the drive has left")
        assert self.switchings() == [True, False]
        now = read_supply_status(self.folder)
        assert now is not None
        assert (now.state, now.last, now.watchdog_trip) == ("unknown", "off", True)
        description = describe_status(self.folder, Settings())["supply"]["description"]
        assert "tripped: no recorder heartbeat" in description


@pytest.fixture
def test(tmp_path):
    (tmp_path / "ports").mkdir()
    with SerialInstruments(tmp_path / "ports", supply=Supply(noise_v=0.0, noise_a=0.0)) as instruments:
        test = Test(tmp_path / "data", instruments)
        yield test
        if is_held(test.folder, DRIVE_LOCK):
            os.kill(test.drive(), signal.SIGKILL)


def test_the_end_switches_off_and_the_process_leaves_also_without_the_supply(test):
    test.run_switched_on(test.settings(watchdog_timeout_s=3.0))
    assert test.switchings() == [True, False], "off when the recorder ends"
    test.instruments.supply_link.unplug()
    until(test.drive_has_left, "the process of the drive has left")
    with open_catalogue(test.folder) as catalogue:
        last = catalogue.rows(EnvironmentRow)[-1]
    assert (last.supply_state, last.supply_quality) == ("on", "good")
    assert last.charge_coulomb is not None
    assert test.alarms() == {}


def test_a_supply_left_on_at_the_end_is_switched_off_when_no_recorder_returns(test):
    settings = test.settings(watchdog_timeout_s=WATCHDOG_S, off_at_end=False)
    test.run_switched_on(settings)
    test.is_switched_off_unwatched()
    # The next recorder reports it, and energizes nothing.
    with test.note_first_set(settings):
        found = until(lambda: test.alarms() if "supply_watchdog_trip" in test.alarms() else None, "the alarm")
        assert found["supply_watchdog_trip"].state == found["interlock_tripped"].state == "unacknowledged"
        assert "No recorder heartbeat" in found["supply_watchdog_trip"].message
        assert test.switchings() == [True, False]
        test.order("supply_on")
        until(lambda: test.instruments.supply.on, "a person's order")
        until(lambda: test.alarms()["supply_watchdog_trip"].state == "returned_unacknowledged", "its return")


@pytest.mark.parametrize(
    "error", [pytest.param(RigError, marks=pytest.mark.slow), StorageError], ids=["exit 3", "exit 4"]
)
def test_the_output_is_switched_off_after_the_final_end_of_a_recorder(test, error):
    def disturb(key, acquired):
        if test.answers() == ["done"] and test.instruments.supply.on:
            raise error("it ends")
        return acquired

    @contextmanager
    def rig(settings, clock, epoch_utc_ns):
        bare = settings.rig.model_copy(update={"supply": None})
        with disturbed_rig(disturb)(settings.model_copy(update={"rig": bare}), clock, epoch_utc_ns) as opened:
            yield opened

    with pytest.raises(error):
        test.run(
            test.settings(watchdog_timeout_s=WATCHDOG_S), after={1: lambda: test.order("supply_on")}, rig=rig
        )
    test.is_switched_off_unwatched()


def test_a_killed_supply_process_is_unknown_and_its_successor_energizes_nothing(test):
    settings = test.settings(off_at_end=False)
    with test.note_first_set(settings):
        until(lambda: is_held(test.folder, DRIVE_LOCK), "the drive")
        test.switch_on()
        first = test.drive()
        os.kill(first, signal.SIGKILL)
        found = until(lambda: test.alarms() or None, "the alarm")
        assert list(found) == ["supply_not_responding"]
        assert "output state unknown" in found["supply_not_responding"].message
        until(
            lambda: test.alarms()["supply_not_responding"].state == "returned_unacknowledged", "another one"
        )
        assert test.drive() != first
        assert test.instruments.supply.on, "it reads what the output does"
        test.order("supply_off")
        until(lambda: not test.instruments.supply.on, "the order")
    assert test.switchings() == [True, False]


@contextmanager
def started(test, word, settings):
    """Run ``solimon record`` or ``run`` on the folder until an operator has switched the supply on."""
    prepare_data_folder(test.folder)
    config = write_configuration(settings, test.folder)
    command = [*SOLIMON, word, str(config), "--data-dir", str(test.folder)]
    command += ["--no-web"] if word == "run" else []
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            test.switch_on()
            yield process
        finally:
            process.kill()


def recorder_of(test):
    beat = read_heartbeat(test.folder)
    assert beat is not None
    return beat.process


@pytest.mark.parametrize(
    ("word", "killed"),
    [
        pytest.param("record", ["recorder"], marks=pytest.mark.slow),
        pytest.param("run", ["supervisor"], marks=pytest.mark.slow),
        ("run", ["supervisor", "recorder"]),
    ],
    ids=["recorder alone", "supervisor", "supervisor and recorder"],
)
def test_the_output_is_switched_off_after_a_kill_when_no_recorder_returns(test, word, killed):
    settings = test.settings(watchdog_timeout_s=WATCHDOG_S)
    with started(test, word, settings) as process:
        recorder = recorder_of(test)
        for name in killed:
            os.kill(process.pid if name == "supervisor" else recorder, signal.SIGKILL)
        ended(process, "the kill")
        test.is_switched_off_unwatched()
        until(lambda: is_held(test.folder) is False, "the recorder's end")


def test_a_hung_recorder_is_killed_and_its_successor_goes_on(test):
    with started(test, "run", test.settings()) as process:
        drive, recorder = test.drive(), recorder_of(test)
        os.kill(recorder, signal.SIGSTOP)
        until(lambda: recorder_of(test) != recorder, "another recorder")
        before = test.charge_coulomb()
        until(lambda: test.charge_coulomb() > before, "a set with its charge")
        assert test.drive() == drive
        assert test.switchings() == [True]
        process.send_signal(signal.SIGINT)
        ended(process, "Ctrl-C")
    assert process.returncode == 130
    assert test.switchings() == [True, False], "off at the end"
    with open_catalogue(test.folder) as catalogue:
        starts = [row.payload["before"] for row in catalogue.rows(EventRow, kind="recorder_started")]
        missed = [row.reason for row in catalogue.rows(SetRow, state="missed")]
    # A busy machine may take so long for a start that it counts as hung, too.
    assert any("hung while" in (before or "") for before in starts)
    assert any("hung while" in reason for reason in missed), "the sets of that time are gaps with their cause"


def test_the_supply_process_runs_once_and_switches_off_when_it_is_stopped(test):
    prepare_data_folder(test.folder)
    config = write_configuration(test.settings(), test.folder)
    command = [*SOLIMON, "supply-process", str(config), "--data-dir", str(test.folder)]
    test.instruments.supply_link.do(lambda: test.instruments.supply.press_output_key(True))
    with notify_socket(test.folder.parent) as (manager, heard):
        environment = {**os.environ, **manager}
        with subprocess.Popen(command, stderr=subprocess.PIPE, env=environment) as process:
            try:
                until(
                    lambda: (now := read_supply_status(test.folder)) is not None and now.state == "on",
                    "a reading",
                )
                second = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
                process.terminate()
                ended(process, "SIGTERM")
            finally:
                process.kill()
    assert heard[0] == ["READY=1"], "the one that owns it"
    assert {tuple(lines) for lines in heard[1:]} == {("WATCHDOG=1",)}
    assert second.returncode == 5
    assert f"another process of the drive owns {test.folder} (process {process.pid}); " in second.stderr
    assert "key" not in second.stderr + (test.folder / "logs" / "drive.log").read_text(encoding="utf-8")
    assert process.returncode == 130
    assert test.switchings() == [True, False]


# Faults that left the output on, each once with real processes ------------------------------------------


@contextmanager
def energised(test):
    """Yield a recorder in real time whose supply an operator has switched on."""
    with test.note_first_set(test.settings()):
        test.switch_on()
        yield


def alarm(test, kind):
    return until(lambda: test.alarms().get(kind), kind).message


def test_a_disk_that_hangs_does_not_delay_the_interlock(test):
    with energised(test):
        os.mkfifo(test.folder / "drive.new")  # nothing reads it: each write of the state hangs
        short = Cell(resistance_ohm=1.0)
        test.instruments.supply_link.do(lambda: setattr(test.instruments.supply, "cell", short))
        until(lambda: not test.instruments.supply.on, "the interlock")
        assert "consecutive readings" in alarm(test, "interlock_tripped")


def test_a_supply_process_that_stalls_at_the_end_is_replaced_and_switches_off(test):
    with energised(test):
        stopped = test.drive()
        os.kill(stopped, signal.SIGSTOP)
    until(lambda: not test.instruments.supply.on, "another process switches off")
    assert test.switchings() == [True, False]


def test_a_test_without_a_supply_has_no_supply_process(tmp_path):
    refused = solimon_here("supply-process", "--data-dir", str(tmp_path / "data"), env={})
    assert refused.returncode == 2
    assert "[rig.supply]" in refused.stderr
