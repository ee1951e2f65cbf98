"""Parameters of the NI-DAQmx driver: boards, wiring, record, strike. Imports nothing of the vendor's.

A file embeds `DaqmxParameters` as ``[rig.daqmx]`` and each transducer's wiring as
``[rig.daqmx.transducers.B]``, by the position it belongs to.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le

from hardware_drivers.bounds import bounded, check_field_relation

LONGEST_PULSE_S = 0.5
"""Cap of the coil's on-time: many times what lifts a striker by millimetres, far from heating a coil."""

GRAVITY_M_PER_S2 = 9.81

REACHED_BY = frozenset({"grpc_address", "grpc_client_name", "grpc_tls", "call_timeout_s", "ringing_s"})
"""Not what is measured: where the boards are, how long they are waited for, what was found of a spike."""

_SERIAL = re.compile(r"[0-9A-Fa-f]{1,8}\Z")
_INPUT = re.compile(r"ai\d{1,3}\Z")
_COUNTER = re.compile(r"ctr\d\Z")
_TERMINAL = re.compile(r"(PFI\d{1,2}|Ctr\dOut)\Z")
_LINE = re.compile(r"port\d/line\d{1,2}\Z")
_ADDRESS = re.compile(r"[^\s:/]+:\d{1,5}\Z|\[[0-9A-Fa-f:]+\]:\d{1,5}\Z")
_CLIENT = re.compile(r"[A-Za-z0-9_.-]{0,40}\Z")


def fall_s(height_m: float) -> float:
    """Return the time in s of a free fall from ``height_m``, sqrt(2 h / g)."""
    return math.sqrt(2.0 * height_m / GRAVITY_M_PER_S2)


@bounded
class TransducerWiring:
    """Wiring of one transducer: its PZT disk at an input, its coil at a counter's output."""

    board_serial: str
    """Serial number of the digitizer board as printed on its label (hexadecimal, like `01A2B3C4`)."""
    input: str = "ai0"
    """Analog input of that board; empty: another instrument digitizes this position (a mixed rig)."""
    range_v: Annotated[float, Gt(0.0), Le(100.0)] = 5.0
    """Input range -range_v .. +range_v, half of which the incident wave should fill (`solimon doctor
    --strike`); one the board does not have is refused, not rounded."""
    terminal_configuration: Literal["default", "rse", "nrse", "differential", "pseudo_differential"] = (
        "default"
    )
    """How the input is referenced; `default` is the board's own (pseudo-differential on fast boards)."""
    coupling: Literal["default", "dc", "ac"] = "default"
    """Coupling of the input; `default` leaves it to the board (DC; many boards have no other)."""
    striker_serial: str = ""
    """Serial number of the board whose counter drives the coil; empty: the digitizer board itself."""
    counter: str = "ctr0"
    """Counter that times the coil's pulse; every coil has one of its own. Empty: another instrument strikes
    this position (a mixed rig)."""
    output_terminal: str = "PFI12"
    """Terminal the pulse leaves the board at (home of `ctr0`: X, M Series PFI12, S Series Ctr0Out)."""

    def __post_init__(self) -> None:
        """Raise ValueError for a serial number, input, counter or terminal of the wrong form.

        Also for a ``striker_serial`` unless input and counter are both given, or if neither is given.
        """
        _require_match("board_serial", self.board_serial, _SERIAL, "1 to 8 hexadecimal digits, like 01A2B3C4")
        if self.striker_serial:
            _require_match(
                "striker_serial", self.striker_serial, _SERIAL, "1 to 8 hexadecimal digits, or empty"
            )
        if self.input or not self.counter:
            _require_match("input", self.input, _INPUT, "an analog input, like ai0")
        if self.counter:
            _require_match("counter", self.counter, _COUNTER, "a counter, like ctr0")
        if self.striker_serial and not (self.input and self.counter):
            raise ValueError(
                f"striker_serial is {self.striker_serial}, but {'counter' if self.input else 'input'} is "
                "empty, so one board does it all: name it as board_serial and leave striker_serial out"
            )
        _require_match("output_terminal", self.output_terminal, _TERMINAL, "a terminal, like PFI12")

    @property
    def digitizes(self) -> bool:
        """Return whether a board of this table samples the transducer: ``input`` is not empty."""
        return bool(self.input)

    @property
    def strikes(self) -> bool:
        """Return whether a counter of this table pulses its coil: ``counter`` is not empty."""
        return bool(self.counter)

    @property
    def coil_serial(self) -> str:
        """Return the serial number of the board that drives the coil: the striker's, else the digitizer's."""
        return self.striker_serial or self.board_serial


