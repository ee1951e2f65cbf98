"""Connection to one board: opened, configured, lost and found again.

Recovery climbs one rung at each acquisition after the connection was lost: a fresh session, then a reset
of the board, then a search for it under its other names. Only a board with the right serial number is ever
reset. A successful record leads back to the first rung; once the ladder is used up the last rung is tried
at every acquisition, since a board may be plugged in again hours later.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from types import ModuleType
from typing import Any

from hardware_drivers.errors import (
    AcquisitionTimeoutError,
    BusyError,
    ConfigurationError,
    ConnectionLostError,
    InstrumentError,
)
from hardware_drivers.niscope.parameters import NiscopeParameters, ProbeWiring
from hardware_drivers.niscope.session import (
    Board,
    Fetched,
    Setup,
    close_session,
    configure_board,
    describe_board,
    fetch_records,
    open_session,
)
from hardware_drivers.niscope.vendor_errors import BoardAbsentError, translate_errors

RESET_RUNG = 2
SEARCH_RUNG = 3


class BoardConnection:
    """Board and the probe it is configured for.

    Parameters
    ----------
    niscope
        The vendor's package.
    wiring
        Any of the board's probes: they agree on its name and serial number.
    """

    def __init__(self, niscope: ModuleType, parameters: NiscopeParameters, wiring: ProbeWiring) -> None:
        """Store names and serial number of the board; the first call opens it."""
        self._niscope = niscope
        self._parameters = parameters
        self._names: Sequence[str] = (wiring.resource, *wiring.other_resources)
        self._serial_number = wiring.serial_number
        self._session: Any = None
        self._board: Board | None = None
        self._position: str | None = None
        self._setup: Setup | None = None
        self._failures = 0

    @property
    def board(self) -> Board | None:
        """Return the board's description as read when it was last opened; None if it never was."""
        return self._board

    def prepare(self, position: str, wiring: ProbeWiring) -> tuple[Board, Setup]:
        """Open the board if necessary and configure it for a probe, unless it already is.

        Return the board's description and its settings as read back.

        Raises
        ------
        InstrumentError
            One of the four classes; after `ConnectionLostError` the next call takes the next recovery step.
        """
        with self._close_on_loss():
            return self._open_and_configure(position, wiring)

    def acquire(
        self, position: str, wiring: ProbeWiring, timeout_s: float
    ) -> tuple[Board, Setup, Fetched, str]:
        """Acquire the records of one average; return board, settings, records and the driver's warnings.

        The board is opened and configured if necessary. The warnings are one text, empty if there were none.
        ``timeout_s`` bounds the wait for all records.

        Raises
        ------
        InstrumentError
            As for `prepare`; `AcquisitionTimeoutError` without enough triggers in time.
        """
        with self._close_on_loss():
            board, setup = self._open_and_configure(position, wiring)
            with translate_errors(self._niscope, f"recording {position!r} on {board.resource!r}") as noted:
                fetched = fetch_records(self._session, setup, wiring, timeout_s)
            self._failures = 0
            return board, setup, fetched, "; ".join(noted)

    def self_calibrate(self) -> Board:
        """Open the board if necessary, run its self-calibration, and return the board's description.

        It is configured again before the next record. Raise InstrumentError as `prepare` does.
        """
        with self._close_on_loss():
            board = self._open_board()
            self._position = None
            with translate_errors(self._niscope, f"calibrating {board.resource!r}"):
                self._session.self_cal()
            return board

    def close(self) -> None:
        """Close the board, even over a dead connection; repeated calls have no effect.

        An instrument error is suppressed: the next opening reports it if that matters.
        """
        session, self._session, self._position = self._session, None, None
        if session is None:
            return
        # What cannot be closed is lost already, and the next opening says so if that matters.
        with contextlib.suppress(InstrumentError), translate_errors(self._niscope, "closing"):
            close_session(self._niscope, session)

    @contextlib.contextmanager
    def _close_on_loss(self) -> Iterator[None]:
        """Run a block; if it loses the connection, close the board, count a failure and raise the error.

        The failure makes the next call take the next recovery step. After any other instrument error but a
        timeout the board is configured again before the next record.
        """
        try:
            yield
        except ConnectionLostError as error:
            self.close()
            self._failures += 1
            if self._failures > SEARCH_RUNG:
                raise ConnectionLostError(f"{error}; not back after {self._failures - 1} attempts") from error
            raise
        except AcquisitionTimeoutError:
            raise
        except InstrumentError:
            # Whatever the board is set up for now: say it all again before the next record.
            self._position = None
            raise

    def _open_and_configure(self, position: str, wiring: ProbeWiring) -> tuple[Board, Setup]:
        """Open the board if necessary, and configure it unless it is configured for this probe.

        Return the board's description and its settings as read back. Instrument errors pass through.
        """
        board = self._open_board()
        if self._position != position or self._setup is None:
            self._position, self._setup = None, None
            with translate_errors(self._niscope, f"setting {board.resource!r} up for {position!r}"):
                self._setup = configure_board(self._niscope, self._session, board, self._parameters, wiring)
            self._position = position
        return board, self._setup

    def _open_board(self) -> Board:
        """Return the board, opened if necessary with the recovery step that earlier failures require.

        Other names are tried for a board that was never opened, and from `SEARCH_RUNG` failures on. Raise
        BusyError if one of these boards is in use, ConfigurationError if a board that never answered is
        absent under all names, otherwise ConnectionLostError.
        """
        if self._session is not None and self._board is not None:
            return self._board
        known = self._board
        names = self._names if known is None or self._failures >= SEARCH_RUNG else (known.resource,)
        problems: list[BusyError | ConnectionLostError] = []
        for name in names:
            try:
                self._board = self._open_board_by_name(name)
            except (BusyError, ConnectionLostError) as error:
                problems.append(error)
                continue
            self._serial_number = self._board.serial_number
            return self._board
        kind: type[InstrumentError] = ConnectionLostError
        if any(isinstance(problem, BusyError) for problem in problems):
            kind = BusyError
        elif known is None and all(isinstance(problem, BoardAbsentError) for problem in problems):
            # A board that has never answered is not lost: the configuration names one that is not there.
            kind = ConfigurationError
        raise kind("; ".join(map(str, problems))) from problems[0]

    def _open_board_by_name(self, name: str) -> Board:
        """Open the board of a name, verify its serial number, and reset it if recovery requires that.

        Raise BoardAbsentError if another board has the name, InstrumentError if it does not open; after any
        error the board is closed.
        """
        with translate_errors(self._niscope, f"opening {name!r}"):
            self._session = open_session(self._niscope, name)
        try:
            with translate_errors(self._niscope, f"asking {name!r} who it is"):
                board = describe_board(self._session, name)
                if self._serial_number and _normalize_serial(board.serial_number) != _normalize_serial(
                    self._serial_number
                ):
                    raise BoardAbsentError(
                        f"{name!r} is a {board.product} with serial number {board.serial_number!r}, not "
                        f"{self._serial_number!r}"
                    )
                if self._failures >= RESET_RUNG:
                    self._session.reset_device()
        except BaseException:
            self.close()
            raise
        return board


def _normalize_serial(serial_number: str) -> str:
    """Normalize a serial number for comparison: no outer spaces, no leading zeros, case-folded."""
    return serial_number.strip().lstrip("0").casefold()
