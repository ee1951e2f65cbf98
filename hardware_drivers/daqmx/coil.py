"""Coil of a striker: a finite pulse timed by the board's counter, low before and after.

The level is never a static line: once started, the counter ends the pulse whatever becomes of this
program, of the connection or of the computer. Energising lifts the striker; it falls when the coil
goes off.
"""

from __future__ import annotations

import logging
import math
import time
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hardware_drivers.daqmx.boards import Board
from hardware_drivers.daqmx.connection import Connection, clear_task, clear_watchdog
from hardware_drivers.daqmx.parameters import DaqmxParameters, WatchdogWiring
from hardware_drivers.daqmx.translation import translate_errors
from hardware_drivers.errors import (
    AcquisitionTimeoutError,
    ConfigurationError,
    ConnectionLostError,
    InstrumentError,
)

if TYPE_CHECKING:
    from nidaqmx import Task
    from nidaqmx.system.watchdog import WatchdogTask

log = logging.getLogger(__name__)

CAP_S = 0.5
"""Longest pulse this module makes, whatever the parameters allow: a second cap, on purpose its own."""

DONE_MARGIN_S = 0.25
"""Wait for the counter's end beyond the pulse itself: latency of driver and network."""

PULSE_AGREEMENT = 0.01
"""The counter's time base may round the pulse by this part of it."""


@dataclass(slots=True, kw_only=True, eq=False)
class Coil:
    """Committed counter task with its watchdog, and the time until which the coil may be on."""

    position: str
    board: Board
    task: Task
    watchdog: WatchdogTask | None
    longest_s: float
    on_until: float = 0.0

    def pulse(self) -> None:
        """Pulse the coil once and block until its end; on return the counter is stopped and its output low.

        Raises
        ------
        AcquisitionTimeoutError
            The counter is not done in time, or the watchdog cut the pulse short.
        InstrumentError
            The driver failed; `on_until` is the time by which the counter has ended the pulse.
        """
        if self.watchdog is not None:
            with translate_errors(f"starting the watchdog of {self.position!r}"):
                self.watchdog.start()
        # Whatever fails from here on, the counter may have been started as late as now.
        self.on_until = math.inf
        try:
            with translate_errors(f"pulsing the coil of {self.position!r}"):
                self.task.start()
                self.task.wait_until_done(self.longest_s + DONE_MARGIN_S)
                self.task.stop()
        except BaseException:
            self.on_until = time.monotonic() + self.longest_s
            raise
        self.on_until = 0.0
        if self.watchdog is not None:
            self._stop_watchdog(self.watchdog)

    def _stop_watchdog(self, watchdog: WatchdogTask) -> None:
        """Stop the watchdog; if it has expired, clear the expiration.

        Raise AcquisitionTimeoutError if it had expired: it pulled the coil low, so the strike was missed.
        InstrumentError if the driver fails.
        """
        with translate_errors(f"stopping the watchdog of {self.position!r}"):
            expired = bool(watchdog.expired)
            if expired:
                watchdog.clear_expiration()
            watchdog.stop()
        if expired:
            raise AcquisitionTimeoutError(
                f"the watchdog of {self.board.label} expired during the strike at {self.position!r} and "
                "pulled the coil low; lengthen watchdog.timeout_s or find what delayed this program"
            )

    def close(self) -> bool:
        """Stop the pulse, then clear the tasks; return True if the driver confirmed all of it.

        Errors are logged, not raised. Afterwards `on_until` is the monotonic time (s) until which the coil
        may be on; it is 0 if the counter was stopped or cleared.
        """
        doing = f"switching off the coil of {self.position!r}"
        well = True
        try:
            with translate_errors(doing):
                self.task.stop()
            self.on_until = 0.0
        except InstrumentError as error:
            log.warning("%s: its counter could not be stopped: %s", doing, str(error))
            well = False
        if clear_task(self.task, doing):
            self.on_until = 0.0
        else:
            well = False
        if self.watchdog is not None:
            well = clear_watchdog(self.watchdog, doing) and well
        return well


