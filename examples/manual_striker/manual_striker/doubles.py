"""Doubles of the relay board, below the unmodified pyserial's interface, and of a person."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import Any
from unittest.mock import patch

import serial

from hardware_drivers.conformance.bench import Bench, Double

FAULTS = ("unplugged", "silent", "garbage", "held by another")
"""The last one meets who opens it, not who has it."""


class RelayBoardDouble:
    """Board with relays, powered over its cable: when unplugged, every relay opens."""

    def __init__(self, positions: dict[int, str]) -> None:
        self._positions = positions
        self._on: set[int] = set()
        self.switchings: list[tuple[str, bool]] = []
        self.fault = ""

    def answer(self, line: str) -> str:
        """Execute a line and answer it."""
        if line == "ver":
            return "00000008"
        match = re.fullmatch(r"relay (on|off|read) (\d+)", line)
        if match is None:
            return "unknown command"
        verb, number = match[1], int(match[2])
        if verb == "read":
            return "on" if number in self._on else "off"
        self._set(number, verb == "on")
        return ""

    def fail(self, name: str) -> None:
        """Activate one of `FAULTS`; empty: work again."""
        self.fault = name
        if name == "unplugged":
            for number in sorted(self._on):
                self._set(number, False)

    def _set(self, number: int, on: bool) -> None:
        if (number in self._on) != on:
            self._on ^= {number}
            self.switchings.append((self._positions.get(number, str(number)), on))


class PortDouble:
    """Port for pyserial without waiting, so a silent board costs no time."""

    def __init__(self, board: RelayBoardDouble) -> None:
        self._board = board
        self._received = b""

    def reset_input_buffer(self) -> None:
        """Discard unread data."""
        self._require_cable()
        self._received = b""

    def write(self, line: bytes) -> int:
        """Receive a line; it is echoed before its answer."""
        self._require_cable()
        text = line.decode("ascii").rstrip("\r")
        response = self._board.answer(text)
        answers = {"silent": b"", "garbage": b"\xff\x81\x00\x7f\n\r>"}
        self._received += answers.get(self._board.fault, f"{text}\n\r{response}\n\r>".encode("ascii"))
        return len(line)

    def read_until(self, end: bytes) -> bytes:
        """Return the data up to the end, or all of it at the timeout."""
        self._require_cable()
        given, found, self._received = self._received.partition(end)
        return given + found

    def close(self) -> None:
        """Close the port; nothing is switched."""

    def _require_cable(self) -> None:
        if self._board.fault == "unplugged":
            raise serial.SerialException("device disconnected")


@contextmanager
def relays() -> Iterator[Bench]:
    """Make pyserial open a double."""
    board = RelayBoardDouble({0: "B", 1: "C"})

    def open_port(port: str, **_: Any) -> PortDouble:
        if board.fault == "unplugged":
            raise serial.SerialException(2, f"could not open port {port}")
        if board.fault == "held by another":
            raise serial.SerialException(11, f"could not exclusively lock port {port}")
        return PortDouble(board)

    @contextmanager
    def fault(name: str) -> Iterator[None]:
        board.fail(name)
        try:
            yield
        finally:
            board.fail("")

    with patch("serial.serial_for_url", open_port):
        yield Bench(parameters={"pulse_s": 1e-3}, coil_levels=lambda: list(board.switchings), fault=fault)


RELAYS = Double(bench=relays, faults=FAULTS[:3])
HAND = Double(bench=lambda: nullcontext(Bench()))
"""A person has no coil and does not fail."""
