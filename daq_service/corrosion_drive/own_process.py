"""Supply process: owns the supply, logs, integrates charge, runs the interlock and watches the recorder.

It outlives the recorder. Without a request of a recorder for ``rig.supply.watchdog_timeout_s`` the output is
switched off, read back and stays off until a person's command; the clock counts sleep and is independent of
steps of UTC. It energises only at a command from a recorder, and it ends once no command is in force and the
output has been read as off. Files are written in a thread: a disk that hangs does not delay the interlock.
"""

from __future__ import annotations

import hashlib
import logging
import math
import secrets
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from dataclasses import asdict, replace
from functools import cache, partial
from importlib.metadata import version
from pathlib import Path
from typing import Literal

from daq_service.clock import WallClock, boot_name
from daq_service.corrosion_drive.channel import Message, Server
from daq_service.corrosion_drive.charge import DriveState
from daq_service.corrosion_drive.drive import SupplyLogger, select_columns
from daq_service.corrosion_drive.file_thread import FileThread
from daq_service.corrosion_drive.reading_log import LONGEST_GAP_INTERVALS
from daq_service.corrosion_drive.supply_state import (
    Address,
    StoredState,
    hold_supply_lock,
    read_stored_state,
    stamp_state,
    write_stored_state,
)
from daq_service.errors import RigError, SolimonError
from hardware_drivers.drive_parameters import DriveParameters
from hardware_drivers.errors import InstrumentError
from hardware_drivers.instruments import Clock, PowerSupply
from hardware_drivers.nanoseconds import NS_PER_S

log = logging.getLogger(__name__)

TICK_S = 0.05
BEAT_EVERY_S = 1.0
KEEP_EVERY_S = 5.0
"""Interval of writing charge and newest reading; a change of the interlock is written at once."""
KEEP_AGAIN_S = 1.0
"""Interval after an error of the disk, or while a successor is awaited."""
LEAVE_AFTER_S = 10.0
"""Time for a restarted recorder to find its process."""
GRACE_S = 30.0
"""Time to wait for a recorder after the start, independent of the time without one before."""
SUCCEEDED_WITHIN_S = 10.0
"""Time for a successor to read the supply after the hand-over."""

Action = Literal["stay", "switch off", "leave"]
Jobs = Callable[[Callable[[], None]], None]


@cache
def hash_supply_settings(parameters: DriveParameters) -> str:
    """Return the SHA-256 (hexadecimal) of solimon's version and the supply's parameters; cached.

    If it differs between recorder and supply process, the recorder asks the process to hand over.
    """
    return hashlib.sha256(f"{version('solimon')} {parameters!r}".encode()).hexdigest()


def decide_next_action(
    *, silent_s: float, alone_s: float, watchdog_timeout_s: float, commanded: bool, pending: bool, stays: bool
) -> Action:
    """Choose the next action of the supply process: ``stay``, ``switch off`` or ``leave``.

    With a command in force only the watchdog timeout switches off. Without one, the process leaves after the
    smaller of the timeout and `LEAVE_AFTER_S`, unless a switch-off is pending or it stays. Times in s.

    Parameters
    ----------
    silent_s, alone_s
        Time since a request of a recorder, also to an earlier process; and to this one, or since its start.
    commanded, pending
        A command `on` is in force; a switch-off has not been confirmed by a reading.
    stays
        The process does not end by itself.
    """
    if commanded:
        return "switch off" if silent_s >= watchdog_timeout_s else "stay"
    done = not pending and alone_s >= min(watchdog_timeout_s, LEAVE_AFTER_S)
    return "leave" if done and not stays else "stay"


