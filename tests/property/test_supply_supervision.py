"""The supply under commands, dead links, kills, stalls, hand-overs, disk hangs and outside changes.

Drive, guard and the recorder's client run on a scripted supply in virtual time, over real sockets and locks.
"""

import logging
import os
import shutil
import tempfile
from collections.abc import Callable
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule
from support.machine import clock_in_seconds
from support.scripted_supply import ScriptedSupply
from support.serial_rig import TestClock

from daq_service.corrosion_drive import supply_state
from daq_service.corrosion_drive.channel import Server
from daq_service.corrosion_drive.charge import DriveState
from daq_service.corrosion_drive.drive import SWITCH_OFF_EVERY_S
from daq_service.corrosion_drive.guard import DriveGuard
from daq_service.corrosion_drive.own_process import SUCCEEDED_WITHIN_S, DriveProcess, hash_supply_settings
from daq_service.corrosion_drive.remote import RemoteDrive, longest_answer_time_s
from daq_service.corrosion_drive.supply_state import Address, hold_supply_lock
from daq_service.errors import BusyError, RigError
from daq_service.processes.data_folder import DRIVE_FILE, DRIVE_LOCK, is_held
from hardware_drivers.errors import ConnectionLostError
from hardware_drivers.serial_port.parameters import SerialLineParameters, SupplyParameters

LOST = ConnectionLostError("no answer")
KEY = b"k" * 32
POLL_S = 5.0
STEP_S = 1.0
PLAIN = SupplyParameters(
    line=SerialLineParameters(port="COM4", reply_timeout_s=0.1),
    identity="ANY",
    log_interval_s=POLL_S,
    watchdog_timeout_s=60.0,
)
CONFIGURATIONS = {
    "same": PLAIN,
    "another limit": replace(PLAIN, interlock_current_a=0.8),
    "another port": replace(PLAIN, line=replace(PLAIN.line, port="COM5")),
}
ROUNDS_S = 3 * STEP_S
"""A message is taken up at the next step, and answered at the one after it."""
REPLACED_WITHIN_S = longest_answer_time_s(PLAIN) + SUCCEEDED_WITHIN_S + POLL_S
LONGEST_S = PLAIN.watchdog_timeout_s + POLL_S + REPLACED_WITHIN_S + ROUNDS_S
"""The unwatched limit and one poll; a process that hangs before it is found and replaced first."""


class Process:
    """Process that may drive the supply."""

    def __init__(self, world, parameters):
        self.world, self.stalled = world, False
        self.server = Server(KEY)
        address = Address(port=self.server.port, key=KEY.hex(), fingerprint=hash_supply_settings(parameters))
        self.job: Callable[[], None] | None = None
        self.drive = DriveProcess(
            lambda: hold_supply_lock(world.folder, address),
            lambda: world.port(parameters.line.port),
            parameters,
            world.folder,
            supply_port=parameters.line.port,
            clock=world.clock,
            jobs=self.put,
        )

    def put(self, job):
        self.job = job
        self.write()

    def write(self):
        if self.job is not None and not self.world.disk_hangs:
            self.job, job = None, self.job
            job()

    def run(self):
        self.drive.step()
        self.server.serve(0.0, self.drive.answer_request)

    def die(self):
        self.drive.close()
        self.server.__exit__()
        self.world.processes.remove(self)

    @property
    def drives(self):
        return not self.stalled and self.drive._released_ns is None

    @property
    def commanded(self):
        return self.drive._drive.state.command is not None


class Started:
    """Result of a start: running, or not yet."""

    def __init__(self, world, parameters):
        self.world, self.parameters, self.returncode = world, parameters, None
        self.process: Process | None = None

    def poll(self):
        return None if self in self.world.starting or self.process in self.world.processes else 0


