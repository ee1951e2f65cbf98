"""Parameters of the instruments with a text protocol: each with its unit, its bounds and its meaning."""

from __future__ import annotations

import re
from typing import Annotated, ClassVar, Literal

from annotated_types import Ge, Gt, Le

from hardware_drivers.bounds import bounded, check_field_relation
from hardware_drivers.drive_parameters import CLIMATE_KEYS, WATCH_KEYS, DriveParameters, LogParameters
from hardware_drivers.serial_port.dialects import build_channel_dialect

POLL_S = 0.05
"""Granularity of a reply's deadline; a reply that has come is read at once."""
TCP_PREFIX, VISA_PREFIX = "tcp:", "visa:"
_TCP_ADDRESS = re.compile(r"([^:\s]+|\[[0-9a-fA-F:.]+\]):(\d{1,5})")
USB_SERIAL_PREFIX = "serial:"
CLIMATE_REACHED_BY = CLIMATE_KEYS | {"line"}
"""Not what is measured: a replugged cable is no other test."""
SUPPLY_REACHED_BY = WATCH_KEYS | {
    "line",
    "setup_commands",
    "channel",
    "protection_queries",
    "over_voltage_v",
    "over_current_a",
    "readback_tolerance_v",
    "readback_tolerance_a",
}
"""Nor how the drive is watched."""
ORDER_REPLIES = 12
"""An order (switch off, set, read back, switch on, measure) may take as long as this many replies."""


@bounded
class SerialLineParameters:
    """Text line: its address and its protocol."""

    port: str
    """A path (`/dev/serial/by-id/...`, which survives replugging), a name (`COM4`), or `serial:` and the
    serial number of the USB adapter (`serial:FT4XYZ01`), which is found again under any name. Or no serial
    port: `tcp:HOST:PORT`, the instrument's own socket, or `visa:` and a VISA resource (USB-TMC, GPIB, LAN;
    extra `visa`)."""
    baud_rate: Annotated[int, Ge(50), Le(4_000_000)] = 9600
    """Bits a second, as set at the instrument; this and the next four keys count for serial ports only."""
    data_bits: Literal[7, 8] = 8
    """Data bits of a character."""
    parity: Literal["none", "even", "odd"] = "none"
    """Parity bit of a character."""
    stop_bits: Literal[1, 2] = 1
    """Stop bits of a character."""
    flow_control: Literal["none", "rts_cts", "dsr_dtr", "xon_xoff"] = "none"
    """Handshake, as set at the instrument."""
    terminator: Literal["\n", "\r\n", "\r", ""] = "\n"
    """Ends every command and every reply; empty (Korad): 50 ms of silence do."""
    reply_timeout_s: Annotated[float, Gt(0.0), Le(60.0)] = 1.0
    """Longest wait for one reply; one that comes later is thrown away."""
    longest_reply_bytes: Annotated[int, Ge(16), Le(65_536)] = 256
    """A reply without a terminator is refused after this many bytes."""
    reconnect_first_s: Annotated[float, Gt(0.0), Le(3600.0)] = 1.0
    """After a failed attempt to reach the instrument the next comes this much later, then twice as much."""
    reconnect_longest_s: Annotated[float, Gt(0.0), Le(86_400.0)] = 60.0
    """The wait between two attempts grows no further; they never end, since a plug may come back."""

    @property
    def address(self) -> tuple[str, int]:
        """Return host and port number of a ``tcp:HOST:PORT`` line; ValueError for any other form."""
        found = _TCP_ADDRESS.fullmatch(self.port.removeprefix(TCP_PREFIX))
        if found is None or not 0 < int(found[2]) < 65_536:
            raise ValueError(
                f"port is {self.port!r}; give {TCP_PREFIX}HOST:PORT, like {TCP_PREFIX}psu.lab:5025"
            )
        return found[1].strip("[]"), int(found[2])

    def __post_init__(self) -> None:
        """Raise ValueError for a blank or incomplete port, or a ``tcp:`` line without HOST:PORT.

        Also if the longest wait between attempts is shorter than the first.
        """
        name = self.port.removeprefix(USB_SERIAL_PREFIX)
        if not name or name != name.strip() or not name.isprintable():
            raise ValueError(
                f"port is {self.port!r}; give a path, a name like COM4, or {USB_SERIAL_PREFIX}<serial number>"
            )
        if self.port.startswith(TCP_PREFIX):
            _ = self.address  # raises what is none
        elif self.port == VISA_PREFIX:
            raise ValueError(
                f"port is {self.port!r}; give visa: and a resource, like {VISA_PREFIX}GPIB0::5::INSTR"
            )
        check_field_relation(self, "reconnect_longest_s", "at least", "reconnect_first_s", " s")


