"""The process that owns the supply: it logs, keeps charge and interlock, and watches that somebody watches.

It outlives the recorder. When none was heard for ``rig.supply.unwatched_s`` the output is switched off, read
back and kept off until a person orders it on; time runs on a clock that counts sleep and that no step of UTC
moves. It never energises but at an order that a recorder hands on, and it leaves once the output is off.
"""

from __future__ import annotations

import hashlib
import logging
import secrets
import threading
from collections.abc import Callable
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

from daq_service.clock import WallClock, boot_name
from daq_service.corrosion_drive.channel import Message, Server
from daq_service.corrosion_drive.charge import DriveState
from daq_service.corrosion_drive.drive import ElectrochemicalDrive, summary
from daq_service.corrosion_drive.kept import Address, Kept, kept_now, own_drive, read_kept, write_kept
from daq_service.corrosion_drive.reading_log import LONGEST_GAP_INTERVALS
from daq_service.errors import RigError
from hardware_drivers.drive_parameters import DriveParameters
from hardware_drivers.errors import InstrumentError
from hardware_drivers.instruments import Clock, PowerSupply
from hardware_drivers.nanoseconds import NS_PER_S

log = logging.getLogger(__name__)

TICK_S = 0.05
KEEP_EVERY_S = 5.0
"""Charge and newest reading are kept so often; what the interlock does at once."""
KEEP_AGAIN_S = 1.0
"""After the disk refused it."""
LEAVE_AFTER_S = 10.0
"""A recorder that is started again finds the process that it had."""
GRACE_S = 30.0
"""After its start it waits so long for a recorder, however long none was there before."""

Verdict = Literal["stay", "switch off", "leave"]


def fingerprint(parameters: DriveParameters) -> str:
    """Tell what must be the same in a recorder and in the process of its drive."""
    return hashlib.sha256(f"{version('solimon')} {parameters!r}".encode()).hexdigest()


def what_now(
    *,
    silent_s: float,
    alone_s: float,
    unwatched_s: float,
    output: str,
    owes: bool,
    off_for_good: bool,
    stays: bool,
) -> Verdict:
    """Decide by how long no recorder was heard.

    Parameters
    ----------
    silent_s, alone_s
        Since one was heard, also by a process before this one; and since this one heard one, or began.
    output, owes
        What the output does, and whether it could not be switched off yet.
    off_for_good
        The unwatched drive was switched off already, or told to be as soon as it answers.
    stays
        It does not leave by itself.
    """
    if output == "off" and not owes:
        return "leave" if alone_s >= min(unwatched_s, LEAVE_AFTER_S) and not stays else "stay"
    return "switch off" if silent_s >= unwatched_s and not off_for_good else "stay"


