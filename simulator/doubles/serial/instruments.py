"""A power supply with an electrochemical cell as its load, and a climate probe, on lines of text.

The cell draws (all of it an assumption, the paper prints no current)::

    I = (U - U_0) / R(t),   R(t) = R_0 (1 + r t),   I = 0 where U < U_0

with U the voltage at its terminals, U_0 the counter-voltage of the electrodes, R_0 the resistance of the
solution at the start and r its slow rise as the diffusion path through the rust grows. At the supply's
limit I_lim the current is I_lim and U = U_0 + I_lim R(t). Readings carry normal noise, keyed by seed and
reading, never by the order of other calls.

The supply keeps a record of its output: every change with its monotonic time and its cause, so that a
test can show who switched it on. ``python -m simulator.doubles.serial.instruments --json`` runs both in a
process of their own: one JSON line names the ports, orders are taken as JSON lines on standard input
(see `carry_out`), and the end of standard input ends it.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from simulator.doubles.serial.link import Framing, SerialLink, SocketLink
from simulator.errors import SimulatorError

SUPPLY_IDENTITY = "SOLIMON,DC SUPPLY DOUBLE,SD0001,1.0"
CLIMATE_IDENTITY = "SOLIMON,CLIMATE PROBE DOUBLE,CD0001,1.0"
RATED_V, RATED_A = 30.0, 5.0
NO_ERROR = '+0,"No error"'
UNDEFINED = '-113,"Undefined header"'
OUT_OF_RANGE = '-222,"Data out of range"'
CONFLICT = '-221,"Settings conflict"'


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """Steel plate and copper sheet in salt water."""

    counter_voltage_v: float = 1.5
    resistance_ohm: float = 40.0
    rise_per_h: float = 1e-3

    def operating_point(self, set_v: float, limit_a: float, hours_h: float) -> tuple[float, float]:
        """Voltage and current of the supply at this load: it holds its voltage, or its limit."""
        resistance_ohm = self.resistance_ohm * (1.0 + self.rise_per_h * hours_h)
        current_a = max(0.0, (set_v - self.counter_voltage_v) / resistance_ohm)
        if current_a <= limit_a:
            return set_v, current_a
        return self.counter_voltage_v + limit_a * resistance_ohm, limit_a


@dataclass(frozen=True, slots=True, kw_only=True)
class OutputChange:
    """The output was switched."""

    mono_ns: int
    on: bool
    cause: str


class Supply:
    """What a bench supply does with SCPI commands; `dialects` has those that speak otherwise.

    Parameters
    ----------
    seconds
        Time since the start of the test in s, for the cell's drift.
    noise_v, noise_a
        Standard deviation of a voltage and a current reading.
    """

    IDENTITY = SUPPLY_IDENTITY
    FRAMING = Framing()

    def __init__(
        self,
        *,
        cell: Cell | None = None,
        seed: int = 0,
        noise_v: float = 0.0,
        noise_a: float = 0.0,
        seconds: Callable[[], float] = time.monotonic,
    ) -> None:
        self.identity = self.IDENTITY
        self.cell = Cell() if cell is None else cell
        self.obeys_set_commands = True
        self.has_protections = True
        self.output: list[OutputChange] = []
        self._noise = {"V": noise_v, "A": noise_a}
        self._seed = seed
        self._seconds, self._start_s = seconds, seconds()
        self._readings = 0
        self._power_on_state()

    def _power_on_state(self) -> None:
        self._set = {"VOLT": 0.0, "CURR": 0.1}
        self._on = False
        self._tripped = {"VOLT": False, "CURR": False}
        self._protection = {"VOLT": 1.1 * RATED_V, "CURR": 1.1 * RATED_A}
        self._errors: list[str] = []

    @property
    def on(self) -> bool:
        """Whether the output is on."""
        return self._on

    # What happens to it --------------------------------------------------------------------------

    def brown_out(self) -> None:
        """Lose the mains for a moment: it comes back with its output off and nothing set."""
        self._switch(False, "brown-out")
        self._power_on_state()

    def trip(self, protection: str = "CURR") -> None:
        """Trip the over-voltage (VOLT) or over-current (CURR) protection: off until it is cleared."""
        self._tripped[protection] = True
        self._switch(False, f"protection {protection}")

    def press_output_key(self, on: bool) -> None:
        """Switch at the front panel, which needs no program."""
        self._switch(on, "front panel")

    def _switch(self, on: bool, cause: str) -> None:
        if on != self._on:
            self._on = on
            self.output.append(OutputChange(mono_ns=time.monotonic_ns(), on=on, cause=cause))

    # Commands ------------------------------------------------------------------------------------

    def answer(self, command: str) -> str | None:
        """Obey one command; questions are answered, others are not."""
        header, _, argument = command.upper().partition(" ")
        if header.endswith("?"):
            return self._tell(header)
        error = self._obey(header, argument.strip())
        if error is not None:
            self._errors.append(error)
        return None

    def _tell(self, question: str) -> str | None:
        match question:
            case "*IDN?":
                return self.identity
            case "SYST:ERR?":
                return self._errors.pop(0) if self._errors else NO_ERROR
            case "OUTP?":
                return str(int(self._on))
            case "VOLT?" | "CURR?":
                return f"{self._set[question[:4]]:+.6E}"
            case "VOLT:PROT?" | "CURR:PROT?" if self.has_protections:
                return f"{self._protection[question[:4]]:+.6E}"
            case "MEAS:VOLT?":
                return f"{self._measured()[0] + self._scatter('V'):+.6E}"
            case "MEAS:CURR?":
                return f"{self._measured()[1] + self._scatter('A'):+.6E}"
            case "VOLT:PROT:TRIP?" | "CURR:PROT:TRIP?" if self.has_protections:
                return str(int(self._tripped[question[:4]]))
        self._errors.append(UNDEFINED)
        return None  # an instrument does not answer what it does not know

    def _obey(self, header: str, argument: str) -> str | None:
        match header, argument:
            case "OUTP", "ON" | "1":
                if any(self._tripped.values()):
                    return CONFLICT
                self._switch(True, "command")
            case "OUTP", "OFF" | "0":
                self._switch(False, "command")
            case "VOLT" | "CURR", number:
                return self._set_level(header, number)
            case "VOLT:PROT" | "CURR:PROT", number if self.has_protections:
                return self._protect(header[:4], float(number))
            case "VOLT:PROT:CLE" | "CURR:PROT:CLE", "":
                self._tripped[header[:4]] = False
            case "*CLS", "":
                self._errors.clear()
            case "SYST:REM" | "SYST:LOC" | "SYST:RWL", "":
                pass
            case _:
                return UNDEFINED
        return None

    def _set_level(self, header: str, number: str) -> str | None:
        try:
            value = float(number)
        except ValueError:
            return '-104,"Data type error"'
        if not 0.0 <= value <= {"VOLT": RATED_V, "CURR": RATED_A}[header]:
            return OUT_OF_RANGE
        if value > self._protection[header]:
            return CONFLICT
        if self.obeys_set_commands:
            self._set[header] = value
        return None

    def _protect(self, what: str, value: float) -> str | None:
        """Set the level of a protection: never below what is set."""
        if value < self._set[what]:
            return CONFLICT
        if self.obeys_set_commands:
            self._protection[what] = value
        return None

    def _measured(self) -> tuple[float, float]:
        if not self._on:
            return 0.0, 0.0
        hours_h = (self._seconds() - self._start_s) / 3600.0
        return self.cell.operating_point(self._set["VOLT"], self._set["CURR"], hours_h)

    def _scatter(self, unit: str) -> float:
        self._readings += 1
        return float(np.random.default_rng([self._seed, self._readings]).normal(0.0, self._noise[unit]))


class ClimateProbe:
    """A thermometer and hygrometer: a day's swing around room climate."""

    def __init__(
        self,
        *,
        temperature_c: float = 22.0,
        swing_c: float = 1.5,
        relative_humidity: float = 0.45,
        seconds: Callable[[], float] = time.monotonic,
    ) -> None:
        self.identity = CLIMATE_IDENTITY
        self.temperature_c = temperature_c
        self.swing_c = swing_c
        self.relative_humidity = relative_humidity
        self._seconds, self._start_s = seconds, seconds()

    def answer(self, command: str) -> str | None:
        """Answer name, temperature and humidity; anything else is not known and not answered."""
        phase = 2.0 * math.pi * (self._seconds() - self._start_s) / 86_400.0
        match command.upper():
            case "*IDN?":
                return self.identity
            case "MEAS:TEMP?":
                return f"{self.temperature_c + self.swing_c * math.sin(phase):.2f}"
            case "MEAS:HUM?":
                return f"{100.0 * self.relative_humidity - 5.0 * math.sin(phase):.1f}"
        return None


