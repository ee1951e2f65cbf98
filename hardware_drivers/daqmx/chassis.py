"""Chassis shared by digitizer and striker: boards, the active transducer, recovery after a loss.

Transducers take turns: a board has one timing engine for analog input, so the tasks of one transducer
are committed when its turn begins and cleared when another's does. Within a turn a shot is a start and
a stop; nothing is created.

Several boards need no common clock: a shot uses one analog-input board and one counter, and the
record's time zero is its own trigger, so a counter on another board may start a little sooner or later.
What matters is the order, which is kept here: acquisition first, counter second, and the counter's
delay lets the pre-trigger fill, unless the counter itself starts the acquisition (``holdoff_s``). With
``reference_clock`` each digitizer's time base follows the chassis's clock, and then all records share
one scale of time.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from hardware_drivers.daqmx.acquisition import Acquisition, Record, commit_acquisition
from hardware_drivers.daqmx.boards import Board, check_board, find_boards, normalize_serial
from hardware_drivers.daqmx.client_lock import ClientLock
from hardware_drivers.daqmx.coil import Coil, commit_coil
from hardware_drivers.daqmx.connection import Connection, build_client_name, read_package_versions
from hardware_drivers.daqmx.parameters import DaqmxParameters
from hardware_drivers.daqmx.translation import find_resource_owner, translate_errors
from hardware_drivers.errors import BusyError, ConfigurationError, ConnectionLostError, InstrumentError

log = logging.getLogger(__name__)

ROLES = ("digitizer", "striker", "watchdog")
"""The tasks there can be at one time; on a gRPC server they are found again by these names."""

LADDER = ("fresh tasks", "reset of our boards", "new connection, boards found again")
"""Rungs of recovery, the gentlest first; the last one is tried again and again."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Turn:
    """Committed tasks of one transducer; None for those of another instrument."""

    position: str
    record: Record
    acquisition: Acquisition | None
    coil: Coil | None


