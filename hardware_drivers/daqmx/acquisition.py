"""One transducer's acquisition: finite, triggered by the wave itself, with what came before it.

Committed once a transducer's turn, started and stopped a shot; its buffer is made once.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware_drivers.daqmx.boards import Board, agree
from hardware_drivers.daqmx.connection import Connection, discard
from hardware_drivers.daqmx.parameters import DaqmxParameters, TransducerWiring
from hardware_drivers.daqmx.translation import vendor_call
from hardware_drivers.errors import ConfigurationError, ConnectionLostError
from hardware_drivers.measurement import Calibration, Waveform

log = logging.getLogger(__name__)

EDGE_S = 10e-6
"""The level is passed this close to the trigger: comparator and ADC differ in codes and delay (filters, a few
samples), and this is a tenth of the incident wave's length."""
EDGE_FRACTION = 0.02
"""Level within which the comparator agrees with the ADC, as a fraction of the range."""
OVER_RANGE = (0.99, 1.5)
"""Last code in volts over the range: a board's codes reach its range and a little beyond."""

_DTYPES: Mapping[int, type[np.int16 | np.int32]] = {16: np.int16, 32: np.int32}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Acquisition:
    """A committed analog-input task and all that turns its codes into a record."""

    position: str
    board: Board
    task: Any
    reader: Any
    buffer: NDArray[np.int16 | np.int32]
    sample_rate_hz: float
    pretrigger_samples: int
    calibration: Calibration
    trigger_level_v: float
    triggered: bool
    settings: Mapping[str, float | str]

    def start(self) -> None:
        """Let samples flow; the pre-trigger is filling on return."""
        with vendor_call(f"starting the acquisition of {self.position!r}"):
            self.task.start()

    def read(self, timeout_s: float) -> Waveform:
        """Wait for the record and return it; the buffer's content is used only after a whole read."""
        with vendor_call(f"reading the record of {self.position!r}"):
            read = self.reader.read_int16 if self.buffer.dtype == np.int16 else self.reader.read_int32
            got = int(read(self.buffer, self.buffer.shape[1], timeout_s))
        wanted = self.buffer.shape[1]
        if got != wanted:
            raise ConnectionLostError(
                f"{self.board.label} gave {got} of {wanted} samples without an error; the record is not used"
            )
        waveform = Waveform(
            counts=self.buffer[0],
            sample_rate_hz=self.sample_rate_hz,
            pretrigger_samples=self.pretrigger_samples if self.triggered else 0,
            calibration=self.calibration,
        )
        if self.triggered:
            self._require_edge(waveform)
        return waveform

    def stop(self) -> None:
        """Back to committed, ready for the next shot."""
        with vendor_call(f"stopping the acquisition of {self.position!r}"):
            self.task.stop()

    def close(self) -> bool:
        """Give the board free; True if the driver did as asked (errors are logged)."""
        return discard(self.task, f"closing the acquisition of {self.position!r}")

    def _require_edge(self, waveform: Waveform) -> None:
        """Refuse a record that does not pass its own trigger level where the trigger is said to be."""
        reach = max(2, round(EDGE_S * self.sample_rate_hz))
        trigger = self.pretrigger_samples
        around = waveform.calibration.volts(waveform.counts[max(0, trigger - reach) : trigger + reach + 1])
        slack_v = EDGE_FRACTION * waveform.calibration.range_v
        level_v = self.trigger_level_v
        if not around.min() - slack_v <= level_v <= around.max() + slack_v:
            raise ConnectionLostError(
                f"the record of {self.position!r} lies between {around.min():.4g} and {around.max():.4g} V "
                f"around its trigger, whose level is {level_v:.4g} V: it is not the record that triggered; "
                "it is not used"
            )


def commit_acquisition(
    connection: Connection, parameters: DaqmxParameters, position: str, board: Board, *, triggered: bool
) -> Acquisition:
    """Build one transducer's task, commit it, and read back what the board made of it.

    Parameters
    ----------
    triggered
        False records at once: noise, for a dry run and for `survey`.

    Raises
    ------
    ConfigurationError
        The board would use another rate or range than asked, or codes this driver does not know.
    """
    wiring = parameters.transducers[position]
    task = connection.task("digitizer")
    try:
        with vendor_call(f"setting up the acquisition of {position!r} on {board.label}"):
            channel = _configure(task, parameters, wiring, board, triggered=triggered)
            from nidaqmx.constants import TaskMode

            task.control(TaskMode.TASK_COMMIT)
            return _committed(task, channel, parameters, position, board, triggered=triggered)
    except BaseException:
        discard(task, f"setting up the acquisition of {position!r}")
        raise


def _configure(
    task: Any, parameters: DaqmxParameters, wiring: TransducerWiring, board: Board, *, triggered: bool
) -> Any:
    from nidaqmx.constants import AcquisitionType, Coupling, Slope, TerminalConfiguration

    physical = f"{board.name}/{wiring.input}"
    channel = task.ai_channels.add_ai_voltage_chan(
        physical,
        terminal_config=TerminalConfiguration[_TERMINALS[wiring.terminal_configuration]],
        min_val=-wiring.range_v,
        max_val=wiring.range_v,
    )
    if wiring.coupling != "default":
        channel.ai_coupling = Coupling[wiring.coupling.upper()]
    task.timing.cfg_samp_clk_timing(
        parameters.sample_rate_hz,
        sample_mode=AcquisitionType.FINITE,
        samps_per_chan=parameters.record_samples,
    )
    if parameters.reference_clock != "onboard":
        task.timing.ref_clk_src = parameters.reference_clock
        task.timing.ref_clk_rate = _CLOCK_HZ[parameters.reference_clock]
    if triggered:
        task.triggers.reference_trigger.cfg_anlg_edge_ref_trig(
            physical,
            pretrigger_samples=parameters.pretrigger_samples,
            trigger_slope=Slope[parameters.trigger_slope.upper()],
            trigger_level=parameters.trigger_level_v,
        )
    return channel


