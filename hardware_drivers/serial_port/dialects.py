"""Commands and queries of power supplies, one table per dialect.

Units, headers and echoes in an answer are the line's concern, so a table holds only what differs. None
has been proven on a real instrument: each is written from the manual that it names, and tested against a
double that was written from the same one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

NAME_BY_COMMAS = r"(?P<maker>[^,]*)(,(?P<model>[^,]*)(,(?P<serial_number>[^,]*)(,(?P<firmware>.*))?)?)?"
"""IEEE 488.2's answer to `*IDN?`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Number:
    """Query whose response is a number.

    Attributes
    ----------
    unit
        Unit that may follow, also with the prefix m, k or u; no other is taken.
    header
        Word that may stand before the number, where it is not the question's own.
    stray
        What a firmware is known to append without meaning it.
    """

    ask: str
    unit: str
    header: str = ""
    stray: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Flag:
    """Query whose response is yes or no.

    Attributes
    ----------
    mask
        Bits of a register that mean yes; 0: the answer itself is yes or no.
    raw
        The register comes as one byte and not as a decimal number.
    name
        What it is called, where the question alone does not say it.
    """

    ask: str
    mask: int = 0
    raw: bool = False
    name: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Level:
    """Setting that is set and read back; a switch that enables it is read back too."""

    command: str
    digits: str
    read: Number
    enable: str = ""
    enabled: Flag | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Dialect:
    """Commands of a supply.

    Attributes
    ----------
    source
        Manual that the table was written from.
    error_query
        Takes the oldest error away; empty: this supply shows none, and only what is read back counts.
    bare_errors
        An error is its number alone.
    protections
        Each asks whether a protection has tripped; empty: this supply does not say.
    trips_are_events
        Asking takes the trip away, so a reported trip stays true until the next order.
    over_voltage, over_current
        Levels of the protections; None: they cannot be set by command, or not be read back.
    """

    source: str
    voltage: Level
    current: Level
    measured_voltage: Number
    measured_current: Number
    switch_on: str
    switch_off: str
    output: Flag
    error_query: str = "SYST:ERR?"
    bare_errors: bool = False
    protections: tuple[Flag, ...] = field(default=())
    trips_are_events: bool = False
    over_voltage: Level | None = None
    over_current: Level | None = None
    name: str = NAME_BY_COMMAS


def _scpi(channel: int) -> Dialect:
    if channel != 1:
        raise ValueError(
            f"channel is {channel}; SCPI has no channel in its commands: leave it 1 and give "
            f"INST:NSEL {channel} as one of setup_commands"
        )

    def level(mnemonic: str, unit: str) -> Level:
        return Level(command=f"{mnemonic} ", digits=".6g", read=Number(ask=f"{mnemonic}?", unit=unit))

    return Dialect(
        source="SCPI-1999, volume 2, subsystems SOURce, OUTPut, MEASure and SYSTem",
        voltage=level("VOLT", "V"),
        current=level("CURR", "A"),
        measured_voltage=Number(ask="MEAS:VOLT?", unit="V"),
        measured_current=Number(ask="MEAS:CURR?", unit="A"),
        switch_on="OUTP ON",
        switch_off="OUTP OFF",
        output=Flag(ask="OUTP?"),
        protections=(Flag(ask="VOLT:PROT:TRIP?"), Flag(ask="CURR:PROT:TRIP?")),
        over_voltage=level("VOLT:PROT", "V"),
        over_current=level("CURR:PROT", "A"),
    )