class Chassis:
    """Owner of all vendor objects; used by one thread.

    Parameters
    ----------
    parameters
        Checked against the boards while opening: what cannot work is refused now, not at night.

    Raises
    ------
    ConfigurationError, BusyError, ConnectionLostError
        As `commit_all_transducers`; nothing is left behind.
    """

    def __init__(self, parameters: DaqmxParameters) -> None:
        """Connect, find the boards and commit each transducer once; after an error nothing is left."""
        self.parameters = parameters
        self.driver_version = ""
        self._thread = threading.get_ident()
        self._lock: ClientLock | None = None
        self._connection: Connection | None = None
        self._boards: dict[str, Board] = {}
        self._turn: Turn | None = None
        self._broken = False
        self._rung = 0
        self._lost = 0
        self._shared = False
        self._maybe_on: tuple[str, float] = ("", 0.0)
        try:
            if parameters.transport == "grpc":
                self._lock = ClientLock(parameters.grpc_address, build_client_name(parameters))
            self._connect()
            self.commit_all_transducers()
        except BaseException:
            self.close()
            raise

    # One thread ----------------------------------------------------------------------------------

    def require_own_thread(self) -> None:
        """Raise ConfigurationError in another thread than the opening one: NI's tasks are not thread-safe."""
        if threading.get_ident() != self._thread:
            raise ConfigurationError(
                f"the instruments were opened by thread {self._thread} and called by thread "
                f"{threading.get_ident()}; call them from the one that opened them"
            )

    # Turns ---------------------------------------------------------------------------------------

    def commit_tasks(self, position: str, record: Record = "shot") -> Turn:
        """Return a transducer's tasks, committed if necessary; after a loss, take a recovery step before.

        Parameters
        ----------
        record
            Kind of record; in a dry run ``noise`` in place of ``shot``. After an error no task is left.
        """
        self._take_recovery_step()
        if record == "shot" and self.parameters.dry_run:
            record = "noise"
        if self._turn is not None and (self._turn.position, self._turn.record) == (position, record):
            return self._turn
        self.clear_tasks()
        self._turn = self._commit_new_tasks(position, record)
        return self._turn

    def acquisition(self, position: str, record: Record = "shot") -> Acquisition:
        """Return a transducer's acquisition, committed if necessary; AssertionError if no input is wired."""
        acquisition = self.commit_tasks(position, record).acquisition
        assert acquisition is not None, "asked for with its input only"
        return acquisition

    def coil(self, position: str, record: Record = "shot") -> Coil:
        """Return a transducer's coil, committed if necessary; AssertionError if no counter is wired here."""
        coil = self.commit_tasks(position, record).coil
        assert coil is not None, "asked for with its counter only"
        return coil

    def clear_tasks(self) -> None:
        """Clear the committed tasks, the coil's first; note a coil that may be on. Errors are only logged."""
        turn, self._turn = self._turn, None
        if turn is None:
            return
        well = False
        try:
            well = turn.coil is None or turn.coil.close()
        finally:
            well = (turn.acquisition is None or turn.acquisition.close()) and well
        if turn.coil is not None and turn.coil.on_until > time.monotonic():
            self._maybe_on = (turn.position, turn.coil.on_until)
        if not well:
            self._clear_tasks_by_name(ROLES)

    def _commit_new_tasks(self, position: str, record: Record) -> Turn:
        """Commit the tasks of a transducer, the coil first, as wired; after an error none is left."""
        wiring = self.parameters.transducers[position]
        connection = self.connection
        coil_board = self._boards[normalize_serial(wiring.coil_serial)]
        board = self._boards[normalize_serial(wiring.board_serial)]
        with ExitStack() as undo:
            coil = acquisition = None
            if wiring.strikes:
                coil = commit_coil(connection, self.parameters, position, coil_board)
                undo.callback(coil.close)
            if wiring.digitizes:
                acquisition = commit_acquisition(
                    connection, self.parameters, position, board, coil_board, record=record
                )
            undo.pop_all()
        return Turn(position=position, record=record, acquisition=acquisition, coil=coil)

    def commit_all_transducers(self) -> None:
        """Check each board, commit and clear each transducer's tasks; InstrumentError if one is rejected."""
        for position, wiring in self.parameters.transducers.items():
            if wiring.digitizes:
                check_board(self._boards[normalize_serial(wiring.board_serial)], wiring, self.parameters)
            self.commit_tasks(position)
        self.clear_tasks()

    def require_real_boards(self) -> None:
        """Raise ConfigurationError for a board that NI's driver simulates, except in a dry run."""
        simulated = [board.label for board in self._boards.values() if board.simulated]
        if simulated and not self.parameters.dry_run:
            raise ConfigurationError(
                f"{', '.join(simulated)} is simulated by NI's driver, which makes its records up; set "
                "dry_run = true in [rig.daqmx] for a rehearsal, or name a real board"
            )

    # The coil ------------------------------------------------------------------------------------

    def make_safe(self) -> None:
        """Switch the coil off: clear all tasks, by name on a server if it may still be on.

        Raises
        ------
        ConnectionLostError
            The coil's state is unknown; its board's counter ends the pulse in any case.
        """
        self.clear_tasks()
        position, until = self._maybe_on
        left_s = until - time.monotonic()
        if left_s <= 0.0 or self._clear_tasks_by_name(ROLES):
            return
        raise ConnectionLostError(
            f"the coil of {position!r} may be on for another {left_s:.2g} s: its board does not answer; the "
            f"board's counter ends the pulse after pulse_s = {self.parameters.pulse_s} s in any case"
        )

    def _clear_tasks_by_name(self, roles: Sequence[str]) -> bool:
        """Clear these roles' tasks on a server; True if none is left, False without server or on an error."""
        try:
            cleared = self._connection is not None and self._connection.clear_leftover_tasks(roles)
        except InstrumentError as error:
            log.warning("tasks on the server could not be cleared by name: %s", str(error))
            return False
        if cleared:
            self._maybe_on = ("", 0.0)
        return cleared

    # Losses and recovery -------------------------------------------------------------------------

    @contextmanager
    def guard_operation(self) -> Iterator[None]:
        """Run a block on the boards; after any error, clear the tasks and raise it.

        A lost connection selects a recovery step. If our own old task made the board busy, that is one.
        """
        try:
            yield
        except BaseException as error:
            self.clear_tasks()
            if isinstance(error, ConnectionLostError):
                self._record_connection_loss(error)
            elif isinstance(error, BusyError):
                self._handle_busy_board(error)
            raise

    def _record_connection_loss(self, error: ConnectionLostError) -> None:
        """Count and log a lost connection and select the next recovery step.

        Raise ConnectionLostError if the last step had already been tried.
        """
        self._lost += 1
        tried = self._rung
        self._rung = min(tried + 1, len(LADDER))
        self._broken = True
        log.warning(
            "connection lost (%d in a row), next: %s: %s", self._lost, LADDER[self._rung - 1], str(error)
        )
        if tried == len(LADDER):
            raise ConnectionLostError(
                f"{error}; still so after {self._lost - 1} attempts ({'; '.join(LADDER)}); every further "
                "shot tries the last one again"
            ) from error

    def _handle_busy_board(self, error: BusyError) -> None:
        """Bar resets, as another program uses a board; ConnectionLostError if it is our own old task."""
        # The driver's text names the task that was refused too, and that one is always ours.
        owner = find_resource_owner(str(error.__cause__))
        if self._connection is None or not self._connection.is_own_task(owner):
            self._shared = True
            return
        lost = ConnectionLostError(f"{error}; that is a task of our own, which the driver did not clear")
        self._record_connection_loss(lost)
        raise lost from error

    def reset_recovery(self) -> None:
        """Set recovery back to its first step, because an intact record was read."""
        self._rung = self._lost = 0

    def _take_recovery_step(self) -> None:
        """Take the selected step of `LADDER` if the connection was lost; instrument errors pass through."""
        if not self._broken:
            return
        log.info("recovering: %s", LADDER[self._rung - 1])
        self.clear_tasks()
        if self._rung == 1:
            self.connection.clear_leftover_tasks(ROLES)
        elif self._rung == 2:
            self._boards = find_boards(self.connection, list_board_serials(self.parameters))
            self._reset_boards()
        else:
            self._connect()
        self._broken = False

    def _reset_boards(self) -> None:
        """Reset all boards, or only log a warning if another program uses one; InstrumentError on failure."""
        if self._shared:
            log.warning("not resetting: another program uses one of these boards")
            return
        for board in self._boards.values():
            with translate_errors(f"resetting {board.label}"):
                board.device.reset_device()
        self._maybe_on = ("", 0.0)

    @property
    def coil_off_at(self) -> float:
        """Return the monotonic time (s) by which every coil is off in any case: now, or a pulse's own end."""
        return max(time.monotonic(), self._maybe_on[1])

    def _connect(self) -> None:
        """Reconnect, clear leftover tasks, find the boards; InstrumentError if board or driver is absent."""
        if self._connection is not None:
            self._connection.close()
        self._connection = Connection(self.parameters)
        self._connection.clear_leftover_tasks(ROLES)
        self._boards = find_boards(self._connection, list_board_serials(self.parameters))
        self.driver_version = self._connection.driver_version()

    @property
    def connection(self) -> Connection:
        """Return the connection to the driver; ConfigurationError if the rig is closed."""
        if self._connection is None:
            raise ConfigurationError("the rig is closed; open it again")
        return self._connection

    # Calibration, identity, end ------------------------------------------------------------------

    def self_calibrate(self) -> dict[str, str]:
        """Calibrate digitizer boards, commit all again; return text (date, temperature) by serial number."""
        self.clear_tasks()
        self._take_recovery_step()
        done = {}
        wirings = self.parameters.transducers.values()
        for serial in {normalize_serial(wiring.board_serial) for wiring in wirings if wiring.digitizes}:
            board = self._boards[serial]
            if not board.calibrates_itself:
                done[serial] = "this board cannot calibrate itself"
                continue
            with translate_errors(f"self-calibrating {board.label}"):
                board.device.self_cal()
        self._boards = find_boards(self.connection, list_board_serials(self.parameters))
        self.commit_all_transducers()
        for serial, board in self._boards.items():
            if serial not in done and board.calibrates_itself:
                date = board.calibration_date or "date unknown"
                done[serial] = f"{date}, {board.calibration_temperature_c:.1f} C"
        return done

    def identity(self) -> dict[str, str]:
        """Return transport, versions of driver and package, and each board's product, by name of the item."""
        return {
            "transport": self.parameters.transport,
            "daqmx_driver_version": self.driver_version,
            **read_package_versions(),
            **{f"board_{serial}": board.product for serial, board in self._boards.items()},
        }

    def close(self) -> None:
        """Clear all tasks (coil off), close the connection, release the client name; harmless when closed."""
        try:
            self.clear_tasks()
        finally:
            connection, self._connection = self._connection, None
            try:
                if connection is not None:
                    connection.close()
            finally:
                if self._lock is not None:
                    self._lock.release()


def list_board_serials(parameters: DaqmxParameters) -> list[str]:
    """Return the serial numbers of all digitizer boards, then of all coil boards, as configured.

    Each transducer gives both, so a number may be repeated.
    """
    wirings = parameters.transducers.values()
    return [wiring.board_serial for wiring in wirings] + [wiring.coil_serial for wiring in wirings]