_TERMINALS = {
    "default": "DEFAULT",
    "rse": "RSE",
    "nrse": "NRSE",
    "differential": "DIFF",
    "pseudo_differential": "PSEUDO_DIFF",
}
_CLOCK_HZ = {"PXI_Clk10": 10e6, "PXIe_Clk100": 100e6}


def _committed(
    task: Any, channel: Any, parameters: DaqmxParameters, position: str, board: Board, *, triggered: bool
) -> Acquisition:
    """Read back what counts and refuse what was silently changed."""
    from nidaqmx.stream_readers import AnalogUnscaledReader

    wiring = parameters.transducers[position]
    rate_hz = float(task.timing.samp_clk_rate)
    if not agree(rate_hz, parameters.sample_rate_hz):
        raise ConfigurationError(
            f"sample_rate_hz is {parameters.sample_rate_hz:.10g} Hz; {board.label} would use {rate_hz:.10g} "
            "Hz; ask for a rate that divides its time base, such as that one"
        )
    low_v, high_v = float(channel.ai_rng_low), float(channel.ai_rng_high)
    if not (agree(high_v, wiring.range_v) and agree(-low_v, wiring.range_v)):
        raise ConfigurationError(
            f"range_v is {wiring.range_v} V; {board.label} would use {low_v:g}..{high_v:g} V; choose a "
            "range it has"
        )
    calibration = _calibration(channel, wiring, board)
    size = int(channel.ai_raw_samp_size)
    if size not in _DTYPES or calibration.resolution_bits > size:
        raise ConfigurationError(
            f"{board.label} gives {calibration.resolution_bits}-bit codes in {size}-bit samples; this driver "
            "reads samples of 16 and 32 bits; use another board"
        )
    level_v = parameters.trigger_level_v
    if triggered:
        level_v = float(task.triggers.reference_trigger.anlg_edge_lvl)
        if abs(level_v - parameters.trigger_level_v) > EDGE_FRACTION * wiring.range_v:
            raise ConfigurationError(
                f"trigger_level_v is {parameters.trigger_level_v} V; {board.label} triggers at {level_v:g} "
                "V; choose a level its comparator has"
            )
    reader = AnalogUnscaledReader(task.in_stream)
    reader.verify_array_shape = False  # the shape is right by construction; checking costs a call a shot
    return Acquisition(
        position=position,
        board=board,
        task=task,
        reader=reader,
        buffer=np.zeros((1, parameters.record_samples), dtype=_DTYPES[size]),
        sample_rate_hz=rate_hz,
        pretrigger_samples=parameters.pretrigger_samples,
        calibration=calibration,
        trigger_level_v=level_v,
        triggered=triggered,
        settings=_settings(parameters, wiring, board, level_v, triggered=triggered),
    )


def _calibration(channel: Any, wiring: TransducerWiring, board: Board) -> Calibration:
    """Scaling of the board's codes, refused if its ends are not those of the range."""
    coefficients = np.array(channel.ai_dev_scaling_coeff, dtype=np.float64)
    bits = float(channel.ai_resolution)
    if coefficients.size < 2 or not np.isfinite(coefficients).all() or not 2.0 <= bits <= 32.0:
        raise ConnectionLostError(
            f"{board.label} scales by {coefficients.tolist()} at {bits:g} bits: that makes no sense"
        )
    calibration = Calibration(
        coefficients_v=coefficients,
        resolution_bits=round(bits),
        range_v=wiring.range_v,
        date=board.calibration_date,
    )
    ends_v = calibration.volts(np.array(calibration.full_scale_counts, dtype=np.int32))
    reach = np.abs(ends_v) / wiring.range_v
    if not (ends_v[0] < 0.0 < ends_v[1] and ((reach >= OVER_RANGE[0]) & (reach <= OVER_RANGE[1])).all()):
        raise ConnectionLostError(
            f"{board.label} scales its codes to {ends_v[0]:.4g}..{ends_v[1]:.4g} V in the range of "
            f"+-{wiring.range_v} V, which makes no sense (left-justified codes would look so too)"
        )
    return calibration


def _settings(
    parameters: DaqmxParameters, wiring: TransducerWiring, board: Board, level_v: float, *, triggered: bool
) -> dict[str, float | str]:
    settings: dict[str, float | str] = {
        "board_serial": board.serial,
        "product": board.product,
        "input": wiring.input,
        "terminal_configuration": wiring.terminal_configuration,
        "coupling": wiring.coupling,
        "trigger_level_v": level_v if triggered else math.nan,
        "trigger_slope": parameters.trigger_slope if triggered else "none",
        "reference_clock": parameters.reference_clock,
        "pulse_s": 0.0 if parameters.dry_run else parameters.pulse_s,
        "calibration_date": board.calibration_date,
        "calibration_temperature_c": board.calibration_temperature_c,
        "transport": parameters.transport,
    }
    if parameters.dry_run:
        settings["dry_run"] = "yes"
    return settings
