"""Instrument's end of a line: a pseudo terminal behind a path that survives replugging, or a socket.

A thread owns the terminal, hands each line that comes in to the instrument and writes its answer. The
line can be unplugged and plugged in again (a new terminal behind the same path, as an adapter behind
``/dev/serial/by-id``), and its answers can be lost, delayed, held back or garbled. Only systems with
pseudo terminals have it: not Windows.
"""

from __future__ import annotations

import contextlib
import os
import re
import select
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from simulator.errors import SimulatorError

T = TypeVar("T")

GARBAGE = b"\xff\x81\x00\x7f~\xc3\n"
"""What a wrong baud rate makes of an answer."""
ORDER_TIMEOUT_S = 10.0
"""The owning thread never blocks, so an order that takes this long is a fault of the double."""


def find_missing_terminal_reason() -> str:
    """Return why this system has no pseudo terminals; empty if it has them."""
    if not hasattr(os, "openpty"):
        return "this system has no pseudo terminals (Windows): use a real port, or run on Linux or macOS"
    return ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Framing:
    """Framing: the end of a command, and the end of a response.

    Attributes
    ----------
    commands
        Matches a whole command where none has an end of its own; None: a line feed ends it.
    reply_end
        Behind each answer.
    """

    commands: re.Pattern[bytes] | None = None
    reply_end: bytes = b"\n"

    def split(self, received: bytes) -> tuple[list[bytes], bytes]:
        """Split received bytes into the complete commands, in order, and the start of the next one.

        With a pattern (`commands`), bytes between two matches are dropped.
        """
        if self.commands is None:
            *lines, rest = received.split(b"\n")
            return lines, rest
        found = list(self.commands.finditer(received))
        return [match[0] for match in found], received[found[-1].end() :] if found else received


@dataclass(frozen=True, slots=True, kw_only=True)
class LineFaults:
    """Faults of responses; the instrument still receives and executes every command.

    Attributes
    ----------
    silent
        Every answer is lost.
    echo
        Every command comes back before its answer, as from a terminal; no fault, but not every driver
        takes it.
    slow_s
        Every answer comes so much later.
    hold
        So many answers are held back until the next command comes: late, and just before its own answer.
    garbage, garbage_bytes
        So many answers are replaced by these bytes.
    """

    silent: bool = False
    echo: bool = False
    slow_s: float = 0.0
    hold: int = 0
    garbage: int = 0
    garbage_bytes: bytes = GARBAGE


