"""Commands and queries of power supplies, one table of ``dialects.toml`` per dialect.

Units, headers and echoes in a response are handled by the line, so a table holds only the differences. No
table has been proven on a real instrument: each is written from the manual that it names, and tested against
a double that was written from the same manual.
"""

from __future__ import annotations

import tomllib
from functools import lru_cache
from pathlib import Path

from pydantic import TypeAdapter

from hardware_drivers.bounds import bounded

_TABLES = Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")

NAME_BY_COMMAS = r"(?P<maker>[^,]*)(,(?P<model>[^,]*)(,(?P<serial_number>[^,]*)(,(?P<firmware>.*))?)?)?"
"""IEEE 488.2's answer to `*IDN?`."""


@bounded
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


@bounded
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


@bounded
class Level:
    """Setting that is set and read back; a switch that enables it is read back too."""

    command: str
    digits: str
    read: Number
    enable: str = ""
    enabled: Flag | None = None


@bounded
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
    protections: tuple[Flag, ...] = ()
    trips_are_events: bool = False
    over_voltage: Level | None = None
    over_current: Level | None = None
    name: str = NAME_BY_COMMAS


@lru_cache
def build_channel_dialect(name: str, channel: int) -> Dialect:
    """Build the commands of a dialect of ``dialects.toml`` for one channel of the supply; cached.

    Raises
    ------
    ValueError
        The dialect `scpi` has no channel in its commands, and the channel is not 1.
    KeyError
        No dialect has this name.
    """
    if name == "scpi" and channel != 1:
        raise ValueError(
            f"channel is {channel}; SCPI has no channel in its commands: leave it 1 and give "
            f"INST:NSEL {channel} as one of setup_commands"
        )
    table = tomllib.loads(_TABLES.replace("{n}", str(channel)))[name]
    return TypeAdapter(Dialect).validate_python(table)