@bounded
class WatchdogWiring:
    """Watchdog of X Series: the board pulls the coil's lines low if this program stops resetting it."""

    board_serial: str
    """Serial number of the X Series board whose counters drive the coils."""
    lines: tuple[str, ...]
    """Coils' terminals by their digital names (X Series: PFI12 is `port2/line4`); they expire to low."""
    timeout_s: Annotated[float, Ge(0.01), Le(30.0)] = 2.0
    """Time without a sign of life after which the lines go low (the board's limit is about 34 s)."""

    def __post_init__(self) -> None:
        """Raise ValueError for a serial number or a line of the wrong form, or without any line."""
        _require_match("board_serial", self.board_serial, _SERIAL, "1 to 8 hexadecimal digits, like 01A2B3C4")
        if not self.lines:
            raise ValueError("lines is empty; name the digital lines of the coils, like port2/line4")
        for line in self.lines:
            _require_match("lines", line, _LINE, "digital lines, like port2/line4")


@bounded
class GrpcTls:
    """Encryption of the connection to NI's gRPC device server, as its own configuration requires it.

    A server with `server_cert` and `server_key` needs the root certificate here, one with `root_cert` also
    knows its clients by theirs (mutual TLS). Files in PEM form.
    """

    root_certificate: Path
    """Certificate that signed the server's; a self-signed server's own."""
    certificate: Path | None = None
    """This client's own, for a server with `root_cert`."""
    private_key: Path | None = None
    """The key of that certificate: readable by this user alone."""
    server_name: str = ""
    """Name in the server's certificate, where it is not the host of `grpc_address`; empty: it is."""

    def __post_init__(self) -> None:
        """Raise ValueError if only one of certificate and private key is given."""
        if (self.certificate is None) != (self.private_key is None):
            raise ValueError("certificate and private_key belong together: give both, or neither")


