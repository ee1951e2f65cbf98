"""A power supply with an electrochemical cell as its load, and a climate probe, on lines of text.

``python -m simulator.doubles.serial.instruments --json`` runs both in a process of their own: one JSON line
names the ports, commands come as JSON lines on standard input (see `carry_out`), whose end ends it.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from simulator.doubles.serial.dialects import SUPPLIES
from simulator.doubles.serial.link import SerialLink, SocketLink
from simulator.doubles.serial.supply import Cell, OutputChange, Supply
from simulator.errors import SimulatorError

CLIMATE_IDENTITY = "SOLIMON,CLIMATE PROBE DOUBLE,CD0001,1.0"
TEMPERATURE_C, SWING_C, RELATIVE_HUMIDITY = 22.0, 1.5, 0.45
"""Room climate, and half the daily swing of its temperature."""


class ClimateProbe:
    """Thermometer and hygrometer: a daily swing around room climate."""

    def __init__(self) -> None:
        self.identity = CLIMATE_IDENTITY
        self.temperature_c, self.relative_humidity = TEMPERATURE_C, RELATIVE_HUMIDITY
        self._start_s = time.monotonic()

    def answer(self, command: str) -> str | None:
        """Answer queries of identity, temperature (°C) and relative humidity (%); None for any other command.

        Both swing with a period of one day from the start of the double.
        """
        phase = 2.0 * math.pi * (time.monotonic() - self._start_s) / 86_400.0
        match command.upper():
            case "*IDN?":
                return self.identity
            case "MEAS:TEMP?":
                return f"{self.temperature_c + SWING_C * math.sin(phase):.2f}"
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
        link: type[SerialLink] = SerialLink,
    ) -> None:
        self.supply = Supply() if supply is None else supply
        self.climate = ClimateProbe()
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
        """Unplug the supply, restore its power-on state (settings are lost) and plug it in again."""
        self.supply_link.unplug()
        self.supply_link.do(self.supply.brown_out)
        self.supply_link.plug()

    def list_output_changes(self) -> list[OutputChange]:
        """Return all changes of the supply's output since its start, the oldest first."""
        return self.supply_link.do(lambda: list(self.supply.output))

    def close(self) -> None:
        """Unplug both instruments and end their threads."""
        self.supply_link.close()
        self.climate_link.close()


def carry_out(instruments: SerialInstruments, order: Mapping[str, Any]) -> dict[str, Any]:
    """Execute the command of one JSON line from standard input; return its results, mostly none.

    ``{"do": "unplug" | "plug" | "clear_faults", "instrument": "supply" | "climate"}``;
    ``{"do": "inject", "instrument": ..., "silent": true, "slow_s": 0.5, "hold": 1, "garbage": 1}``;
    ``{"do": "identity", "instrument": ..., "name": "OTHER,..."}``; ``{"do": "brown_out"}``;
    ``{"do": "trip", "protection": "CURR" | "VOLT"}``; ``{"do": "output_key", "on": false}``;
    ``{"do": "resistance", "resistance_ohm": 4.0}`` (a short circuit); ``{"do": "record"}`` returns the
    output's changes and the commands received by both.

    Raises
    ------
    SimulatorError
        There is no such command, instrument or fault.
    KeyError, ValueError
        An argument is missing, or invalid.
    """
    supply = instruments.supply
    name = order.get("instrument", "supply")
    if name not in {"supply", "climate"}:
        raise SimulatorError(f"no instrument {name!r}; there are supply and climate")
    link = instruments.supply_link if name == "supply" else instruments.climate_link
    match order.get("do"):
        case "unplug" | "plug" | "clear_faults" as method:
            getattr(link, method)()
        case "inject":
            try:
                link.inject(**{key: value for key, value in order.items() if key not in {"do", "instrument"}})
            except TypeError as error:
                raise SimulatorError(f"{order} names an unknown fault: {error}") from error
        case "identity":
            model: Supply | ClimateProbe = supply if name == "supply" else instruments.climate
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
                "output": [asdict(change) for change in instruments.list_output_changes()],
                "supply_heard": instruments.supply_link.heard(),
                "climate_heard": instruments.climate_link.heard(),
            }
        case unknown:
            raise SimulatorError(f"no order {unknown!r}; see simulator.doubles.serial.instruments.carry_out")
    return {}


def main() -> int:
    """Run supply and climate probe until standard input ends; return the exit code."""
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
            ports = {"supply": instruments.supply_link.port, "climate": instruments.climate_link.port}
            ready = json.dumps({"event": "ready", **ports}) if options.json else f"ports: {ports}"
            print(ready, flush=True)
            for line in sys.stdin:
                print(json.dumps(_execute_line(instruments, line)), flush=True)
    return 0


def _execute_line(instruments: SerialInstruments, line: str) -> dict[str, Any]:
    """Execute the JSON command in a line; return its result as an event ``done``, an error as ``refused``."""
    try:
        order = json.loads(line)
        if not isinstance(order, dict):
            raise SimulatorError(f"an order is a JSON object, not {line.strip()!r}")
        return {"event": "done", **carry_out(instruments, order)}
    except (SimulatorError, ValueError, KeyError) as error:
        return {"event": "refused", "error": f"{type(error).__name__}: {error}"}


if __name__ == "__main__":
    sys.exit(main())