def _aim_tti(channel: int) -> Dialect:
    n = channel
    limits = f"LSR{n}?"
    return Dialect(
        source="Aim-TTi: PL-P, MX, CPX400 and QL-P instruction manuals, 'Remote Commands'",
        voltage=Level(command=f"V{n} ", digits=".3f", read=Number(ask=f"V{n}?", unit="V")),
        current=Level(command=f"I{n} ", digits=".4f", read=Number(ask=f"I{n}?", unit="A")),
        measured_voltage=Number(ask=f"V{n}O?", unit="V"),
        measured_current=Number(ask=f"I{n}O?", unit="A"),
        switch_on=f"OP{n} 1",
        switch_off=f"OP{n} 0",
        output=Flag(ask=f"OP{n}?"),
        error_query="EER?",
        bare_errors=True,
        protections=(
            Flag(
                ask=limits,
                mask=0b0000_0100 | 0b0000_1000 | 0b0100_0000,
                name=f"{limits} over-voltage or -current",
            ),
        ),
        trips_are_events=True,
        over_voltage=Level(
            command=f"OVP{n} ", digits=".2f", read=Number(ask=f"OVP{n}?", unit="V", header=f"VP{n}")
        ),
        over_current=Level(
            command=f"OCP{n} ", digits=".2f", read=Number(ask=f"OCP{n}?", unit="A", header=f"CP{n}")
        ),
    )


def _korad(channel: int) -> Dialect:
    n = channel
    return Dialect(
        source="Korad KA3000 Series Remote Control Syntax V2.0; sigrok's notes on the KAxxxxP series",
        voltage=Level(command=f"VSET{n}:", digits=".2f", read=Number(ask=f"VSET{n}?", unit="V")),
        current=Level(
            # KA3005P, firmware 2.0: a sixth character is left over from the name.
            command=f"ISET{n}:",
            digits=".3f",
            read=Number(ask=f"ISET{n}?", unit="A", stray="K"),
        ),
        measured_voltage=Number(ask=f"VOUT{n}?", unit="V"),
        measured_current=Number(ask=f"IOUT{n}?", unit="A"),
        switch_on="OUT1",
        switch_off="OUT0",
        # Its bits for OVP and OCP are not to be relied on (sigrok), so they are not asked for.
        output=Flag(ask="STATUS?", mask=0b0100_0000, raw=True),
        error_query="",
        name=r"(?P<maker>KORAD|VELLEMAN|TENMA|RND|STAMOS|)\s*(?P<model>.+?)\s*(?P<firmware>V\d+\.\d+)?"
        r"(\s*SN:(?P<serial_number>\w+))?",
    )


def _rigol(channel: int) -> Dialect:
    n, ch = channel, f"CH{channel}"

    def protection(mnemonic: str, unit: str) -> Level:
        return Level(
            command=f":OUTP:{mnemonic}:VAL {ch},",
            digits=".3f",
            read=Number(ask=f":OUTP:{mnemonic}:VAL? {ch}", unit=unit),
            enable=f":OUTP:{mnemonic} {ch},ON",
            enabled=Flag(ask=f":OUTP:{mnemonic}? {ch}"),
        )

    return Dialect(
        source="Rigol DP800 Series Programming Guide, December 2015",
        voltage=Level(command=f":SOUR{n}:VOLT ", digits=".3f", read=Number(ask=f":SOUR{n}:VOLT?", unit="V")),
        current=Level(command=f":SOUR{n}:CURR ", digits=".4f", read=Number(ask=f":SOUR{n}:CURR?", unit="A")),
        measured_voltage=Number(ask=f":MEAS:VOLT? {ch}", unit="V"),
        measured_current=Number(ask=f":MEAS:CURR? {ch}", unit="A"),
        switch_on=f":OUTP {ch},ON",
        switch_off=f":OUTP {ch},OFF",
        output=Flag(ask=f":OUTP? {ch}"),
        error_query=":SYST:ERR?",
        protections=(Flag(ask=f":OUTP:OVP:QUES? {ch}"), Flag(ask=f":OUTP:OCP:QUES? {ch}")),
        over_voltage=protection("OVP", "V"),
        over_current=protection("OCP", "A"),
    )


DIALECTS: Mapping[str, Callable[[int], Dialect]] = {
    "scpi": _scpi,
    "aim_tti": _aim_tti,
    "korad": _korad,
    "rigol": _rigol,
}
"""By name: the commands for a channel."""