class SerialInstruments:
    """Both instruments, each on its own line; a context manager.

    Attributes
    ----------
    supply, climate
        The instruments themselves: what is changed there while a driver talks goes through ``do``
        of their link.
    supply_link, climate_link
        Their lines, to be unplugged and disturbed; ``path`` is the port to open.
    """

    def __init__(
        self,
        folder: Path,
        *,
        supply: Supply | None = None,
        climate: ClimateProbe | None = None,
        link: type[SerialLink] = SerialLink,
    ) -> None:
        self.supply = Supply() if supply is None else supply
        self.climate = ClimateProbe() if climate is None else climate
        self.supply_link = link(folder / "supply", self.supply.answer, self.supply.FRAMING)
        try:
            self.climate_link = link(folder / "climate", self.climate.answer)
        except BaseException:
            self.supply_link.close()
            raise

    def __enter__(self) -> SerialInstruments:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def brown_out(self) -> None:
        """Take mains and USB away from the supply, then give both back."""
        self.supply_link.unplug()
        self.supply_link.do(self.supply.brown_out)
        self.supply_link.plug()

    def output_changes(self) -> list[OutputChange]:
        """Everything that ever happened to the supply's output, oldest first."""
        return self.supply_link.do(lambda: list(self.supply.output))

    def close(self) -> None:
        """Unplug both and end their threads."""
        self.supply_link.close()
        self.climate_link.close()