class DriveProcess:
    """What the process does, between two looks at the clock; it waits nowhere by itself.

    Parameters
    ----------
    stays
        A service manager started it: it does not leave when the output is off.
    clock
        Its monotonic time counts sleep, and no step of UTC moves it.
    """

    def __init__(
        self,
        supply: PowerSupply,
        parameters: DriveParameters,
        folder: Path,
        *,
        stays: bool = False,
        clock: Clock | None = None,
    ) -> None:
        self._clock = clock or WallClock()
        self._parameters, self._folder, self._stays = parameters, folder, stays
        before = read_kept(folder)
        self._drive = ElectrochemicalDrive(
            supply, self._clock, parameters, DriveState() if before is None else before.state
        )
        now_ns = self._clock.mono_ns()
        self._heard_ns = self._met_ns = now_ns
        if before is not None and before.boot_id == boot_name() is not None:
            grace_s = min(GRACE_S, parameters.unwatched_s)
            self._heard_ns = max(
                before.heard_boot_ns, now_ns - round((parameters.unwatched_s - grace_s) * NS_PER_S)
            )
        self._kept: Kept | None = None
        self._kept_ns = now_ns
        self._disk = ""
        self.leaves = False

    def step(self) -> None:
        """Read what is due, keep what has changed, and see whether anybody watches."""
        self._drive.tick()
        state = self._drive.state
        now_ns = self._clock.mono_ns()
        silent_s = (now_ns - self._heard_ns) / NS_PER_S
        verdict = what_now(
            silent_s=silent_s,
            alone_s=(now_ns - self._met_ns) / NS_PER_S,
            unwatched_s=self._parameters.unwatched_s,
            output=self._drive.output(),
            owes=self._drive.owes_switching_off,
            off_for_good=state.unwatched,
            stays=self._stays,
        )
        if verdict == "switch off" and self._never_met(state):
            log.error("the supply was never reached; what its output does is unknown")
            verdict = "leave"
        if verdict == "switch off":
            log.error("no recorder for %.0f s: switching off", silent_s)
            self._drive.trip(
                f"nobody watched: no recorder was heard for {silent_s:.0f} s "
                f"(unwatched_s = {self._parameters.unwatched_s:g} s)",
                unwatched=True,
            )
        self.leaves = self.leaves or verdict == "leave"
        self.keep()

    def _never_met(self, state: DriveState) -> bool:
        return self._drive.row(0, 0.0).supply_age_s is None and state.output_on is not True

    def keep(self, *, at_once: bool = False) -> None:
        """Keep what whoever comes after must know; a disk that takes nothing changes nothing here."""
        kept, now_ns, row = self._kept, self._clock.mono_ns(), self._drive.row(0, 0.0)
        state = self._drive.state
        changed = kept is None or _latched(state) != _latched(kept.state) or row.supply_state != kept.output
        if not (at_once or changed or now_ns - self._kept_ns >= KEEP_EVERY_S * NS_PER_S):
            return
        self._kept_ns = now_ns
        self._kept = kept_now(
            state,
            output=row.supply_state,
            age_s=row.supply_age_s,
            heard_boot_ns=self._heard_ns,
            good_for_s=LONGEST_GAP_INTERVALS * self._parameters.log_interval_s + KEEP_EVERY_S,
        )
        try:
            write_kept(self._folder, self._kept)
            self._disk = ""
        except OSError as error:
            if not self._disk:
                log.error("charge and interlock are not kept: %s", error)
            self._disk = str(error)
            self._kept_ns -= round((KEEP_EVERY_S - KEEP_AGAIN_S) * NS_PER_S)

    def end(self) -> None:
        """Leave the supply to nobody: what is not read as off is switched off.

        Raises
        ------
        RigError
            It may still be on.
        """
        if self._drive.output() != "off" and not self._drive.trip(
            "the process of the drive was told to end, and nobody else watches", unwatched=True
        ):
            self.keep(at_once=True)
            raise RigError("the supply does not answer and may still be on; switch it off by hand")
        self.keep(at_once=True)

    # Requests of a recorder ------------------------------------------------------------------------

    def answer(self, request: Message) -> Message:
        """Do what a recorder asks, and tell how the drive stands; being asked is being watched."""
        self._heard_ns = self._met_ns = self._clock.mono_ns()
        failed: dict[str, Any] = {}
        try:
            self._obey(request)
        except (InstrumentError, ValueError, LookupError, TypeError) as error:
            failed = {"error": str(error)}
        if request["do"] != "look":
            self._drive.tick()  # what is told is read after the order
        self.keep()
        row = self._drive.row(0, 0.0)
        return {
            "id": request["id"],
            "row": summary(row),
            "conditions": [asdict(condition) for condition in self._drive.conditions()],
            "window_length": self._drive.window_length,
            "owes": self._drive.owes_switching_off,
            **failed,
        }

    def _obey(self, request: Message) -> None:
        if self.leaves:
            raise ValueError("this process is leaving, nothing was done")
        if request.get("until_boot_ns", self._heard_ns) < self._heard_ns:
            raise ValueError("it came too late, nothing was done")
        match request["do"]:
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
                self.leaves = True


def _latched(state: DriveState) -> tuple[object, ...]:
    return state.tripped, state.unwatched, state.output_on


def own_supply(
    parameters: DriveParameters,
    folder: Path,
    open_supply: Callable[[DriveParameters], Any],
    stop: threading.Event,
    *,
    stays: bool,
) -> bool:
    """Own the supply of a folder until its output is off and nobody watches, or ``stop``.

    Returns
    -------
    bool
        False when ``stop`` came first.

    Raises
    ------
    BusyError
        Another process owns it.
    RigError
        It was told to end, and the supply may still be on.
    """
    key = secrets.token_bytes(32)
    with (
        Server(key) as server,
        own_drive(folder, Address(port=server.port, key=key.hex(), fingerprint=fingerprint(parameters))),
        open_supply(parameters) as supply,
    ):
        process = DriveProcess(supply, parameters, folder, stays=stays)
        try:
            while not (process.leaves or stop.is_set()):
                process.step()
                server.serve(TICK_S, process.answer)
        except BaseException:  # a driver may also raise SystemExit
            log.exception("the process of the drive failed")
            process.end()
            raise
        if process.leaves:
            process.keep(at_once=True)
        else:
            process.end()
        return process.leaves
