"""Line to one instrument, serial, TCP or VISA: queries and responses as text, each bounded in time.

A line is in step with its instrument or it is not. Whatever goes wrong (silence, garbage, an unplugged
cable) takes it out of step, and what an instrument answers too late would then answer the next question:
so the next call first asks who is there and throws away everything that comes before the expected name.
Nothing else is ever sent to an instrument that has another. A port stays open over a single fault, since
opening resets some instruments; it is opened again when it is gone or its instrument stays silent.

Instruments differ in how they say a thing: a unit or the question's own header may stand next to a number,
and every command may come back as an echo. All of that is understood; a wrong unit or a foreign header is
not, since it answers something else.

Attempts back off on the caller's clock: a call that comes too early fails at once with the
cause of the last attempt, and no call waits longer than its timeout.
"""

from __future__ import annotations

import contextlib
import logging
import math
import re
import time
from collections.abc import Callable, Collection, Iterator

import serial

from hardware_drivers.errors import ConfigurationError, ConnectionLostError, InstrumentError
from hardware_drivers.measurement import Stamp
from hardware_drivers.nanoseconds import NS_PER_S
from hardware_drivers.serial_port.parameters import SerialLineParameters
from hardware_drivers.serial_port.port import PORT_ERRORS, Port, open_port

log = logging.getLogger(__name__)

SHOWN_BYTES = 60
"""So much of a refused reply is shown."""

ATTEMPTS_PER_OPENING = 3
"""An instrument that was silent so often in a row is looked for behind a port opened again."""

LINES_BEFORE_NAME = 32
"""So many late answers are thrown away before the name; more is an instrument that talks by itself."""

_ERROR_QUEUE_ENTRY = re.compile(r"[+-]?\d+\s*,")
_BARE_ERROR = re.compile(r"[+-]?\d+$")
_NUMBER = re.compile(
    r"(?:(?P<header>[A-Z]+\d*)\s+)?"
    r"(?P<number>[+-]?(?:\d+\.?\d*|\.\d+)(?:E[+-]?\d+)?|nan|[+-]?inf)"
    r"\s*(?P<unit>[A-Z%]*)",
    re.IGNORECASE,
)
_PREFIXES = {"": 1.0, "k": 1e3, "m": 1e-3, "u": 1e-6}


