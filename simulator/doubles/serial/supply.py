"""Double of a power supply with an electrochemical cell as its load.

The cell draws (all of it an assumption, the paper prints no current)::

    I = (U - U_0) / R(t),   R(t) = R_0 (1 + r t),   I = 0 where U < U_0

with U the voltage at its terminals, U_0 the counter-voltage of the electrodes, R_0 the resistance of the
solution at the start and r its slow rise as the diffusion path through the rust grows. At the supply's
limit I_lim the current is I_lim and U = U_0 + I_lim R(t). Readings carry normal noise, keyed by seed and
reading, never by the order of other calls.

The supply keeps a record of its output: every change with its monotonic time and its cause, so that a
test can show who switched it on.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from simulator.doubles.serial.link import Framing

SUPPLY_IDENTITY = "SOLIMON,DC SUPPLY DOUBLE,SD0001,1.0"
RATED_V, RATED_A = 30.0, 5.0
NO_ERROR = '+0,"No error"'
UNDEFINED = '-113,"Undefined header"'
OUT_OF_RANGE = '-222,"Data out of range"'
CONFLICT = '-221,"Settings conflict"'


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """Cell of a steel plate and a copper sheet in salt water."""

    counter_voltage_v: float = 1.5
    resistance_ohm: float = 40.0
    rise_per_h: float = 1e-3

    def operating_point(self, set_v: float, limit_a: float, hours_h: float) -> tuple[float, float]:
        """Return voltage in V and current in A at this load, in constant voltage or in current limit.

        Parameters
        ----------
        set_v, limit_a
            Voltage setting in V and current limit in A of the supply.
        hours_h
            Time since the start of the test, h, which raises the resistance.
        """
        resistance_ohm = self.resistance_ohm * (1.0 + self.rise_per_h * hours_h)
        current_a = max(0.0, (set_v - self.counter_voltage_v) / resistance_ohm)
        if current_a <= limit_a:
            return set_v, current_a
        return self.counter_voltage_v + limit_a * resistance_ohm, limit_a


@dataclass(frozen=True, slots=True, kw_only=True)
class OutputChange:
    """Change of the output state."""

    mono_ns: int
    on: bool
    cause: str


class Supply:
    """Bench supply with SCPI commands; `dialects` has those with others.

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
        self._set_power_on_state()

    def _set_power_on_state(self) -> None:
        """Set the state after power-on: output off, 0 V, 0.1 A, no trips or errors.

        The protections are at 110 % of the rating.
        """
        self._set = {"VOLT": 0.0, "CURR": 0.1}
        self._on = False
        self._tripped = {"VOLT": False, "CURR": False}
        self._protection = {"VOLT": 1.1 * RATED_V, "CURR": 1.1 * RATED_A}
        self._errors: list[str] = []

    @property
    def on(self) -> bool:
        """Return whether the output is on."""
        return self._on

    # What happens to it --------------------------------------------------------------------------

    def brown_out(self) -> None:
        """Interrupt the mains for a moment: the output goes off and all settings are lost."""
        self._set_output(False, "brown-out")
        self._set_power_on_state()

    def trip(self, protection: str = "CURR") -> None:
        """Trip the over-voltage (VOLT) or over-current (CURR) protection, which switches the output off.

        Commands cannot switch it on until the protection is cleared.
        """
        self._tripped[protection] = True
        self._set_output(False, f"protection {protection}")

    def press_output_key(self, on: bool) -> None:
        """Switch the output at the front panel, without a command, also with a tripped protection."""
        self._set_output(on, "front panel")

    def _set_output(self, on: bool, cause: str) -> None:
        """Switch the output on or off; record a change of state with its monotonic time and its cause."""
        if on != self._on:
            self._on = on
            self.output.append(OutputChange(mono_ns=time.monotonic_ns(), on=on, cause=cause))

    # Commands ------------------------------------------------------------------------------------

    def answer(self, command: str) -> str | None:
        """Execute one SCPI command; return the response to a query, else None.

        Errors enter the error queue; only a level of a protection that is no number raises ValueError.
        """
        header, _, argument = command.upper().partition(" ")
        if header.endswith("?"):
            return self._answer(header)
        error = self._execute_command(header, argument.strip())
        if error is not None:
            self._errors.append(error)
        return None

    def _answer(self, question: str) -> str | None:
        """Return the answer to an SCPI query; None, with an error in the queue, if it is unknown.

        ``SYST:ERR?`` removes the oldest error from the queue.
        """
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
                return f"{self._compute_output()[0] + self._draw_noise('V'):+.6E}"
            case "MEAS:CURR?":
                return f"{self._compute_output()[1] + self._draw_noise('A'):+.6E}"
            case "VOLT:PROT:TRIP?" | "CURR:PROT:TRIP?" if self.has_protections:
                return str(int(self._tripped[question[:4]]))
        self._errors.append(UNDEFINED)
        return None  # an instrument does not answer what it does not know

    def _execute_command(self, header: str, argument: str) -> str | None:
        """Execute an SCPI command; return its SCPI error, None if there is none.

        Raises
        ------
        ValueError
            The level of a protection is no number.
        """
        match header, argument:
            case "OUTP", "ON" | "1":
                if any(self._tripped.values()):
                    return CONFLICT
                self._set_output(True, "command")
            case "OUTP", "OFF" | "0":
                self._set_output(False, "command")
            case "VOLT" | "CURR", number:
                return self._set_level(header, number)
            case "VOLT:PROT" | "CURR:PROT", number if self.has_protections:
                return self._set_protection(header[:4], float(number))
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
        """Set voltage (VOLT, V) or current limit (CURR, A); return the SCPI error of an invalid value.

        Return None for a valid one. With ``obeys_set_commands`` False it is not set.
        """
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

    def _set_protection(self, quantity: str, value: float) -> str | None:
        """Set the level of a protection, V or A; return an SCPI error if it is below the setpoint, else None.

        With ``obeys_set_commands`` False it is not set.
        """
        if value < self._set[quantity]:
            return CONFLICT
        if self.obeys_set_commands:
            self._protection[quantity] = value
        return None

    def _compute_output(self) -> tuple[float, float]:
        """Compute voltage in V and current in A at the cell, without noise; 0 while the output is off."""
        if not self._on:
            return 0.0, 0.0
        hours_h = (self._seconds() - self._start_s) / 3600.0
        return self.cell.operating_point(self._set["VOLT"], self._set["CURR"], hours_h)

    def _draw_noise(self, unit: str) -> float:
        """Draw the normal noise of the next reading in ``unit``, V or A, keyed by seed and reading."""
        self._readings += 1
        return float(np.random.default_rng([self._seed, self._readings]).normal(0.0, self._noise[unit]))