@bounded
class SupplyParameters(DriveParameters):
    """Corrosion supply: a DC supply between specimen (plus) and copper electrode (minus)."""

    line: SerialLineParameters
    """Its line."""
    identity: str
    """Regular expression that the answer to `*IDN?` must begin with, up to the serial number
    (`KEYSIGHT,E36312A,MY1234`): anything else on the line is refused and sent nothing but `*IDN?`."""
    identity_query: ClassVar[str] = "*IDN?"
    """IEEE 488.2's own, which every supply of these dialects answers."""
    dialect: Literal["scpi", "aim_tti", "korad", "rigol"] = "scpi"
    """Commands it understands: `scpi` (SCPI-1999: VOLT, CURR, OUTP, MEAS:VOLT?, MEAS:CURR?, SYST:ERR?),
    `aim_tti` (PL-P, MX, CPX, QL-P), `korad` (KAxxxxP, with terminator = ""), `rigol` (DP800)."""
    channel: Annotated[int, Ge(1), Le(4)] = 1
    """Output of a supply with several (`aim_tti`, `rigol`); `scpi` chooses it by `setup_commands`."""
    protection_queries: tuple[str, ...] | None = None
    """Ask whether a protection has tripped (answer 0 or 1); absent: what the dialect asks; empty: nothing is
    asked, and the protection counts as unknown. A question that the supply reports as undefined is, too."""
    over_voltage_v: Annotated[float, Gt(0.0), Le(66.0)] | None = None
    """Level of the supply's over-voltage protection: set and read back before the output goes on. Absent:
    what is set at the instrument stays."""
    over_current_a: Annotated[float, Gt(0.0), Le(110.0)] | None = None
    """The same for its over-current protection, which switches off where `current_limit_a` only limits."""
    setup_commands: tuple[str, ...] = ()
    """Sent after each check of the identity, for example `SYST:REM` (many need it on a serial line) or
    `INST:NSEL 1` (channel). Only SYST, INST and DISP commands, which switch nothing."""

    @property
    def longest_order_s(self) -> float:
        """Return the longest time in s of a command, with that of switching off again if it fails.

        It is twice `ORDER_REPLIES` reply timeouts.
        """
        return 2.0 * ORDER_REPLIES * self.line.reply_timeout_s

    def __post_init__(self) -> None:
        """Raise ValueError for an invalid identity, query or setup command, or a value above its cap.

        Also for a channel or protection level that the dialect does not have, and an over-voltage level not
        above the voltage.
        """
        DriveParameters.__post_init__(self)
        check_identity_pattern(self.identity)
        for query in self.protection_queries or ():
            check_query_text("protection_queries", query)
        for command in self.setup_commands:
            check_query_text("setup_commands", command)
            if not command.upper().lstrip(":").startswith(("SYST", "INST", "DISP")):
                raise ValueError(
                    f"setup_commands has {command!r}; only SYST, INST and DISP commands are sent"
                )
        dialect = build_channel_dialect(self.dialect, self.channel)
        for name, level in (
            ("over_voltage_v", dialect.over_voltage),
            ("over_current_a", dialect.over_current),
        ):
            if getattr(self, name) is not None and level is None:
                raise ValueError(
                    f"{name} is {getattr(self, name)}; dialect {self.dialect} cannot set and read back that "
                    "level: set it at the instrument and leave the key out"
                )
        if self.over_voltage_v is not None:
            check_field_relation(self, "over_voltage_v", "above", "voltage_v")


@bounded
class ClimateParameters(LogParameters):
    """Thermometer and hygrometer next to the specimen."""

    line: SerialLineParameters
    """Its line."""
    identity: str
    """Regular expression that the answer to `identity_query` must begin with."""
    identity_query: str = "*IDN?"
    """Asks who it is."""
    temperature_query: str = "MEAS:TEMP?"
    """Asks for the temperature in degrees Celsius."""
    humidity_query: str = "MEAS:HUM?"
    """Asks for the relative humidity."""
    humidity_unit: Literal["percent", "fraction"] = "percent"
    """Unit of the probe's relative humidity."""

    def __post_init__(self) -> None:
        """Raise ValueError for an invalid identity pattern or query."""
        check_identity_pattern(self.identity)
        for name in ("identity_query", "temperature_query", "humidity_query"):
            check_query_text(name, getattr(self, name))


def check_identity_pattern(pattern: str) -> None:
    """Raise ValueError for a pattern that is no regular expression, or that matches any text."""
    try:
        matches_anything = re.match(pattern, "") is not None
    except re.error as error:
        raise ValueError(f"identity is {pattern!r}; it is no regular expression: {error}") from error
    if matches_anything:
        raise ValueError(f"identity is {pattern!r}, which any instrument matches; give its maker and model")


def check_query_text(name: str, query: str) -> None:
    """Raise ValueError, with the key ``name``, for a text that is not one query.

    It must be printable ASCII without a semicolon, and not blank.
    """
    if not (query.isascii() and query.isprintable() and query.strip()) or ";" in query:
        raise ValueError(f"{name} is {query!r}; give one command of printable ASCII characters")