class World:
    """Supply, its processes, and the folder that they share."""

    def __init__(self, folder):
        self.folder, self.clock = folder, TestClock()
        self.supply, self.nothing = ScriptedSupply(self.clock), ScriptedSupply(self.clock)
        self.nothing.error = LOST
        self.processes: list[Process] = []
        self.starting: list[Started] = []
        self.disk_hangs = False
        self.ran_ns = self.clock.now_ns

    @contextmanager
    def port(self, name):
        yield self.supply if name == "COM4" else self.nothing

    def machine(self):
        """Return the clock of this world; a wait lets its processes run."""
        wait = lambda seconds: (self.clock.advance(seconds), self.run())[0]  # noqa: E731
        return replace(clock_in_seconds(self.mono_s), elapsed_ns=self.clock.mono_ns, sleep=wait)

    def mono_s(self):
        return self.clock.now_ns / 1e9

    def start(self, parameters):
        self.starting.append(Started(self, parameters))
        return self.starting[-1]

    def owner(self):
        return next((one for one in self.processes if one.drive._released_ns is None), None)

    def kill(self, number):
        assert number == os.getpid()
        if (owner := self.owner()) is not None:
            owner.die()

    def run(self):
        for started in self.starting[:]:
            self.starting.remove(started)
            if is_held(self.folder, DRIVE_LOCK) is False:
                with suppress(BusyError):
                    started.process = Process(self, started.parameters)
                    self.processes.append(started.process)
                    absent_s = (self.clock.now_ns - self.ran_ns) / 1e9
                    # The state was written a while before the last process was gone.
                    outlived = started.process.commanded and absent_s > PLAIN.watchdog_timeout_s
                    assert not outlived, f"a command outlives {absent_s:g} s without a process"
        self.ran_ns = self.clock.now_ns if self.processes else self.ran_ns
        for process in self.processes[:]:
            process.write()
            if not process.stalled:
                process.run()
            if process.drive.leaves:
                drive = process.drive
                handed_over = drive._released_ns is not None and drive._last_read_port == drive._supply_port
                may_be_on = ("on", "unknown") if handed_over else ("on",)
                left_on = (
                    self.supply.error is None
                    and self.supply.on
                    and drive._drive.find_output_state() in may_be_on
                )
                assert drive._succeeded or not left_on, "it leaves an output on"
                process.die()


