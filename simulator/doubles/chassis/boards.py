"""Board types of the doubles, with the figures of their data sheets.

What differs from one board to the next of a kind (serial number, slot, errors of the ADC) is in
`description`.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from hardware_drivers.measurement import Calibration
from simulator.electronics.transduction import make_adc_calibration
from simulator.parameters.electronics import AdcParameters


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardType:
    """Board type.

    Attributes
    ----------
    ranges_v
        Input ranges -r .. +r, rising.
    timebase_hz
        The sample clock is this divided by a whole number.
    max_rate_hz
        Of one channel.
    counter_terminals
        Where each counter's pulse leaves the board.
    digital_lines
        Lines whose power-up state can be set.
    starting_counters
        Counters of the board whose internal output can start its analog input.
    start_delay_ticks
        Shortest and longest delay from the start trigger to the first sample, ticks of the timebase.
    """

    product: str
    analog_inputs: int
    resolution_bits: int
    ranges_v: Sequence[float]
    timebase_hz: float
    max_rate_hz: float
    simultaneous: bool
    terminal_configuration: int
    counter_terminals: Sequence[str]
    digital_lines: Sequence[str]
    watchdog: bool
    starting_counters: Sequence[int]
    start_delay_ticks: Sequence[int]

    @property
    def raw_sample_bits(self) -> int:
        """Return the width of a raw sample in bits, 16 or 32."""
        return 16 if self.resolution_bits <= 16 else 32

    def coerced_rate_hz(self, rate_hz: float) -> float:
        """Return the lowest rate at or above the requested one, Hz, that divides the timebase evenly.

        Above the timebase, return the timebase. Raise ZeroDivisionError for a rate of 0.
        """
        divisor = max(int(self.timebase_hz / rate_hz * (1.0 + 1e-12)), 1)
        return self.timebase_hz / divisor

    def coerced_range_v(self, reach_v: float) -> float | None:
        """Return the smallest input range (-r to +r) that includes a voltage, V; None if none does."""
        return next((limit for limit in self.ranges_v if limit >= reach_v * (1.0 - 1e-12)), None)


DIFFERENTIAL = 10106
_PFI = tuple(f"PFI{number}" for number in range(16))
_PFI_OF_LINE = {f"port{1 + line // 8}/line{line % 8}": _PFI[line] for line in range(16)}

BOARD_TYPES: Mapping[str, BoardType] = {
    product: BoardType(product=product, **sizes)
    for product, sizes in tomllib.loads(
        Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")
    ).items()
}
"""By product name."""


def find_line_terminal(line: str) -> str:
    """Return the terminal of a digital line such as ``port1/line0``.

    Ports 1 and 2 are PFI0 to PFI15; another line is its own terminal.
    """
    return _PFI_OF_LINE.get(line, line)


def list_terminals(kind: BoardType, name: str) -> tuple[str, ...]:
    """Return the full names (``/Dev1/PFI0``) of all terminals of a board, as `Dev.Terminals` lists them.

    PFI lines come first, then other counter outputs, triggers and clocks of input and backplane, and
    counters.
    """
    counters = [
        f"Ctr{index}{part}"
        for index in range(len(kind.counter_terminals))
        for part in ("InternalOutput", "Source", "Gate")
    ]
    others = ["ai/StartTrigger", "ai/ReferenceTrigger", "ai/SampleClock", "PXI_Clk10", "PXI_Star"]
    others += [f"PXI_Trig{line}" for line in range(8)] + ["APFI0"]
    outputs = [terminal for terminal in kind.counter_terminals if terminal not in _PFI]
    return tuple(f"/{name}/{terminal}" for terminal in (*_PFI, *outputs, *others, *counters))


def get_board_calibration(adc: AdcParameters, offset_shift_v: float = 0.0) -> Calibration:
    """Return the scaling polynomial of a board from codes to V in the input range of its converter.

    Parameters
    ----------
    offset_shift_v
        Shift of the constant term by self-calibration, V.
    """
    calibration = make_adc_calibration(adc)
    coefficients_v = calibration.coefficients_v.copy()
    coefficients_v[0] += offset_shift_v
    return replace(calibration, coefficients_v=coefficients_v)