class DriveProcess:
    """State machine of the supply process, advanced by `step`; it never waits.

    Parameters
    ----------
    take_lock, open_supply
        Take the lock of the supply, and open its port.
    supply_port
        Name of that port; a successor with another one does not reach this supply.
    stays
        A service manager started the process: it does not end when the output is off.
    clock
        Its monotonic time counts sleep and is independent of steps of UTC.
    jobs
        Runs a job on files, without waiting for it; the newest job replaces a pending one.
    """

    def __init__(
        self,
        take_lock: Callable[[], AbstractContextManager[object]],
        open_supply: Callable[[], AbstractContextManager[PowerSupply]],
        parameters: DriveParameters,
        folder: Path,
        *,
        supply_port: str = "",
        stays: bool = False,
        clock: Clock | None = None,
        jobs: Jobs = lambda job: job(),
    ) -> None:
        """Take the lock, open the supply's port, and continue from the stored state of the folder.

        Errors of ``take_lock`` and ``open_supply`` pass through; lock and port are then released.
        """
        self._clock = clock or WallClock()
        self._parameters, self._folder, self._stays = parameters, folder, stays
        self._open_supply, self._supply_port, self._jobs = open_supply, supply_port, jobs
        self._resources = ExitStack()
        with ExitStack() as stack:
            stack.enter_context(take_lock())
            supply = stack.enter_context(open_supply())
            self._resources = stack.pop_all()
        stored = read_stored_state(folder)
        now_ns = self._clock.mono_ns()
        self._drive = SupplyLogger(
            supply, self._clock, parameters, _restore_state(stored, parameters.watchdog_timeout_s, now_ns)
        )
        self._heard_ns = self._met_ns = now_ns
        if stored is not None and stored.boot_id == boot_name() is not None:
            grace_s = min(GRACE_S, parameters.watchdog_timeout_s)
            self._heard_ns = max(
                stored.heard_boot_ns, now_ns - round((parameters.watchdog_timeout_s - grace_s) * NS_PER_S)
            )
        self._last_read_port = "" if stored is None else stored.supply_port
        self._stored: StoredState | None = None
        self._written_state: StoredState | None = None
        self._writer = secrets.token_hex(8)
        self._stored_ns = now_ns
        self._disk_error = ""
        self._successor_port: str | None = None
        self._released_ns: int | None = None
        self._succeeded = False
        self.leaves = False

    def step(self) -> None:
        """Read the supply and queue its state for writing; without a recorder, switch off or set `leaves`.

        Blocks for one call of the supply; its errors are logged. A requested hand-over is done here; after
        it, only the successor's reading is awaited.
        """
        if self._released_ns is not None:
            self._await_successor(self._released_ns)
            return
        self._drive.tick()
        now_ns = self._clock.mono_ns()
        silent_s = (now_ns - self._heard_ns) / NS_PER_S
        action = decide_next_action(
            silent_s=silent_s,
            alone_s=(now_ns - self._met_ns) / NS_PER_S,
            watchdog_timeout_s=self._parameters.watchdog_timeout_s,
            commanded=self._drive.state.command is not None,
            pending=self._drive.must_switch_off or self._drive.find_output_state() == "on",
            stays=self._stays,
        )
        if action == "switch off":
            log.error("no recorder for %.0f s: switching off", silent_s)
            self._drive.trip(
                f"no recorder heartbeat for {silent_s:.0f} s "
                f"(watchdog_timeout_s = {self._parameters.watchdog_timeout_s:g} s)",
                kind="supply_watchdog_trip",
            )
        self.leaves = self.leaves or action == "leave"
        self.store_state()
        if self._successor_port is not None:
            self._hand_over(self._successor_port)

    def store_state(self, *, at_once: bool = False) -> None:
        """Queue the state for writing if it has changed, the interval is over, or ``at_once``.

        The file thread writes it; a disk error is logged and the state queued again after `KEEP_AGAIN_S`.
        """
        stored, now_ns, row = self._stored, self._clock.mono_ns(), self._drive.build_row(0, 0.0)
        state = self._drive.state
        if row.supply_age_s is not None:
            self._last_read_port = self._supply_port
        changed = (
            stored is None
            or _list_parts_to_sync(state) != _list_parts_to_sync(stored.state)
            or row.supply_state != stored.output
        )
        every_s = KEEP_AGAIN_S if self._disk_error else KEEP_EVERY_S
        if not (at_once or changed or now_ns - self._stored_ns >= every_s * NS_PER_S):
            return
        self._stored_ns = now_ns
        self._stored = stamp_state(
            state,
            output=row.supply_state,
            age_s=row.supply_age_s,
            boot_ns=now_ns,
            heard_boot_ns=self._heard_ns,
            writer=self._writer,
            supply_port=self._last_read_port,
            good_for_s=LONGEST_GAP_INTERVALS * self._parameters.log_interval_s + KEEP_EVERY_S,
        )
        self._jobs(partial(self._write_state, self._stored))

    def _write_state(self, stored: StoredState) -> None:
        """Write the state to ``drive.json``; log the first of consecutive disk errors, raise none."""
        try:
            write_stored_state(self._folder, stored)
        except OSError as error:
            if not self._disk_error:
                log.error("charge and interlock are not kept: %s", error)
            self._disk_error = str(error)
        else:
            self._disk_error, self._written_state = "", stored

    def end(self) -> None:
        """Switch the output off unless it was read as off, and queue the state for writing.

        After a hand-over, open the port again and switch off there, unless a successor has read the supply.

        Raises
        ------
        RigError
            The output may still be on.
        """
        if self._released_ns is not None:
            if not (self._succeeded or self._reclaim_port()):
                raise RigError("the supply was handed over and may still be on; switch it off by hand")
            return
        commanded = self._drive.state.command is not None
        if (commanded or self._drive.find_output_state() != "off") and not self._drive.trip(
            "the supply process was stopped, no other one supervises the output", kind="supply_watchdog_trip"
        ):
            self.store_state(at_once=True)
            raise RigError("the supply does not answer and may still be on; switch it off by hand")
        self.store_state(at_once=True)

    def close(self) -> None:
        """Release the supply's port and lock; repeated calls have no effect."""
        self._resources.close()

    # Hand-over ---------------------------------------------------------------------------------------

    def _hand_over(self, successor_port: str) -> None:
        """Release port and lock for a successor that uses ``successor_port``; switch off before if it must.

        A supply that was never read at this port is released at once. With another port, the output is
        switched off first and this process then ends. Nothing is released before a pending switch-off is done
        and the state is written (unless the disk fails): the next step tries again. An instrument error is
        logged.
        """
        is_off = self._drive.state.command is None and self._drive.find_output_state() == "off"
        other_port, was_read = successor_port != self._supply_port, self._last_read_port == self._supply_port
        if was_read and other_port and not is_off:
            try:
                self._drive.switch_off("the recorder's change to another port")
            except InstrumentError as error:
                log.error("not handed over, the output may be ON: %s", error)
            return
        if was_read and self._drive.must_switch_off:
            return
        if was_read and self._written_state is not self._stored and not self._disk_error:
            return  # the successor continues with the written state
        log.warning("port and lock are released; a successor must read within %g s", SUCCEEDED_WITHIN_S)
        self.close()
        self._released_ns = self._stored_ns = self._clock.mono_ns()
        self.leaves = other_port

    def _await_successor(self, released_ns: int) -> None:
        """Set `leaves` once the successor has read the supply; after `SUCCEEDED_WITHIN_S`, switch off here.

        That time counts from the release at ``released_ns`` (monotonic). It looks every `KEEP_AGAIN_S`,
        through the file thread; a switch-off that fails is tried again then.
        """
        now_ns = self._clock.mono_ns()
        if self._succeeded:
            self.leaves = True
        elif now_ns - self._stored_ns >= KEEP_AGAIN_S * NS_PER_S:
            self._stored_ns = now_ns
            self._jobs(self._check_successor)
            if now_ns - released_ns >= SUCCEEDED_WITHIN_S * NS_PER_S:
                self.leaves = self._reclaim_port()

    def _check_successor(self) -> None:
        """Read the state file and note whether another process has written an output that it has read."""
        stored = read_stored_state(self._folder)
        self._succeeded = stored is not None and stored.writer != self._writer and stored.output != "unknown"

    def _reclaim_port(self) -> bool:
        """Open the port again and switch off; return True if the output was read back as off.

        Then that state is queued for writing. False, with a logged error, if port or supply does not respond.
        """
        try:
            with self._open_supply() as supply:
                supply.make_safe()
        except (InstrumentError, SolimonError, OSError) as error:
            log.error("no successor reads the supply, and it could not be switched off: %s", error)
            return False
        log.error("no successor has read the supply: switched off")
        self._jobs(self._store_reclaimed)
        return True

    def _store_reclaimed(self) -> None:
        """Write the state with the output off and no command, unless another process has written since."""
        stored = read_stored_state(self._folder)
        if self._stored is not None and (stored is None or stored.writer == self._writer):
            self._write_state(
                replace(self._stored, state=replace(self._stored.state, command=None), output="off")
            )

    # Requests of a recorder --------------------------------------------------------------------------

    def answer_request(self, request: Message) -> Message:
        """Execute a request of a recorder and return the answer: row, conditions and state of the supply.

        Each request but ``ping`` shows that a recorder is there. A request that failed is answered with
        ``error``, any request after a hand-over with ``released``. Blocks for calls of the supply.
        """
        if self._released_ns is not None:
            return {"id": request["id"], "released": True}
        if request["do"] == "ping":
            return {"id": request["id"]}
        self._heard_ns = self._met_ns = self._clock.mono_ns()
        error_entry: dict[str, object] = {}
        try:
            self._execute_request(request)
        except (InstrumentError, ValueError, LookupError, TypeError) as error:
            error_entry = {"error": str(error)}
        if request["do"] != "look":
            self._drive.tick()  # the answer holds a reading after the command
        self.store_state()
        now_ns, written = self._clock.mono_ns(), self._written_state
        return {
            "id": request["id"],
            "row": select_columns(self._drive.build_row(0, 0.0)),
            "conditions": [asdict(condition) for condition in self._drive.list_conditions()],
            "window_length": self._drive.window_length,
            "commanded": self._drive.state.command is not None,
            "pending": self._drive.must_switch_off,
            "written_age_s": None if written is None else (now_ns - written.boot_ns) / NS_PER_S,
            **error_entry,
        }

    def _execute_request(self, request: Message) -> None:
        """Execute the request ``do`` of a recorder or of another supply process; unknown ones are ignored.

        Raise ValueError for `energise` while leaving, too late or without author, InstrumentError if the
        supply fails, LookupError for a missing field.
        """
        match request["do"]:
            case "look" if request.get("commanded") is False:
                self._drive.end_command()
            case "energise" if self.leaves or self._successor_port is not None:
                raise ValueError("this process is leaving, nothing was done")
            case "energise" if request.get("until_boot_ns", self._heard_ns) < self._heard_ns:
                raise ValueError("it came too late, nothing was done")
            case "energise":
                self._drive.energise(
                    request["author"],
                    voltage_v=request["voltage_v"],
                    current_limit_a=request["current_limit_a"],
                )
            case "switch off":
                self._drive.switch_off(request["author"])
            case "trip" if self._drive.tripped is None:
                self._drive.trip(request["reason"])
            case "begin window":
                self._drive.restart_means(request["window_length"])
            case "hand over":
                log.warning("another process takes over: %s", request["why"])
                self._successor_port = request["supply_port"]