@bounded
class DaqmxParameters:
    """Parameters of digitizers and strikers on NI-DAQmx boards."""

    transducers: Mapping[str, TransducerWiring]
    """Wiring of each solitary-wave transducer, by its position."""
    transport: Literal["library", "grpc"] = "library"
    """`library`: boards in or at this computer; `grpc`: boards of another computer that runs NI's gRPC
    device server."""
    grpc_address: str = ""
    """`host:port` of that server; only with `grpc`."""
    grpc_client_name: str = ""
    """Name of this rig's tasks on the server. A restarted recorder clears its own leftover tasks by it, never
    another client's; empty: the name of this computer."""
    grpc_tls: GrpcTls | None = None
    """Encryption; absent: none, for a private network only."""
    call_timeout_s: Annotated[float, Ge(0.05), Le(120.0)] = 10.0
    """Longest wait for an answer of the gRPC server to a call that does not itself wait; a self-calibration
    may take ten times as long. Without `grpc` nothing can end a hung call but the recorder's supervisor."""
    sample_rate_hz: Annotated[float, Gt(0.0), Le(1e9)] = 10e6
    """Sampling rate (paper: 10 MHz); a board that would use another one is refused."""
    record_samples: Annotated[int, Ge(16), Le(100_000_000)] = 13_600
    """Samples of a record: 0.1 ms before the trigger and 1.26 ms after it, so 1.2 ms after the peak."""
    pretrigger_samples: Annotated[int, Ge(2), Le(100_000_000)] = 1_000
    """Samples before the trigger (100 us at 10 MS/s)."""
    trigger_level_v: Annotated[float, Ge(-100.0), Le(100.0)] = 0.25
    """Voltage at the transducer's own input that triggers: a tenth of the incident wave."""
    trigger_slope: Literal["rising", "falling"] = "rising"
    """Direction in which the level is passed."""
    pulse_s: Annotated[float, Ge(1e-3), Le(LONGEST_PULSE_S)] = 0.1
    """Time the coil is on: it lifts the striker, which falls when it goes off. The board's counter times it,
    so it ends in any case. At most 0.5 s."""
    drop_height_m: Annotated[float, Gt(0.0), Le(1.0)] = 5e-3
    """Height the striker falls from (paper: 5 mm): the wave comes sqrt(2 h / g) after the pulse."""
    fall_margin_s: Annotated[float, Ge(0.0), Le(5.0)] = 0.1
    """Wait beyond that before a strike counts as missed: friction in the guide."""
    holdoff_s: Annotated[float, Gt(0.0), Le(1.0)] | None = None
    """Time from the end of the coil's pulse until the acquisition starts, timed by the boards: what the coil
    couples into the input meanwhile triggers nothing. Longer than `ringing_s`, shorter than the fall less the
    pre-trigger. Absent: the trigger is armed before the pulse."""
    ringing_s: Annotated[float, Ge(0.0), Le(1.0)] = 0.0
    """Time after the pulse in which the coil's spike still rings, as `solimon doctor --strike` finds it; only
    compared with `holdoff_s`."""
    self_calibration_interval_h: Annotated[float, Ge(0.0), Le(8760.0)] = 24.0
    """Hours between two self-calibrations, done between sets; 0: never."""
    dry_run: bool = False
    """Rehearsal: everything is set up, but no coil's counter is ever started; records are taken without a
    trigger, so they show the noise at the input."""
    reference_clock: Literal["onboard", "PXI_Clk10", "PXIe_Clk100"] = "onboard"
    """Clock the boards' time bases are locked to. `onboard`: each runs on its own, which is enough, since a
    record's time zero is its own trigger; a chassis clock gives all positions one scale of time."""
    watchdog: WatchdogWiring | None = None
    """X Series watchdog: the board itself pulls the coils' lines low if this program hangs. Switch it on when
    `pytest -m hardware` has shown that yours cuts a running pulse; absent: none."""
    watchdogs: tuple[WatchdogWiring, ...] | None = None
    """Instead of `watchdog`, where several boards drive coils: one `[[rig.daqmx.watchdogs]]` for each."""

    def __post_init__(self) -> None:
        """Copy the transducers; raise ValueError for fields that do not fit each other."""
        object.__setattr__(self, "transducers", dict(self.transducers))
        self._check_record()
        self.check_holdoff(self.holdoff_s)
        self._check_holdoff_counter()
        self._check_transport()
        self._check_wiring()
        self._check_watchdogs()

    def _check_record(self) -> None:
        """Raise ValueError for a pre-trigger not shorter than the record, or without a transducer.

        Also if the trigger level is not inside the range of a digitized position.
        """
        check_field_relation(self, "pretrigger_samples", "less than", "record_samples")
        if not self.transducers:
            raise ValueError("transducers is empty; wire at least one position")
        for position, wiring in self.transducers.items():
            if wiring.digitizes and abs(self.trigger_level_v) >= wiring.range_v:
                raise ValueError(
                    f"trigger_level_v is {self.trigger_level_v} V; it must lie inside the range of position "
                    f"{position!r} (+-{wiring.range_v} V)"
                )

    def check_holdoff(self, holdoff_s: float | None) -> None:
        """Raise ValueError for a holdoff (s), as requested or as timed by a board, that cannot work.

        It must be longer than ``ringing_s`` and shorter than the fall less the pre-trigger; None is valid
        only without ringing.
        """
        latest_s = self.fall_s - self.pretrigger_samples / self.sample_rate_hz
        if self.ringing_s >= latest_s:
            raise ValueError(
                f"ringing_s is {self.ringing_s:g} s, the fall less the pre-trigger {latest_s:.4g} s: no "
                "holdoff fits between; put a flyback diode across the coil, screen the PZT's cable, lead the "
                "two apart"
            )
        if holdoff_s is None and self.ringing_s > 0.0:
            raise ValueError(
                f"ringing_s is {self.ringing_s:g} s without a holdoff_s; set one between it and "
                f"{latest_s:.4g} s (the fall less the pre-trigger)"
            )
        if holdoff_s is not None and not self.ringing_s < holdoff_s < latest_s:
            raise ValueError(
                f"holdoff_s is {holdoff_s:g} s; it must be longer than ringing_s = {self.ringing_s:g} s and "
                f"shorter than {latest_s:.4g} s, the fall from {self.drop_height_m:g} m less the pre-trigger"
            )

    def _check_holdoff_counter(self) -> None:
        """Raise ValueError if a holdoff is set and a digitized position has no counter to start it.

        Also if no position is digitized here.
        """
        if self.holdoff_s is None:
            return
        alone = [name for name, wiring in self.transducers.items() if wiring.digitizes and not wiring.strikes]
        if alone or not any(wiring.digitizes for wiring in self.transducers.values()):
            at = alone[0] if alone else next(iter(self.transducers))
            raise ValueError(
                f"holdoff_s is {self.holdoff_s:g} s, but transducers.{at} has no "
                f"{'counter' if alone else 'input'}: the counter that pulses the coil starts a holdoff "
                "in hardware, so boards of this table must do both; wire both, or leave holdoff_s out"
            )

    def _check_transport(self) -> None:
        """Raise ValueError for an address, client name or encryption that does not fit the transport.

        ``grpc`` needs an address HOST:PORT; ``library`` allows neither address nor encryption.
        """
        if self.transport == "grpc":
            _require_match("grpc_address", self.grpc_address, _ADDRESS, "host:port, like chassis.lab:31763")
        elif self.grpc_address:
            raise ValueError(
                f"grpc_address is {self.grpc_address!r} but transport is 'library'; set transport = 'grpc'"
            )
        if self.grpc_tls is not None and self.transport != "grpc":
            raise ValueError("grpc_tls is given but transport is 'library'; set transport = 'grpc'")
        _require_match(
            "grpc_client_name", self.grpc_client_name, _CLIENT, "up to 40 letters, digits, . _ or -"
        )

    def _check_wiring(self) -> None:
        """Raise ValueError if two transducers share an input, a counter or an output terminal of one board.

        Two coils cannot use one counter in turn: its route to the earlier terminal may stay connected, and
        both coils would then pulse.
        """
        taken: dict[tuple[int, str], str] = {}
        for position, wiring in self.transducers.items():
            board, coil_board = int(wiring.board_serial, 16), int(wiring.coil_serial, 16)
            ends = [(board, wiring.input)] if wiring.digitizes else []
            if wiring.strikes:
                ends += [(coil_board, wiring.counter), (coil_board, wiring.output_terminal)]
            for end in ends:
                other = taken.setdefault(end, position)
                if other != position:
                    raise ValueError(
                        f"transducers {other!r} and {position!r} share {end[1]} of board {end[0]:08X}; each "
                        "needs its own input, counter and output terminal"
                    )

    def find_watchdog(self, serial: str) -> WatchdogWiring | None:
        """Find the watchdog of a board by its hexadecimal serial number, any case; None without one."""
        of_board = (one for one in self.all_watchdogs if int(one.board_serial, 16) == int(serial, 16))
        return next(of_board, None)

    @property
    def all_watchdogs(self) -> tuple[WatchdogWiring, ...]:
        """Return the watchdogs of all boards, from ``watchdog`` or ``watchdogs``; empty without any."""
        return (self.watchdog,) if self.watchdog is not None else self.watchdogs or ()

    def _check_watchdogs(self) -> None:
        """Raise ValueError for two watchdogs of one board, or both ``watchdog`` and ``watchdogs``.

        Also for a watchdog that `_check_watchdog` rejects.
        """
        if self.watchdog is not None and self.watchdogs:
            raise ValueError(
                "watchdog and watchdogs are both given; write that of each board as [[rig.daqmx.watchdogs]]"
            )
        serials = [int(one.board_serial, 16) for one in self.all_watchdogs]
        if twice := [serial for serial in serials if serials.count(serial) > 1]:
            raise ValueError(
                f"watchdogs has board {twice[0]:08X} twice; a board has one watchdog: put its lines together"
            )
        for watchdog in self.all_watchdogs:
            self._check_watchdog(watchdog)

    def _check_watchdog(self, watchdog: WatchdogWiring) -> None:
        """Raise ValueError if a watchdog's timeout is within a strike's time, or its board drives no coil."""
        if watchdog.timeout_s <= self.longest_strike_s:
            raise ValueError(
                f"watchdog.timeout_s is {watchdog.timeout_s} s; it must be longer than a strike "
                f"({self.longest_strike_s:.4g} s), or every pulse is cut short"
            )
        coil_serials = {int(wiring.coil_serial, 16) for wiring in self.transducers.values() if wiring.strikes}
        if int(watchdog.board_serial, 16) not in coil_serials:
            raise ValueError(
                f"watchdog.board_serial is {watchdog.board_serial}; no coil is driven by that board; name "
                "the board whose counters drive the coils"
            )

    @property
    def fall_s(self) -> float:
        """Return the time in s of the striker's free fall from ``drop_height_m``."""
        return fall_s(self.drop_height_m)

    @property
    def longest_call_s(self) -> float:
        """Return the longest time in s that one call may take over gRPC, clean-up included.

        Self-calibration is slowest: ten times `call_timeout_s`; the nine calls that stop and clear what is
        left take one each.
        """
        return 20.0 * self.call_timeout_s + self.longest_strike_s

    @property
    def initial_delay_s(self) -> float:
        """Return the delay in s from the counter's start to the coil's pulse: twice the pre-trigger."""
        return 2.0 * self.pretrigger_samples / self.sample_rate_hz

    @property
    def whole_strike_samples(self) -> int:
        """Return the number of samples from the coil's switching on to the wave's end, friction included."""
        return math.ceil((self.longest_strike_s - self.initial_delay_s) * self.sample_rate_hz)

    @property
    def longest_strike_s(self) -> float:
        """Return the time in s from the counter's start to the last sample, margin for friction included."""
        record_s = self.record_samples / self.sample_rate_hz
        return self.initial_delay_s + self.pulse_s + self.fall_s + self.fall_margin_s + record_s


def _require_match(name: str, value: str, pattern: re.Pattern[str], wanted: str) -> None:
    """Raise ValueError, with key, value and the required form, unless the value begins with the pattern.

    The patterns of this module end with the end of the text.
    """
    if not pattern.match(value):
        raise ValueError(f"{name} is {value!r}; it must be {wanted}")