class SerialLink:
    """Instrument on one pseudo terminal; a context manager.

    Parameters
    ----------
    path
        Where the port is to be found: a symbolic link that the link makes and removes.
    answer
        The instrument: gets a command without its terminator, returns the answer or None. It is an
        attribute too, so that a test can come between.
    withheld
        Attribute, called whenever a question gets no whole answer: a test that gave its driver a clock of
        its own moves that on, instead of waiting for the driver's deadline.
    """

    _listener: socket.socket | None = None

    def __init__(
        self, path: Path, answer: Callable[[str], str | None], framing: Framing | None = None
    ) -> None:
        missing = find_missing_terminal_reason()
        if missing:
            raise SimulatorError(missing)
        self.path = path
        self.answer = answer
        self._framing = framing or Framing()
        self.withheld: Callable[[], None] = lambda: None
        self._faults = LineFaults()
        self._terminal: tuple[int, ...] | None = None
        self._received = b""
        self._held: list[bytes] = []
        self._due: deque[tuple[float, bytes]] = deque()
        self._heard: list[tuple[int, str]] = []
        self._orders: deque[Callable[[], None]] = deque()
        self._wake_read, self._wake_write = os.pipe()
        self._ended = False
        self._thread = threading.Thread(target=self._serve, name=f"serial double {path.name}", daemon=True)
        self._thread.start()
        self.plug()

    def __enter__(self) -> SerialLink:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def port(self) -> str:
        """Return the path of the port as text, for the configuration of a line."""
        return str(self.path)

    # Orders, carried out by the owning thread ------------------------------------------------------

    def plug(self) -> None:
        """Open a terminal behind the link's path, and wait for it; do nothing if it is plugged in."""
        self.do(self._plug)

    def unplug(self) -> None:
        """Remove terminal and path of the link; do nothing if it is unplugged."""
        self.do(self._unplug)

    def inject(self, **faults: Any) -> None:
        """Set some of the `LineFaults` by name; the others stay. Raise TypeError for an unknown one."""
        changed = replace(self._faults, **faults)
        self.do(lambda: self._set_faults(changed))

    def clear_faults(self) -> None:
        """Remove all faults of the line; responses that are delayed or held back are lost."""
        self.do(lambda: self._set_faults(LineFaults()))

    def send_unrequested(self, text: bytes) -> None:
        """Send bytes to the client that it did not request; do nothing while none is connected."""
        self.do(lambda: self._transmit(text))

    def heard(self) -> list[tuple[int, str]]:
        """Return every command received, in order, with its monotonic time in ns."""
        return self.do(lambda: list(self._heard))

    def close(self) -> None:
        """Unplug the link and end its thread, within `ORDER_TIMEOUT_S`; do nothing if it is closed."""
        if not self._thread.is_alive():
            return
        self.unplug()
        self.do(self._end_thread)
        self._thread.join(ORDER_TIMEOUT_S)
        os.close(self._wake_read)
        os.close(self._wake_write)

    def do(self, work: Callable[[], T]) -> T:
        """Run a function on the link's thread and wait; return its result or raise its error.

        On that thread itself it is called at once.

        Raises
        ------
        TimeoutError
            It takes longer than `ORDER_TIMEOUT_S`.
        """
        if threading.current_thread() is self._thread:  # the instrument itself pulls the plug
            return work()
        future: Future[T] = Future()

        def carry_out() -> None:
            """Run the function and store its result or error in the future."""
            try:
                future.set_result(work())
            except BaseException as error:  # noqa: BLE001 - handed to the caller, who raises it
                future.set_exception(error)

        self._orders.append(carry_out)
        os.write(self._wake_write, b"x")
        return future.result(ORDER_TIMEOUT_S)

    # The owning thread -----------------------------------------------------------------------------

    def _serve(self) -> None:
        """Serve the client, send due responses and run functions of other threads until the link is closed.

        A connecting client replaces the present one.
        """
        while not self._ended:
            watched = [self._wake_read, *(self._terminal or ())[:1]]
            watched += [] if self._listener is None else [self._listener.fileno()]
            wait_s = max(0.0, self._due[0][0] - time.monotonic()) if self._due else None
            ready, _, _ = select.select(watched, [], [], wait_s)
            if self._terminal and self._terminal[0] in ready:
                self._receive_commands()
            if self._listener is not None and self._listener.fileno() in ready:
                self._hang_up()
                self._terminal = (self._listener.accept()[0].detach(),)
            while self._due and self._due[0][0] <= time.monotonic():
                self._transmit(self._due.popleft()[1])
            if self._wake_read in ready:
                os.read(self._wake_read, 1)
                self._orders.popleft()()

    def _receive_commands(self) -> None:
        """Read received bytes, record and answer each complete command; responses held back are sent before.

        Hang up if the client has closed the socket.
        """
        assert self._terminal is not None, "only readable while plugged in"
        try:
            data = os.read(self._terminal[0], 4096)
        except ConnectionError:
            data = b""
        if not data:  # only a socket has another end that can go
            self._hang_up()
            return
        commands, self._received = self._framing.split(self._received + data)
        for line in commands:
            command = line.decode("ascii", errors="replace").strip()
            self._heard.append((time.monotonic_ns(), command))
            for late in self._held:
                self._transmit(late)
            self._held.clear()
            if self._faults.echo:
                self._transmit(command.encode("ascii") + b"\n")
            answer = self.answer(command)
            if answer is not None:
                self._reply(answer.encode("latin-1") + self._framing.reply_end)
            elif command.endswith("?"):
                self.withheld()

    def _reply(self, answer: bytes) -> None:
        """Send an answer, or drop, replace, hold back or delay it by injected faults.

        `withheld` is called if the client gets no complete answer now, except for a delay.
        """
        faults = self._faults
        if faults.silent:
            self.withheld()
            return
        if faults.garbage:
            self._faults = replace(faults, garbage=faults.garbage - 1)
            answer = faults.garbage_bytes
        if faults.hold:
            self._faults = replace(self._faults, hold=faults.hold - 1)
            self._held.append(answer)
            self.withheld()
        elif faults.slow_s > 0.0:
            self._due.append((time.monotonic() + faults.slow_s, answer))
        else:
            self._transmit(answer)
            if not answer.endswith(self._framing.reply_end):
                self.withheld()

    def _transmit(self, text: bytes) -> None:
        """Send bytes to the client at once; do nothing if none is connected, hang up if it has closed."""
        if self._terminal is not None:
            try:
                os.write(self._terminal[0], text)
            except ConnectionError:
                self._hang_up()

    def _set_faults(self, faults: LineFaults) -> None:
        """Replace the faults of the line; if there are none, drop the responses delayed or held back."""
        self._faults = faults
        if faults == LineFaults():
            self._held.clear()
            self._due.clear()

    def _plug(self) -> None:
        """Open a pseudo terminal and let the link's path point to it; do nothing if one is open."""
        if self._terminal is not None:
            return
        import tty  # not on Windows

        # Both ends stay open here: without its other end a terminal reports an error, not silence.
        self._terminal = os.openpty()
        tty.setraw(self._terminal[1])
        fresh = self.path.with_name(f".{self.path.name}.fresh")
        fresh.symlink_to(os.ttyname(self._terminal[1]))
        fresh.replace(self.path)

    def _unplug(self) -> None:
        """Remove the path and close the terminal; do nothing if none is open."""
        if self._terminal is None:
            return
        self.path.unlink(missing_ok=True)
        self._hang_up()

    def _hang_up(self) -> None:
        """Close the connection to the client; drop its pending responses and incomplete command."""
        for end in self._terminal or ():
            with contextlib.suppress(OSError):
                os.close(end)
        self._terminal, self._received = None, b""
        self._held.clear()
        self._due.clear()

    def _end_thread(self) -> None:
        """Let the link's thread end; called on that thread."""
        self._ended = True


class SocketLink(SerialLink):
    """Instrument on a socket of the loopback interface, whose address survives unplugging.

    It serves one caller, the last one. Being unplugged is reported to the caller, as when an instrument is
    switched off; a cable that is pulled without a word is `LineFaults.silent`.
    """

    _number = 0

    @property
    def port(self) -> str:
        """Return the port ``tcp:<host>:<number>``, as the configuration of a line takes it."""
        return f"tcp:127.0.0.1:{self._number}"

    @property
    def visa_port(self) -> str:
        """Return the port as a VISA resource, ``visa:TCPIP0::<host>::<number>::SOCKET``."""
        return f"visa:TCPIP0::127.0.0.1::{self._number}::SOCKET"

    def _plug(self) -> None:
        """Listen for TCP connections on loopback, on the same port as before; do nothing if it listens."""
        if self._listener is None:
            self._listener = socket.create_server(("127.0.0.1", self._number))
            self._number = self._listener.getsockname()[1]

    def _unplug(self) -> None:
        """Stop listening and close the connection to the client, if any."""
        if self._listener is not None:
            self._listener.close()
            self._listener = None
        self._hang_up()