def carry_out(instruments: SerialInstruments, order: Mapping[str, Any]) -> dict[str, Any]:
    """Do what one JSON line on standard input asks for.

    ``{"do": "unplug" | "plug" | "clear_faults", "instrument": "supply" | "climate"}``;
    ``{"do": "inject", "instrument": ..., "silent": true, "slow_s": 0.5, "hold": 1, "garbage": 1}``;
    ``{"do": "identity", "instrument": ..., "name": "OTHER,..."}``; ``{"do": "brown_out"}``;
    ``{"do": "trip", "protection": "CURR" | "VOLT"}``; ``{"do": "output_key", "on": false}``;
    ``{"do": "resistance", "resistance_ohm": 4.0}`` (a short circuit); ``{"do": "record"}`` returns the
    output's changes and the commands heard by both.

    Raises
    ------
    SimulatorError
        There is no such order.
    """
    supply = instruments.supply
    which = order.get("instrument", "supply")
    if which not in {"supply", "climate"}:
        raise SimulatorError(f"no instrument {which!r}; there are supply and climate")
    link = instruments.supply_link if which == "supply" else instruments.climate_link
    match order.get("do"):
        case "unplug":
            link.unplug()
        case "plug":
            link.plug()
        case "clear_faults":
            link.clear_faults()
        case "inject":
            try:
                link.inject(**{key: value for key, value in order.items() if key not in {"do", "instrument"}})
            except TypeError as error:
                raise SimulatorError(f"{order} names an unknown fault: {error}") from error
        case "identity":
            model: Supply | ClimateProbe = supply if which == "supply" else instruments.climate
            link.do(lambda: setattr(model, "identity", str(order["name"])))
        case "brown_out":
            instruments.brown_out()
        case "trip":
            instruments.supply_link.do(lambda: supply.trip(str(order.get("protection", "CURR"))))
        case "output_key":
            instruments.supply_link.do(lambda: supply.press_output_key(bool(order["on"])))
        case "resistance":
            cell = Cell(resistance_ohm=float(order["resistance_ohm"]))
            instruments.supply_link.do(lambda: setattr(supply, "cell", cell))
        case "record":
            return {
                "output": [asdict(change) for change in instruments.output_changes()],
                "supply_heard": instruments.supply_link.heard(),
                "climate_heard": instruments.climate_link.heard(),
            }
        case unknown:
            raise SimulatorError(f"no order {unknown!r}; see simulator.doubles.serial.instruments.carry_out")
    return {}


def main() -> int:
    """Run both instruments until standard input ends."""
    from simulator.doubles.serial.dialects import SUPPLIES  # they are kinds of the supply above

    parser = argparse.ArgumentParser(prog="simulator.doubles.serial.instruments", description=main.__doc__)
    parser.add_argument("--json", action="store_true", help="name the ports as one JSON line")
    parser.add_argument("--seed", type=int, default=0, help="seed of the readings' noise")
    parser.add_argument("--noise-v", type=float, default=1e-3, help="noise of a voltage reading in V")
    parser.add_argument("--noise-a", type=float, default=1e-4, help="noise of a current reading in A")
    parser.add_argument("--dialect", choices=sorted(SUPPLIES), default="scpi", help="what the supply speaks")
    parser.add_argument("--tcp", action="store_true", help="sockets instead of pseudo terminals")
    options = parser.parse_args()
    supply = SUPPLIES[options.dialect](seed=options.seed, noise_v=options.noise_v, noise_a=options.noise_a)
    with tempfile.TemporaryDirectory(prefix="solimon-serial-") as folder:
        try:
            instruments = SerialInstruments(
                Path(folder), supply=supply, link=SocketLink if options.tcp else SerialLink
            )
        except SimulatorError as error:
            print(error, file=sys.stderr)
            return 2
        with instruments:
            ports = {
                "supply": instruments.supply_link.port,
                "climate": instruments.climate_link.port,
            }
            ready = json.dumps({"event": "ready", **ports}) if options.json else f"ports: {ports}"
            print(ready, flush=True)
            for line in sys.stdin:
                print(json.dumps(_answered(instruments, line)), flush=True)
    return 0


def _answered(instruments: SerialInstruments, line: str) -> dict[str, Any]:
    try:
        order = json.loads(line)
        if not isinstance(order, dict):
            raise SimulatorError(f"an order is a JSON object, not {line.strip()!r}")
        return {"event": "done", **carry_out(instruments, order)}
    except (SimulatorError, ValueError, KeyError) as error:
        return {"event": "refused", "error": f"{type(error).__name__}: {error}"}


if __name__ == "__main__":
    sys.exit(main())
