"""Kinds of instruments that a laboratory might write itself: a scope, a hammer, a relay, a supply."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from hardware_drivers.errors import AcquisitionTimeoutError, ConfigurationError
from hardware_drivers.instruments import Acquired, require_timeout
from hardware_drivers.kinds import Finding, Kind, Opened, Opening
from hardware_drivers.measurement import ClimateReading, ShotKey, SupplyReading
from support.synthetic_records import Scene


class ScopeParameters(BaseModel):
    """Parameters of a scope that answers each strike with the same wave."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    range_v: float = Field(default=10.0, gt=0.0, le=50.0)
    address: str = "usb"


class LevelledParameters(ScopeParameters):
    """Parameters of a scope with its own trigger."""

    trigger_level_v: float = Field(default=0.05, gt=0.0)


class NoParameters(BaseModel):
    """Empty parameters."""

    model_config = ConfigDict(extra="forbid", frozen=True)


@dataclass
class Script:
    """Script of the instruments, and the log of their calls."""

    events: list[str] = field(default_factory=list)
    openings: list[Opening] = field(default_factory=list)
    fails: Callable[[str], None] = lambda event: None
    comes: bool = True

    def note(self, event: str) -> None:
        self.events.append(event)
        self.fails(event)


SCRIPT = Script()
"""The script of the running test; `scripted` of a fixture sets it back."""


def begin_script() -> Script:
    """Reset the script of the previous test."""
    fresh = Script()
    SCRIPT.events, SCRIPT.openings, SCRIPT.fails, SCRIPT.comes = (
        fresh.events,
        fresh.openings,
        fresh.fails,
        fresh.comes,
    )
    return SCRIPT


class Scope:
    def __init__(self, level_v: float = 0.25) -> None:
        self._level_v = level_v
        self._armed: ShotKey | None = None

    def arm(self, key: ShotKey) -> None:
        SCRIPT.note(f"arm {key.position}")
        if self._armed is not None:
            raise ConfigurationError("already armed")
        self._armed = key

    def read(self, timeout_s: float) -> Acquired:
        require_timeout(timeout_s)
        key, self._armed = self._armed, None
        if key is None:
            raise ConfigurationError("not armed")
        SCRIPT.note(f"read {key.position}")
        if not SCRIPT.comes:
            raise AcquisitionTimeoutError(f"nothing came at {key.position} within {timeout_s:g} s")
        return Acquired(waveform=Scene().waveform(), settings={"trigger_level_v": self._level_v})

    def disarm(self) -> None:
        SCRIPT.note("disarm")
        self._armed = None


class Hammer:
    """Person with a hammer: prompted, never energized."""

    def __init__(self, opening: Opening) -> None:
        self._opening = opening

    def strike(self, key: ShotKey) -> None:
        SCRIPT.note(f"strike {key.position}")
        self._opening.ask(f"strike {key.position} now")

    def make_safe(self) -> None:
        SCRIPT.note("make_safe")


class Relay:
    """Relay at a counter that another program pulses: here NI's package itself."""

    def strike(self, key: ShotKey) -> None:
        import nidaqmx

        SCRIPT.note(f"strike {key.position}")
        with nidaqmx.Task() as task:
            channel = task.co_channels.add_co_pulse_chan_time(
                "PXI1Slot3/ctr0", initial_delay=1e-3, high_time=3e-3, low_time=3e-3
            )
            channel.co_pulse_term = "/PXI1Slot3/PFI12"
            task.start()
            task.wait_until_done(10.0)

    def make_safe(self) -> None:
        SCRIPT.note("make_safe")


class Supply:
    def __init__(self, opening: Opening) -> None:
        self._opening, self.on = opening, False

    def read(self, timeout_s: float) -> SupplyReading:
        return SupplyReading(stamp=self._opening.stamp(), voltage_v=9.5, current_a=0.25, output_on=self.on)

    def energise(self, voltage_v: float, current_limit_a: float) -> None:
        SCRIPT.note(f"energise {voltage_v:g}")
        self.on = True

    def make_safe(self) -> None:
        SCRIPT.note("supply off")
        self.on = False

    def identity(self) -> Mapping[str, str]:
        return {"maker": "nobody"}


class Probe:
    def __init__(self, opening: Opening) -> None:
        self._opening = opening

    def read(self, timeout_s: float) -> ClimateReading:
        return ClimateReading(stamp=self._opening.stamp(), temperature_c=21.5, relative_humidity=0.4)


def _look(parameters: Any, opening: Opening) -> Iterator[Finding]:
    yield Finding(subject="front panel", check="lamp", state="warn", detail="it is dark", remedy="switch on")


def _opener(make: Callable[[Opening], Opened]) -> Callable[[Any, Opening], Any]:
    @contextmanager
    def opened(parameters: Any, opening: Opening) -> Iterator[Opened]:
        SCRIPT.openings.append(opening)
        SCRIPT.note("open")
        yield make(opening)
        SCRIPT.note("close")

    return opened


SCOPE = Kind(
    parameters=ScopeParameters,
    open=_opener(lambda opening: Opened(digitizer=Scope(), identity={"serial_number": "S-77"})),
    check=_look,
    packages=lambda parameters: ("numpy",),
    longest_call_s=lambda parameters: 500.0,
    reached_by=frozenset({"address"}),
)


@contextmanager
def _levelled(parameters: LevelledParameters, opening: Opening) -> Iterator[Opened]:
    yield Opened(digitizer=Scope(parameters.trigger_level_v))


LEVELLED = Kind(parameters=LevelledParameters, open=_levelled, check=_look)
HAMMER = Kind(
    parameters=NoParameters, open=_opener(lambda opening: Opened(striker=Hammer(opening))), check=_look
)
RELAY = Kind(parameters=NoParameters, open=_opener(lambda opening: Opened(striker=Relay())), check=_look)
LIAR = Kind(parameters=NoParameters, open=_opener(lambda opening: Opened()), check=_look)
SUPPLY = Kind(
    parameters=NoParameters, open=_opener(lambda opening: Opened(supply=Supply(opening))), check=_look
)
CLIMATE = Kind(
    parameters=NoParameters, open=_opener(lambda opening: Opened(climate=Probe(opening))), check=_look
)
NOT_A_KIND = "a word"

OFFERED = {
    "scripted-scope": {"digitizer": "support.scripted_kinds:SCOPE"},
    "scripted-levelled": {"digitizer": "support.scripted_kinds:LEVELLED"},
    "scripted-hammer": {"striker": "support.scripted_kinds:HAMMER"},
    "scripted-relay": {"striker": "support.scripted_kinds:RELAY"},
    "scripted-supply": {"supply": "support.scripted_kinds:SUPPLY"},
    "scripted-climate": {"climate": "support.scripted_kinds:CLIMATE"},
    "liar": {"striker": "support.scripted_kinds:LIAR"},
}