class Supervision(RuleBasedStateMachine):
    """Rule: while any capable process runs, an output without a command is off in time."""

    def __init__(self):
        super().__init__()
        self.folder = Path(tempfile.mkdtemp())
        self.world = World(self.folder)
        self.patch = pytest.MonkeyPatch()
        self.patch.setattr(supply_state, "elapsed_ns", self.world.clock.mono_ns)
        self.patch.setattr(supply_state, "write_durably", self._write)
        logging.disable(logging.CRITICAL)
        self.supervisor: DriveGuard | None = None
        self.guarding: RemoteDrive | None = None
        self.recorder: RemoteDrive | None = None
        self.recorder_stalled = False
        self.parameters = PLAIN
        self.on_s = self.unwanted_s = 0.0

    def _write(self, path, content, *, temporary):
        if self.world.disk_hangs:
            raise OSError("a write that does not end")  # of a recorder: no process waits for one
        path.write_bytes(content)

    def teardown(self):
        for one in (self.recorder, self.guarding):
            if one is not None:
                one._disconnect("")
        for process in self.world.processes[:]:
            process.die()
        self.patch.undo()
        logging.disable(logging.NOTSET)
        shutil.rmtree(self.folder)

    # Time ------------------------------------------------------------------------------------------

    def pass_time(self, seconds):
        for _ in range(round(seconds / STEP_S)):
            self.world.clock.advance(STEP_S)
            if self.recorder is not None and not self.recorder_stalled:
                self.recorder.tick()
            if self.supervisor is not None:
                self.supervisor.check()
            self.world.run()
            self.check()

    def check(self):
        world = self.world
        answers = world.supply.error is None
        drivers = [one for one in world.processes if one.drives and one.drive._supply_port == "COM4"]
        wanted = any(one.commanded for one in drivers)
        somebody = (
            any(not one.stalled for one in world.processes)
            or (self.recorder is not None and not self.recorder_stalled)
            or self.supervisor is not None
        )
        reachable = answers and self._can_reach()
        exposed = world.supply.on and reachable and somebody and not wanted
        self.on_s = self.on_s + STEP_S if exposed else 0.0
        assert self.on_s <= LONGEST_S, f"on for {self.on_s:g} s without supervision"
        unwanted = world.supply.on and answers and bool(drivers) and not wanted
        self.unwanted_s = self.unwanted_s + STEP_S if unwanted else 0.0
        assert self.unwanted_s <= max(POLL_S, SWITCH_OFF_EVERY_S) + ROUNDS_S, (
            "a process reads it and lets it be"
        )
        for process in drivers:
            silent_s = (world.clock.now_ns - process.drive._heard_ns) / 1e9
            limit_s = PLAIN.watchdog_timeout_s + POLL_S + ROUNDS_S
            assert not (process.commanded and silent_s > limit_s), f"unwatched for {silent_s:g} s"

    def _can_reach(self):
        """Return whether a running process knows the port of this supply."""
        parameters = [one.drive._parameters for one in self.world.processes if not one.stalled]
        parameters += [] if self.recorder is None else [self.recorder._parameters]
        parameters += [] if self.guarding is None else [self.guarding._parameters]
        return any(one.line.port == "COM4" for one in parameters)

    @initialize()
    def begins(self):
        self.start_recorder("same", 5.0)
        self.change_supervisor()
        self.command("on")

    @rule(seconds=st.sampled_from([1.0, 5.0, 20.0]))
    def time_passes(self, seconds):
        self.pass_time(seconds)

    @rule()
    def long_time_passes(self):
        self.pass_time(LONGEST_S + 5.0)

    # A person ----------------------------------------------------------------------------------------

    @precondition(lambda self: self.recorder is not None and not self.recorder_stalled)
    @rule(what=st.sampled_from(["on", "on", "off", "trip"]))
    def command(self, what):
        assert self.recorder is not None
        if what == "on":
            self.recorder.energise("Ada")
        elif what == "off":
            self.recorder.switch_off("Ada")
        else:
            self.recorder.trip("hole at B")
        self.pass_time(2.0)

    @rule(on=st.booleans(), current_a=st.sampled_from([0.2, 0.2, 0.95]))
    def output_changes_from_outside(self, on, current_a):
        self.world.supply.on, self.world.supply.current_a = on, current_a

    # Faults ------------------------------------------------------------------------------------------

    @rule(what=st.sampled_from(["link", "link", "disk", "disk", "file"]))
    def link_or_disk_fails_or_returns(self, what):
        if what == "file":
            (self.folder / DRIVE_FILE).write_bytes(b"torn")
        elif what == "disk":
            self.world.disk_hangs = not self.world.disk_hangs
        else:
            self.world.supply.error = LOST if self.world.supply.error is None else None

    @precondition(lambda self: self.world.processes)
    @rule(what=st.sampled_from(["kill", "stall", "stall", "resume", "stop"]), newest=st.booleans())
    def process_suffers(self, what, newest):
        process = self.world.processes[-1 if newest else 0]
        if what == "kill":
            process.die()
        elif what == "stop" and not process.stalled:
            with suppress(RigError):
                process.drive.end()
            process.die()
        else:
            process.stalled = what == "stall"

    @precondition(lambda self: self.recorder is not None)
    @rule(what=st.sampled_from(["kill", "stall", "resume", "end"]))
    def recorder_suffers(self, what):
        assert self.recorder is not None
        if what in ("stall", "resume"):
            self.recorder_stalled = what == "stall"
            return
        if what == "end" and not self.recorder_stalled:
            with suppress(ConnectionLostError):
                self.recorder.switch_off_at_end()
            self.recorder.__exit__()
        self.recorder._disconnect("killed")
        self.recorder, self.recorder_stalled = None, False

    @precondition(lambda self: self.recorder is None and self.world.processes)
    @rule()
    def successor_dies_before_it_reads(self):
        error, self.world.supply.error = self.world.supply.error, LOST
        self.start_recorder("another limit", 2.0)
        self.recorder_suffers("kill")
        for process in self.world.processes[1:]:
            process.die()
        self.world.supply.error = error

    @precondition(lambda self: self.recorder is None)
    @rule(configuration=st.sampled_from(list(CONFIGURATIONS)), seconds=st.sampled_from([1.0, 2.0, 5.0]))
    def start_recorder(self, configuration, seconds):
        parameters, world = CONFIGURATIONS[configuration], self.world
        if parameters is not self.parameters:
            self.parameters = parameters
            for _ in range(2 if self.guarding is not None else 0):
                self.change_supervisor()  # it has the recorder's configuration
        self.recorder = RemoteDrive(
            parameters,
            self.folder,
            lambda: world.start(parameters),  # type: ignore[arg-type,return-value]
            supply_port=parameters.line.port,
            machine=world.machine(),
            kill=world.kill,
        )
        self.recorder.store_catalogue_state(DriveState())
        self.pass_time(seconds)

    @rule()
    def change_supervisor(self):
        """Start or kill the supervisor."""
        if self.guarding is not None:
            self.guarding._disconnect("killed")
            self.supervisor = self.guarding = None
            return
        world, parameters = self.world, self.parameters
        self.guarding = RemoteDrive(
            parameters,
            self.folder,
            lambda: world.start(parameters),  # type: ignore[arg-type,return-value]
            watches=False,
            machine=world.machine(),
            kill=world.kill,
        )
        self.supervisor = DriveGuard(
            self.folder,
            self.guarding,
            check_every_s=PLAIN.watchdog_timeout_s,
            machine=world.machine(),
        )


def _settings(runs):
    return settings(
        max_examples=runs,
        stateful_step_count=50,
        deadline=None,
        suppress_health_check=list(HealthCheck),
        print_blob=True,
        database=None,
        phases=(Phase.generate,),
    )


TestSupervision = Supervision.TestCase
TestSupervision.settings = _settings(20)


@pytest.mark.slow
class TestSupervisionAtLength(Supervision.TestCase):  # type: ignore[name-defined,misc]
    """The same rules, 500 times."""

    settings = _settings(500)
