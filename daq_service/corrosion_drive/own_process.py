"""The process that owns the supply: it logs, integrates charge, keeps the interlock and watches the recorder.

It outlives the recorder. When none was heard for ``rig.supply.unwatched_s`` the output is switched off, read
back and kept off until a person's command; time runs on a clock that counts sleep and that no step of UTC
moves. It never energises but at a command that a recorder hands on, and it leaves once no command is in force
and the output has been read as off. Files are written in a thread: a disk that hangs delays no interlock.
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
from typing import Any, Literal

from daq_service.clock import WallClock, boot_name
from daq_service.corrosion_drive.channel import Message, Server
from daq_service.corrosion_drive.charge import DriveState
from daq_service.corrosion_drive.drive import SupplyLogger, summary
from daq_service.corrosion_drive.file_thread import FileThread
from daq_service.corrosion_drive.reading_log import LONGEST_GAP_INTERVALS
from daq_service.corrosion_drive.supply_state import Address, Kept, kept_now, own_drive, read_kept, write_kept
from daq_service.errors import RigError, SolimonError
from hardware_drivers.drive_parameters import DriveParameters
from hardware_drivers.errors import InstrumentError
from hardware_drivers.instruments import Clock, PowerSupply
from hardware_drivers.nanoseconds import NS_PER_S

log = logging.getLogger(__name__)

TICK_S = 0.05
BEAT_EVERY_S = 1.0
KEEP_EVERY_S = 5.0
"""Charge and newest reading are kept so often; what the interlock does at once."""
KEEP_AGAIN_S = 1.0
"""After the disk refused it, or while a successor is awaited."""
LEAVE_AFTER_S = 10.0
"""A recorder that is started again finds the process that it had."""
GRACE_S = 30.0
"""After its start it waits so long for a recorder, however long none was there before."""
SUCCEEDED_WITHIN_S = 10.0
"""A successor must have read the supply so long after it was handed over."""

Action = Literal["stay", "switch off", "leave"]
Jobs = Callable[[Callable[[], None]], None]


@cache
def fingerprint(parameters: DriveParameters) -> str:
    """Return what must be the same in a recorder and in the process of its drive."""
    return hashlib.sha256(f"{version('solimon')} {parameters!r}".encode()).hexdigest()


def next_action(
    *, silent_s: float, alone_s: float, unwatched_s: float, commanded: bool, pending: bool, stays: bool
) -> Action:
    """Decide by how long no recorder was heard.

    Parameters
    ----------
    silent_s, alone_s
        Since one was heard, also by a process before this one; and since this one heard one, or started.
    commanded, pending
        A command `on` is in force; the output was not read as off since it had to be switched off.
    stays
        It does not leave by itself.
    """
    if commanded:
        return "switch off" if silent_s >= unwatched_s else "stay"
    done = not pending and alone_s >= min(unwatched_s, LEAVE_AFTER_S)
    return "leave" if done and not stays else "stay"


class DriveProcess:
    """The process, between two looks at the clock; it waits nowhere by itself.

    Parameters
    ----------
    own, open_supply
        Take the drive's lock, and open the supply's port.
    supply_port
        Names that port; a successor with another one does not reach this supply.
    stays
        A service manager started it: it does not leave when the output is off.
    clock
        Its monotonic time counts sleep, and no step of UTC moves it.
    jobs
        Runs a job on files, without waiting for it; the newest job replaces one that waits.
    """

    def __init__(
        self,
        own: Callable[[], AbstractContextManager[Any]],
        open_supply: Callable[[], AbstractContextManager[PowerSupply]],
        parameters: DriveParameters,
        folder: Path,
        *,
        supply_port: str = "",
        stays: bool = False,
        clock: Clock | None = None,
        jobs: Jobs = lambda job: job(),
    ) -> None:
        self._clock = clock or WallClock()
        self._parameters, self._folder, self._stays = parameters, folder, stays
        self._open_supply, self._supply_port, self._jobs = open_supply, supply_port, jobs
        self._owned = ExitStack()
        with ExitStack() as opening:
            opening.enter_context(own())
            supply = opening.enter_context(open_supply())
            self._owned = opening.pop_all()
        before = read_kept(folder)
        now_ns = self._clock.mono_ns()
        self._drive = SupplyLogger(
            supply, self._clock, parameters, _restored(before, parameters.unwatched_s, now_ns)
        )
        self._heard_ns = self._met_ns = now_ns
        if before is not None and before.boot_id == boot_name() is not None:
            grace_s = min(GRACE_S, parameters.unwatched_s)
            self._heard_ns = max(
                before.heard_boot_ns, now_ns - round((parameters.unwatched_s - grace_s) * NS_PER_S)
            )
        self._read_port = "" if before is None else before.supply_port
        self._kept: Kept | None = None
        self._written: Kept | None = None
        self._writer = secrets.token_hex(8)
        self._kept_ns = now_ns
        self._disk = ""
        self._successor_port: str | None = None
        self._released_ns: int | None = None
        self._succeeded = False
        self.leaves = False

    def step(self) -> None:
        """Read what is due, keep what has changed, and see whether a recorder watches."""
        if self._released_ns is not None:
            self._await_successor(self._released_ns)
            return
        self._drive.tick()
        now_ns = self._clock.mono_ns()
        silent_s = (now_ns - self._heard_ns) / NS_PER_S
        action = next_action(
            silent_s=silent_s,
            alone_s=(now_ns - self._met_ns) / NS_PER_S,
            unwatched_s=self._parameters.unwatched_s,
            commanded=self._drive.state.command is not None,
            pending=self._drive.must_switch_off or self._drive.output() == "on",
            stays=self._stays,
        )
        if action == "switch off":
            log.error("no recorder for %.0f s: switching off", silent_s)
            self._drive.trip(
                f"no recorder was heard for {silent_s:.0f} s "
                f"(unwatched_s = {self._parameters.unwatched_s:g} s)",
                kind="supply_unwatched",
            )
        self.leaves = self.leaves or action == "leave"
        self.keep()
        if self._successor_port is not None:
            self._hand_over(self._successor_port)

    def keep(self, *, at_once: bool = False) -> None:
        """Keep the state for the next process; a disk that takes nothing changes nothing here."""
        kept, now_ns, row = self._kept, self._clock.mono_ns(), self._drive.row(0, 0.0)
        state = self._drive.state
        if row.supply_age_s is not None:
            self._read_port = self._supply_port
        changed = kept is None or _latched(state) != _latched(kept.state) or row.supply_state != kept.output
        every_s = KEEP_AGAIN_S if self._disk else KEEP_EVERY_S
        if not (at_once or changed or now_ns - self._kept_ns >= every_s * NS_PER_S):
            return
        self._kept_ns = now_ns
        self._kept = kept_now(
            state,
            output=row.supply_state,
            age_s=row.supply_age_s,
            boot_ns=now_ns,
            heard_boot_ns=self._heard_ns,
            writer=self._writer,
            supply_port=self._read_port,
            good_for_s=LONGEST_GAP_INTERVALS * self._parameters.log_interval_s + KEEP_EVERY_S,
        )
        self._jobs(partial(self._write, self._kept))

    def _write(self, kept: Kept) -> None:
        try:
            write_kept(self._folder, kept)
        except OSError as error:
            if not self._disk:
                log.error("charge and interlock are not kept: %s", error)
            self._disk = str(error)
        else:
            self._disk, self._written = "", kept

    def end(self) -> None:
        """Leave no output on: what is not read as off is switched off.

        Raises
        ------
        RigError
            It may still be on.
        """
        if self._released_ns is not None:
            if not (self._succeeded or self._reclaimed()):
                raise RigError("the supply was handed over and may still be on; switch it off by hand")
            return
        commanded = self._drive.state.command is not None
        if (commanded or self._drive.output() != "off") and not self._drive.trip(
            "the process of the drive was stopped, and no other one watches", kind="supply_unwatched"
        ):
            self.keep(at_once=True)
            raise RigError("the supply does not answer and may still be on; switch it off by hand")
        self.keep(at_once=True)

    def close(self) -> None:
        """Release port and lock."""
        self._owned.close()

    # Hand-over ---------------------------------------------------------------------------------------

    def _hand_over(self, successor_port: str) -> None:
        """Release port and lock; before that switch off what a successor with another port cannot reach.

        A supply that was never read at this port is released at once: the successor may reach it. With
        another port nothing is left to do here.
        """
        is_off = self._drive.state.command is None and self._drive.output() == "off"
        elsewhere, reached = successor_port != self._supply_port, self._read_port == self._supply_port
        if reached and elsewhere and not is_off:
            try:
                self._drive.switch_off("the recorder's change to another port")
            except InstrumentError as error:
                log.error("not handed over, the output may be ON: %s", error)
            return
        if reached and self._drive.must_switch_off:
            return
        if reached and self._written is not self._kept and not self._disk:
            return  # the successor goes on from what is written
        log.warning("port and lock are released; a successor must read within %g s", SUCCEEDED_WITHIN_S)
        self.close()
        self._released_ns = self._kept_ns = self._clock.mono_ns()
        self.leaves = elsewhere

    def _await_successor(self, released_ns: int) -> None:
        """Leave once the successor has read the supply; if it does not in time, switch off from here."""
        now_ns = self._clock.mono_ns()
        if self._succeeded:
            self.leaves = True
        elif now_ns - self._kept_ns >= KEEP_AGAIN_S * NS_PER_S:
            self._kept_ns = now_ns
            self._jobs(self._look_for_successor)
            if now_ns - released_ns >= SUCCEEDED_WITHIN_S * NS_PER_S:
                self.leaves = self._reclaimed()

    def _look_for_successor(self) -> None:
        found = read_kept(self._folder)
        self._succeeded = found is not None and found.writer != self._writer and found.output != "unknown"

    def _reclaimed(self) -> bool:
        """Open the port again and switch off; True if the output was read back as off."""
        try:
            with self._open_supply() as supply:
                supply.make_safe()
        except (InstrumentError, SolimonError, OSError) as error:
            log.error("no successor reads the supply, and it could not be switched off: %s", error)
            return False
        log.error("no successor has read the supply: switched off")
        self._jobs(self._keep_reclaimed)
        return True

    def _keep_reclaimed(self) -> None:
        """Keep that the output is off and no command in force, unless another process has written since."""
        found = read_kept(self._folder)
        if self._kept is not None and (found is None or found.writer == self._writer):
            self._write(replace(self._kept, state=replace(self._kept.state, command=None), output="off"))

    # Requests of a recorder --------------------------------------------------------------------------

    def answer(self, request: Message) -> Message:
        """Do what a recorder requests, and return the state of the drive.

        Each request but ``ping`` shows that a recorder watches.
        """
        if self._released_ns is not None:
            return {"id": request["id"], "released": True}
        if request["do"] == "ping":
            return {"id": request["id"]}
        self._heard_ns = self._met_ns = self._clock.mono_ns()
        failed: dict[str, Any] = {}
        try:
            self._execute(request)
        except (InstrumentError, ValueError, LookupError, TypeError) as error:
            failed = {"error": str(error)}
        if request["do"] != "look":
            self._drive.tick()  # the answer holds a reading after the command
        self.keep()
        now_ns, written = self._clock.mono_ns(), self._written
        return {
            "id": request["id"],
            "row": summary(self._drive.row(0, 0.0)),
            "conditions": [asdict(condition) for condition in self._drive.conditions()],
            "window_length": self._drive.window_length,
            "commanded": self._drive.state.command is not None,
            "pending": self._drive.must_switch_off,
            "written_age_s": None if written is None else (now_ns - written.boot_ns) / NS_PER_S,
            **failed,
        }

    def _execute(self, request: Message) -> None:
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
                self._drive.begin_window(request["window_length"])
            case "hand over":
                log.warning("another process takes over: %s", request["why"])
                self._successor_port = request["supply_port"]


def _restored(before: Kept | None, unwatched_s: float, now_ns: int) -> DriveState:
    """Return the state to restore: a command ends with its boot, or ``unwatched_s`` without a process."""
    if before is None:
        return DriveState()
    if before.boot_id == boot_name() and before.written_before_s(now_ns) <= unwatched_s:
        return before.state
    return replace(before.state, command=None)


def _latched(state: DriveState) -> tuple[object, ...]:
    return state.tripped, state.latched, state.command, state.must_switch_off


def own_supply(
    parameters: DriveParameters,
    folder: Path,
    open_supply: Callable[[], AbstractContextManager[PowerSupply]],
    stop: threading.Event,
    *,
    supply_port: str,
    stays: bool,
    beat: Callable[[], None] = lambda: None,
) -> bool:
    """Own the supply of a folder until its output is off and no recorder watches, or ``stop``.

    Parameters
    ----------
    beat
        Called every second by the loop itself: it lives.

    Returns
    -------
    bool
        False when ``stop`` came first.

    Raises
    ------
    BusyError
        Another process owns it.
    RigError
        It was stopped, and the supply may still be on.
    """
    key = secrets.token_bytes(32)
    with Server(key) as server, FileThread() as files:
        address = Address(port=server.port, key=key.hex(), fingerprint=fingerprint(parameters))
        process = DriveProcess(
            lambda: own_drive(folder, address),
            open_supply,
            parameters,
            folder,
            supply_port=supply_port,
            stays=stays,
            jobs=files.run,
        )
        beaten_s = -math.inf
        try:
            while not (process.leaves or stop.is_set()):
                process.step()
                if (now_s := time.monotonic()) - beaten_s >= BEAT_EVERY_S:
                    beaten_s = now_s
                    beat()
                server.serve(TICK_S, process.answer)
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