def commit_coil(connection: Connection, parameters: DaqmxParameters, position: str, board: Board) -> Coil:
    """Build and commit the counter task of one striker, and its watchdog: output low, nothing moves.

    Raises
    ------
    ConfigurationError
        The pulse is longer than the cap, would be given another length or would idle high.
    BusyError, ConnectionLostError
        The board is in use, does not answer, or would pulse another terminal. No task is left after an error.
    """
    if not 0.0 < parameters.pulse_s <= CAP_S:
        raise ConfigurationError(
            f"pulse_s is {parameters.pulse_s} s; this driver pulses a coil for at most {CAP_S} s; shorten it"
        )
    doing = f"setting up the coil of {position!r} on {board.label}"
    wired = parameters.find_watchdog(board.serial)
    with ExitStack() as undo:
        # First: some boards let no watchdog be reserved next to other tasks (-201477).
        watchdog = None if wired is None else _commit_watchdog(connection, wired, board)
        if watchdog is not None:
            undo.callback(clear_watchdog, watchdog, doing)
        task = connection.create_task("striker")
        undo.callback(clear_task, task, doing)
        with translate_errors(doing):
            _configure_pulse(task, parameters, position, board)
        undo.pop_all()
    return Coil(
        position=position,
        board=board,
        task=task,
        watchdog=watchdog,
        longest_s=parameters.initial_delay_s + parameters.pulse_s,
    )


def _configure_pulse(task: Task, parameters: DaqmxParameters, position: str, board: Board) -> None:
    """Configure one pulse that idles low, verify terminal, level and length, then commit the task.

    Raise ConfigurationError for another level or length, ConnectionLostError for another terminal; other
    errors of the vendor's package pass through.
    """
    from nidaqmx.constants import Level, TaskMode

    wiring = parameters.transducers[position]
    # Without a timing of its own a pulse task makes one pulse, and on boards of every age with one counter.
    channel = task.co_channels.add_co_pulse_chan_time(
        f"{board.name}/{wiring.counter}",
        idle_state=Level.LOW,
        initial_delay=parameters.initial_delay_s,
        high_time=parameters.pulse_s,
    )
    terminal = f"/{board.name}/{wiring.output_terminal}"
    channel.co_pulse_term = terminal
    given = str(channel.co_pulse_term)
    high_s = float(channel.co_pulse_high_time)
    # Before the commit: that is what connects the output.
    if channel.co_pulse_idle_state != Level.LOW:
        raise ConfigurationError(f"{board.label} would hold the coil of {position!r} on between strikes")
    if given.strip("/").casefold() != terminal.strip("/").casefold():
        raise ConnectionLostError(
            f"{board.label} would pulse {given or 'no terminal'} instead of {terminal} of {position!r}"
        )
    if not 0.0 < high_s <= CAP_S or abs(high_s - parameters.pulse_s) > PULSE_AGREEMENT * parameters.pulse_s:
        raise ConfigurationError(
            f"pulse_s is {parameters.pulse_s} s; {board.label} would pulse for {high_s} s (at most {CAP_S} s "
            "is allowed); choose a pulse its counter can time"
        )
    task.control(TaskMode.TASK_COMMIT)


def _commit_watchdog(connection: Connection, wired: WatchdogWiring, board: Board) -> WatchdogTask:
    """Create and commit a board's watchdog, which pulls the wired lines low when it expires; do not start it.

    After an error it is cleared; InstrumentError if the driver refuses.
    """
    from nidaqmx.constants import Level, TaskMode
    from nidaqmx.types import DOExpirationState

    watchdog = connection.create_watchdog(board.name, "watchdog", wired.timeout_s)
    doing = f"setting up the watchdog of {board.label}"
    try:
        with translate_errors(doing):
            watchdog.cfg_watchdog_do_expir_states(
                [
                    DOExpirationState(physical_channel=f"{board.name}/{line}", expiration_state=Level.LOW)
                    for line in wired.lines
                ]
            )
            watchdog.control(TaskMode.TASK_COMMIT)
    except BaseException:
        clear_watchdog(watchdog, doing)
        raise
    return watchdog
