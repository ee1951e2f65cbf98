"""Kind of instrument for a relay board at a serial port.

The board takes lines (``relay on 0``, ``relay off 0``, ``relay read 0``), each ended by a carriage return,
and ends each answer with a ``>``. The computer makes the pulse: see the README for what that means.
"""

from __future__ import annotations

import errno
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from hardware_drivers.errors import BusyError, ConfigurationError, ConnectionLostError, InstrumentError
from hardware_drivers.kinds import Finding, Kind, Opened, Opening, Role, build_error_finding
from hardware_drivers.measurement import ShotKey

LONGEST_PULSE_S = 0.5
"""No configuration makes a coil stay on longer."""
PROMPT = b">"
TRIES = 2
"""To switch off: the second over a port opened anew."""
CABLE = "check the board's cable and the port's name"


class RelayParameters(BaseModel):
    """Parameters of one relay board."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    port: str
    """Serial port: ``COM3``, ``/dev/serial/by-id/...``."""
    relays: dict[str, Annotated[int, Field(ge=0, le=31)]] = Field(min_length=1)
    """Number of each position's relay."""
    pulse_s: float = Field(default=0.1, ge=1e-3, le=LONGEST_PULSE_S)
    """Time that the relay is on."""
    reply_timeout_s: float = Field(default=1.0, gt=0.0, le=10.0)
    """Longest wait for an answer of the board."""


class RelayBoard:
    """Board behind its port, which is opened again after a loss."""

    def __init__(self, port: str, reply_timeout_s: float) -> None:
        self._name, self._timeout_s = port, reply_timeout_s
        self._port: Any = None

    def switch_on(self, number: int) -> None:
        """Switch a relay on; raise if the board does not confirm it."""
        self._switch(number, "on")

    def switch_off(self, number: int) -> None:
        """Switch a relay off and read that back; a failed port is opened again once."""
        for left in reversed(range(TRIES)):
            try:
                self._switch(number, "off")
            except InstrumentError as error:
                self.close()
                if not left:
                    raise ConnectionLostError(
                        f"relay {number} may be on ({error}); pull the coils' plug, then look at the board"
                    ) from error
            else:
                return

    def version(self) -> str:
        """Query the board's firmware version."""
        return self._ask("ver") or "unknown"

    def close(self) -> None:
        """Close the port; harmless when closed."""
        port, self._port = self._port, None
        if port is not None:
            port.close()

    def _switch(self, number: int, state: str) -> None:
        self._ask(f"relay {state} {number}")
        actual = self._ask(f"relay read {number}")
        if actual != state:
            raise ConnectionLostError(f"relay {number} says {actual!r} instead of {state!r}; {CABLE}")

    def _ask(self, command: str) -> str:
        """Send a line and return the text between its echo and the prompt."""
        import serial

        try:
            if self._port is None:
                self._port = serial.serial_for_url(
                    self._name, timeout=self._timeout_s, write_timeout=self._timeout_s, exclusive=True
                )
            self._port.reset_input_buffer()
            self._port.write(f"{command}\r".encode("ascii"))
            answer: bytes = self._port.read_until(PROMPT)
        except (serial.SerialException, OSError) as error:
            self.close()
            if getattr(error, "errno", None) in (errno.EAGAIN, errno.EBUSY, errno.EACCES):
                raise BusyError(
                    f"{self._name} is held by another program or user ({error}); end it"
                ) from error
            raise ConnectionLostError(f"{self._name} is gone ({error}); {CABLE}") from error
        if not answer.endswith(PROMPT):
            raise ConnectionLostError(
                f"no whole answer to {command!r} within {self._timeout_s:g} s, only {answer!r}; {CABLE}"
            )
        response = answer[: -len(PROMPT)].decode("ascii", errors="replace").strip()
        return response.removeprefix(command).strip()


class RelayStriker:
    """Striker that pulses one relay per strike."""

    def __init__(self, board: RelayBoard, parameters: RelayParameters) -> None:
        self._board, self._relays, self._pulse_s = board, parameters.relays, parameters.pulse_s

    def strike(self, key: ShotKey) -> None:
        """Switch the position's relay on and off again; off is confirmed on return."""
        if key.position not in self._relays:
            raise ConfigurationError(f"no relay for {key.position!r}; relays has: {', '.join(self._relays)}")
        number = self._relays[key.position]
        try:
            self._board.switch_on(number)
            time.sleep(self._pulse_s)
        finally:
            self._board.switch_off(number)

    def make_safe(self) -> None:
        """Switch every relay off, even if one of them fails."""
        errors = []
        for number in self._relays.values():
            try:
                self._board.switch_off(number)
            except InstrumentError as error:
                errors.append(error)
        if errors:
            raise errors[0]


@contextmanager
def _open(parameters: RelayParameters, opening: Opening) -> Iterator[Opened]:
    board = RelayBoard(parameters.port, parameters.reply_timeout_s)
    striker = RelayStriker(board, parameters)
    try:
        # A program that died may have left one on.
        striker.make_safe()
        yield Opened(striker=striker, identity={"relay_board": board.version(), "port": parameters.port})
    finally:
        try:
            striker.make_safe()
        finally:
            board.close()


def _check(parameters: RelayParameters, opening: Opening) -> Iterator[Finding]:
    """Check the identity of the board; nothing is switched."""
    board, subject = RelayBoard(parameters.port, parameters.reply_timeout_s), f"relay board {parameters.port}"
    try:
        yield Finding(subject=subject, check="answers", state="ok", detail=f"firmware {board.version()}")
    except InstrumentError as error:
        yield build_error_finding(subject, "answers", error, CABLE)
    finally:
        board.close()


def _require(parameters: RelayParameters, serves: Mapping[Role, tuple[str, ...]]) -> None:
    for position in serves.get("striker", ()):
        if position not in parameters.relays:
            raise ValueError(f"relays has no {position!r}; add its relay, or name another striker for it")


KIND = Kind(
    parameters=RelayParameters,
    open=_open,
    check=_check,
    packages=lambda parameters: ("pyserial",),
    # On, its read-back, off and its read-back, the last two perhaps twice.
    longest_call_s=lambda parameters: parameters.pulse_s + 6.0 * parameters.reply_timeout_s,
    reached_by=frozenset({"port", "reply_timeout_s"}),
    require=_require,
)