def _restore_state(before: StoredState | None, watchdog_timeout_s: float, now_ns: int) -> DriveState:
    """Return the state ``before`` with which to continue; the default state without one.

    Its command is dropped after another boot, or if the file is older than ``watchdog_timeout_s`` at
    ``now_ns`` (time of the boot).
    """
    if before is None:
        return DriveState()
    if before.boot_id == boot_name() and before.compute_file_age_s(now_ns) <= watchdog_timeout_s:
        return before.state
    return replace(before.state, command=None)


def _list_parts_to_sync(state: DriveState) -> tuple[object, ...]:
    """Return the parts of the state whose change is written at once.

    They are trip reason, latched alarms, command and pending switch-off.
    """
    return state.tripped, state.latched, state.command, state.must_switch_off


def run_supply_process(
    parameters: DriveParameters,
    folder: Path,
    open_supply: Callable[[], AbstractContextManager[PowerSupply]],
    stop: threading.Event,
    *,
    supply_port: str,
    stays: bool,
    beat: Callable[[], None] = lambda: None,
) -> bool:
    """Run the supply process of a folder until it may leave or ``stop`` is set; blocks until then.

    Parameters
    ----------
    open_supply, supply_port
        Opens the supply's port, and the name of that port.
    stays
        The process does not end by itself.
    beat
        Called every second by the loop, as a sign of life.

    Returns
    -------
    bool
        False when ``stop`` came first; the process then ended as by `DriveProcess.end`.

    Raises
    ------
    BusyError
        Another process owns the supply.
    RigError
        The process was stopped, and the supply may still be on.
    """
    key = secrets.token_bytes(32)
    with Server(key) as server, FileThread() as files:
        address = Address(port=server.port, key=key.hex(), fingerprint=hash_supply_settings(parameters))
        process = DriveProcess(
            lambda: hold_supply_lock(folder, address),
            open_supply,
            parameters,
            folder,
            supply_port=supply_port,
            stays=stays,
            jobs=files.run,
        )
        last_beat_s = -math.inf
        try:
            while not (process.leaves or stop.is_set()):
                process.step()
                if (now_s := time.monotonic()) - last_beat_s >= BEAT_EVERY_S:
                    last_beat_s = now_s
                    beat()
                server.serve(TICK_S, process.answer_request)
            if not process.leaves:
                process.end()
            return process.leaves
        except BaseException:  # also a vendor's library that exits
            log.exception("the process of the drive failed")
            process.end()
            raise
        finally:
            files.flush()
            process.close()