class SerialLine:
    """Line to the instrument with the expected name; opened by the first call that needs it.

    Parameters
    ----------
    identity
        Regular expression that the answer to ``identity_query`` must begin with.
    stamp
        The caller's clock: its monotonic time spaces the attempts to open.
    monotonic_s
        The machine's monotonic time, in which deadlines are given.

    Attributes
    ----------
    in_step
        True while the port is open and every response since the expected name was right.
    name
        The instrument's last response to the identity query.
    """

    def __init__(
        self,
        parameters: SerialLineParameters,
        *,
        identity: str,
        stamp: Callable[[], Stamp],
        identity_query: str = "*IDN?",
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """Start out of step with the instrument, with the port closed."""
        self.monotonic_s = monotonic_s
        self.parameters = parameters
        self._identity = re.compile(identity)
        self._identity_query = identity_query
        self._stamp = stamp
        self._port: Port | None = None
        self._echoes = False
        self.in_step = False
        self.name = ""
        self._attempts = 0
        self._next_attempt_ns = 0
        self._trouble: tuple[type[InstrumentError], str] | None = None

    # Opening -------------------------------------------------------------------------------------

    def connect(self, deadline_s: float, *, at_once: bool = False) -> bool:
        """Open the port and verify the instrument's identity, unless the line is in step already.

        Parameters
        ----------
        deadline_s
            Monotonic time of the machine at which the call must have ended.
        at_once
            Ignore the wait after a failed attempt: for a person's command and for switching off.

        Returns
        -------
        bool
            True if this call brought the line into step; False if it was.

        Raises
        ------
        BusyError
            Another program owns the port.
        ConfigurationError
            No right to open it, no serial port, or another instrument is there.
        ConnectionLostError
            No such port now, or no response. An attempt that comes too early raises the last error again.
        """
        if self.in_step:
            return False
        now_ns = self._stamp().mono_ns
        if self._trouble is not None and not at_once and now_ns < self._next_attempt_ns:
            wait_s = (self._next_attempt_ns - now_ns) / NS_PER_S
            kind, message = self._trouble
            raise kind(f"{message}; next attempt in {wait_s:.3g} s")
        try:
            self.name = self._reach_instrument(deadline_s)
        except InstrumentError as error:
            self._attempts += 1
            if isinstance(error, ConfigurationError) or self._attempts % ATTEMPTS_PER_OPENING == 0:
                self.close()
            wait_s = min(
                self.parameters.reconnect_first_s * 2.0 ** min(self._attempts - 1, 40),
                self.parameters.reconnect_longest_s,
            )
            self._next_attempt_ns = self._stamp().mono_ns + round(wait_s * NS_PER_S)
            tries = f"after {self._attempts} attempt" + ("s" if self._attempts > 1 else "")
            self._trouble = (type(error), f"{error} ({tries})")
            raise type(error)(self._trouble[1]) from error
        if self._trouble is not None:
            log.warning("%s: back after %d failed attempts to reach it", self._format_name(), self._attempts)
        self._attempts, self._trouble, self.in_step = 0, None, True
        return True

    def _reach_instrument(self, deadline_s: float) -> str:
        """Return the identity of the instrument at the open port; open the port if it is closed or gone.

        A silent instrument behind an open port is a ConnectionLostError; the port stays open. Errors of
        `open_port` and `_query_identity` pass through.
        """
        if self._port is not None:
            try:
                return self._query_identity(deadline_s)
            except ConnectionLostError:
                if self._port is not None:
                    raise  # silent, but there
        # A port that has just gone may be back already, as another terminal behind the same name.
        self._port = open_port(self.parameters)
        return self._query_identity(deadline_s)

    def _query_identity(self, deadline_s: float) -> str:
        """Query the identity and return it; lines before the expected name are late responses and discarded.

        The wait ends at ``deadline_s`` (monotonic), after the reply timeout or `LINES_BEFORE_NAME` lines.
        Raise ConfigurationError if another instrument answers, ConnectionLostError for silence or garbage.
        """
        deadline_s = min(deadline_s, self.monotonic_s() + self.parameters.reply_timeout_s)
        self._echoes = False
        self._write_line(self._identity_query)
        strangers, garbage = [], []
        pending = bytearray()
        for _ in range(LINES_BEFORE_NAME):
            if (raw := self._read_line(pending, deadline_s)) is None:
                break
            reply = _decode_response(raw)
            if reply == self._identity_query:
                self._echoes = True  # as it does with every command
                continue
            if reply is not None and self._identity.match(reply):
                return reply
            if reply is None or not _is_instrument_name(reply):
                garbage.append(raw)
            else:
                strangers.append(reply)
                if reply.count(",") >= 3:  # maker, model, serial number, firmware: no one else will answer
                    break
        subject = f"the instrument at {self.parameters.port}"
        if strangers:
            raise ConfigurationError(
                f"{subject} answers as {strangers[-1]!r}; expected a name that begins with "
                f"{self._identity.pattern!r}: connect the right instrument, or correct its identity"
            )
        garbage += [bytes(pending)] if pending else []
        if garbage:
            raise ConnectionLostError(
                f"{subject} answered {_quote(garbage[-1])} to {self._identity_query}; check baud "
                "rate, parity and terminator"
            )
        raise ConnectionLostError(
            f"{subject} does not answer {self._identity_query} within {self.parameters.reply_timeout_s:g} s; "
            "check that it is on, its cable and its baud rate"
        )

    def close(self) -> None:
        """Close the port; repeated calls have no effect. Errors of a port that is gone are suppressed."""
        port, self._port, self.in_step = self._port, None, False
        if port is None:
            return
        with contextlib.suppress(*PORT_ERRORS):
            # What the instrument did not take would hold up the closing for half a minute.
            port.reset_output_buffer()
        with contextlib.suppress(*PORT_ERRORS):
            port.close()

    # Talking -------------------------------------------------------------------------------------

    def send(self, command: str) -> None:
        """Send a command that has no response.

        Without a terminator it blocks for one poll of the port; where the instrument echoes commands, until
        the echo or the reply timeout.

        Raises
        ------
        ConnectionLostError
            It could not be sent, or the port is gone.
        """
        self._write_line(command)
        if not self.parameters.terminator:
            with self._translate_errors("be read"):
                # Only a pause separates this command from the next; nothing is expected in it.
                self._port.read(self.parameters.longest_reply_bytes)  # type: ignore[union-attr] # just written
        elif self._echoes:
            # Awaited, since it must not come in front of the next answer.
            self._read_line(bytearray(), self.monotonic_s() + self.parameters.reply_timeout_s)

    def query(self, question: str, deadline_s: float) -> str:
        """Send a query; return its response as printable ASCII without terminator and surrounding spaces.

        Parameters
        ----------
        deadline_s
            Monotonic time at which the call must have ended; the reply timeout may end it sooner.

        Raises
        ------
        ConnectionLostError
            No response in time, or one that is no text, too long or followed by another: the line finds
            its step again at the next `connect`.
        """
        raw = self._query_bytes(question, deadline_s)
        reply = _decode_response(raw)
        if reply is None:
            raise self.mark_lost(f"answered {_quote(raw)} to {question}: that is no text")
        return reply

    def _query_bytes(self, question: str, deadline_s: float) -> bytes:
        """Send a query and return its response as bytes, without its terminator and an echo of the query.

        Raise ConnectionLostError without a response by ``deadline_s`` (monotonic) or within the reply
        timeout, and for a second response.
        """
        now_s = self.monotonic_s()
        if now_s >= deadline_s:
            raise ConnectionLostError(
                f"{self._format_name()}: no time left to ask {question}; it is too slow for the timeout given"
            )
        self._write_line(question)
        reply_timeout_s = self.parameters.reply_timeout_s
        pending = bytearray()
        answered_by_s = min(deadline_s, now_s + reply_timeout_s)
        raw = self._read_line(pending, answered_by_s)
        if self._echoes and raw is not None and _decode_response(raw) == question:
            raw = self._read_line(pending, answered_by_s)
        if raw is None:
            raise self.mark_lost(
                f"did not answer {question} in time (at most {reply_timeout_s:g} s)"
                + (f"; it sent only {_quote(bytes(pending))}" if pending else "")
            )
        if pending:
            raise self.mark_lost(f"answered {question} twice: {_quote(raw)} and {_quote(bytes(pending))}")
        return raw

    def query_number(
        self,
        question: str,
        deadline_s: float,
        *,
        units: Collection[str] = (),
        header: str = "",
        stray: str = "",
    ) -> float:
        """Send a query and return its response, a finite number.

        Parameters
        ----------
        deadline_s
            Monotonic time at which the call must have ended.
        units
            May follow the number, as they are or with the prefix k, m or u, which scales it.
        header
            May precede the number; so may the query's own header.
        stray
            May follow the number and is ignored.

        Raises
        ------
        ConnectionLostError
            As `query`, and for anything that is no number, has another unit or header, or is SCPI's 9.9E37
            (infinite) and 9.91E37 (not a number).
        """
        reply = self.query(question, deadline_s)
        found = _NUMBER.fullmatch(reply)
        if found is None:
            raise self.mark_lost(f"answered {reply!r} to {question}: that is no number")
        value = float(found["number"])
        if not math.isfinite(value) or abs(value) >= 9.9e37:
            raise self.mark_lost(f"answered {reply!r} to {question}: it has no value to give")
        headers = {"", header.upper(), question.rstrip("?").upper()}
        if (found["header"] or "").upper() not in headers:
            raise self.mark_lost(f"answered {reply!r} to {question}: that answers another question")
        if found["unit"] in {"", stray}:
            return value
        for unit in units:
            prefix = found["unit"][: len(found["unit"]) - len(unit)]
            if found["unit"].upper().endswith(unit.upper()) and prefix in _PREFIXES:
                return value * _PREFIXES[prefix]
        raise self.mark_lost(
            f"answered {reply!r} to {question}: expected {' or '.join(units) or 'no unit'} behind the number"
        )

    def query_flag(self, question: str, deadline_s: float, *, mask: int = 0, raw: bool = False) -> bool:
        """Send a query whose response is yes (True) or no, and return it.

        Parameters
        ----------
        mask
            The response is a register, and any of these bits means yes; 0: it is 0 or 1 (or OFF or ON, NO or
            YES).
        raw
            The register comes as one byte instead of a decimal number.

        Raises
        ------
        ConnectionLostError
            As `query`, and for any other response.
        """
        if raw:
            byte = self._query_bytes(question, deadline_s)
            if len(byte) != 1:
                raise self.mark_lost(f"answered {_quote(byte)} to {question}: expected one byte")
            return bool(byte[0] & mask)
        reply = self.query(question, deadline_s)
        state_text = reply.upper().removeprefix(f"{question.rstrip('?').upper()} ")
        if mask and state_text.isdecimal():
            return bool(int(state_text) & mask)
        if not mask and state_text in {"1", "+1", "ON", "YES"}:
            return True
        if not mask and state_text in {"0", "+0", "OFF", "NO"}:
            return False
        raise self.mark_lost(f"answered {reply!r} to {question}: expected {'a number' if mask else '0 or 1'}")

    def query_error(self, question: str, deadline_s: float, *, bare: bool = False) -> str | None:
        """Query one entry of the instrument's error queue and return its text; None if the queue is empty.

        Parameters
        ----------
        bare
            An entry is a number alone, without a comma and a text.

        Raises
        ------
        ConnectionLostError
            As `query`, and for any response that is no such entry.
        """
        reply = self.query(question, deadline_s)
        if not (_BARE_ERROR if bare else _ERROR_QUEUE_ENTRY).match(reply):
            raise self.mark_lost(f"answered {reply!r} to {question}: that is no entry of an error queue")
        return None if int(reply.partition(",")[0]) == 0 else reply

    def _write_line(self, command: str) -> None:
        """Discard received data, then send a command with its terminator.

        Raise ConnectionLostError if the port is closed, gone or does not take it within the reply timeout.
        """
        if self._port is None:
            raise ConnectionLostError(f"{self._format_name()} is closed")
        with self._translate_errors(f"send {command}"):
            # A reply that came too late must not answer this command.
            self._port.reset_input_buffer()
            self._port.write((command + self.parameters.terminator).encode("ascii"))

    def _read_line(self, pending: bytearray, deadline_s: float) -> bytes | None:
        """Return the next line without its terminator, None at the deadline (monotonic, s).

        Received bytes after it stay in ``pending``, which is read first. Without a terminator, silence ends a
        line.

        Raises
        ------
        ConnectionLostError
            The port is gone, or the line is longer than any response.
        """
        port, terminator = self._port, self.parameters.terminator.encode("ascii")
        assert port is not None, "only called while open"
        while True:
            if terminator and terminator in pending:
                line, _, pending[:] = pending.partition(terminator)
                return bytes(line)
            if len(pending) > self.parameters.longest_reply_bytes:
                raise self.mark_lost(
                    f"sent more than {self.parameters.longest_reply_bytes} bytes without a terminator: "
                    f"{_quote(bytes(pending))}; check baud rate and terminator"
                )
            with self._translate_errors("be read"):
                # A timeout of pyserial is a short read, here an empty one.
                read = port.read(max(1, min(port.in_waiting, self.parameters.longest_reply_bytes)))
            if not read and pending and not terminator:  # silence ends it
                unterminated, pending[:] = bytes(pending), b""
                return unterminated
            if not read and self.monotonic_s() >= deadline_s:
                return None
            pending += read

    @contextlib.contextmanager
    def _translate_errors(self, doing: str) -> Iterator[None]:
        """Run a block on the port; raise its errors as ConnectionLostError, with the line out of step.

        A port that is gone is closed; after a write timeout it stays open. ``doing`` completes "could not
        ..." in the message.
        """
        try:
            yield
        except serial.SerialTimeoutException as error:
            raise self.mark_lost(f"does not take commands (could not {doing}); check flow control") from error
        except PORT_ERRORS as error:
            self.close()
            raise self.mark_lost(f"is gone (could not {doing}: {error}); check its plug and power") from error

    def mark_lost(self, message: str) -> ConnectionLostError:
        """Mark the line as out of step; return, not raise, a ConnectionLostError with name and message."""
        self.in_step = False
        return ConnectionLostError(f"{self._format_name()} {message}")

    def _format_name(self) -> str:
        """Return name (``the instrument`` if unknown) and port of the instrument, for messages."""
        return f"{self.name.rstrip() or 'the instrument'} at {self.parameters.port}"


def _decode_response(raw: bytes | bytearray) -> str | None:
    """Decode a response without surrounding white space, carriage returns included.

    Return None if it is empty or has a byte that is no printable ASCII.
    """
    stripped = raw.strip(b" \t\r\n")
    if not stripped or not all(0x20 <= byte < 0x7F for byte in stripped):
        return None
    return stripped.decode("ascii")


def _is_instrument_name(reply: str) -> bool:
    """Return whether a response may be another instrument's name: it contains a letter.

    False for a number, ON, OFF or an entry of an error queue: late responses of the right instrument.
    """
    if _ERROR_QUEUE_ENTRY.match(reply) or reply.upper() in {"ON", "OFF"}:
        return False
    try:
        float(reply)
    except ValueError:
        return any(character.isalpha() for character in reply)
    return False


def _quote(raw: bytes) -> str:
    """Return the first `SHOWN_BYTES` of a response as a Python literal, with ``...`` if it is longer."""
    return repr(raw[:SHOWN_BYTES]) + ("..." if len(raw) > SHOWN_BYTES else "")
