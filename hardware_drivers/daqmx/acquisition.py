"""Acquisition of one transducer: finite, triggered by the wave itself, with a pre-trigger.

Committed once a transducer's turn, started and stopped a shot; its buffer is made once.

A coil's spike must not take the trigger. NI's boards ignore a reference trigger until the pre-trigger is
full, and that fills from the start trigger on: so with ``holdoff_s`` the falling edge of the coil's counter
starts the acquisition, and the first sample is delayed by the holdoff, all of it in hardware.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from hardware_drivers.daqmx.boards import Board, is_requested_value
from hardware_drivers.daqmx.connection import Connection, clear_task
from hardware_drivers.daqmx.parameters import DaqmxParameters, TransducerWiring
from hardware_drivers.daqmx.translation import translate_errors
from hardware_drivers.errors import ConfigurationError, ConnectionLostError
from hardware_drivers.measurement import Calibration, Waveform

if TYPE_CHECKING:
    from nidaqmx import Task
    from nidaqmx.stream_readers import AnalogUnscaledReader
    from nidaqmx.task.channels import AIChannel

log = logging.getLogger(__name__)

EDGE_S = 10e-6
"""The level is passed this close to the trigger: comparator and ADC differ in codes and delay (filters, a few
samples), and this is a tenth of the incident wave's length."""
EDGE_FRACTION = 0.02
"""Level within which the comparator agrees with the ADC, as a fraction of the range."""
OVER_RANGE = (0.99, 1.5)
"""Last code in volts over the range: a board's codes reach its range and a little beyond."""

Record = Literal["shot", "noise", "pulse"]
"""``shot``: triggered by the wave; ``noise``: at once; ``pulse``: from the coil's switching on to the end of
the wave, whatever triggers."""

DELAY_AGREEMENT_S = 1e-6
"""A board rounds the holdoff to its time base: less than this, or it does not understand what it is asked."""

_DTYPES: Mapping[int, type[np.int16 | np.int32]] = {16: np.int16, 32: np.int32}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Acquisition:
    """Committed analog-input task and the conversion of its codes into a record."""

    position: str
    board: Board
    task: Task
    reader: AnalogUnscaledReader
    buffer: NDArray[np.int16 | np.int32]
    part_samples: int
    sample_rate_hz: float
    pretrigger_samples: int
    calibration: Calibration
    trigger_level_v: float
    triggered: bool
    settings: Mapping[str, float | str]

    def start(self) -> None:
        """Start the task: sampling starts at once, or at the edge of the coil's counter; do not wait.

        Raise InstrumentError if the driver refuses.
        """
        with translate_errors(f"starting the acquisition of {self.position!r}"):
            self.task.start()

    def read(self, timeout_s: float) -> Waveform:
        """Wait for the record and return it as a waveform; pre-trigger 0 unless the wave triggered.

        ``timeout_s`` bounds the wait for each part of ``part_samples``. Other instrument errors pass through.

        Raises
        ------
        AcquisitionTimeoutError
            Nothing triggered in time.
        ConnectionLostError
            Samples are missing, or the record does not cross its trigger level.
        """
        with translate_errors(f"reading the record of {self.position!r}"):
            read = self.reader.read_int16 if self.buffer.dtype == np.int16 else self.reader.read_int32
            wanted = self.buffer.shape[1]
            # A longer record comes in parts: an answer over gRPC holds one of usual length.
            starts = range(0, wanted, self.part_samples)
            parts = [self.buffer[:, start : start + self.part_samples] for start in starts]
            got = sum(int(read(part, part.shape[1], timeout_s)) for part in parts)
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
            self._require_trigger_edge(waveform)
        return waveform

    def stop(self) -> None:
        """Stop the task and leave it committed, ready for the next shot; InstrumentError if that fails."""
        with translate_errors(f"stopping the acquisition of {self.position!r}"):
            self.task.stop()

    def close(self) -> bool:
        """Abort and clear the task; return True if the driver confirmed it, else False with a log entry."""
        return clear_task(self.task, f"closing the acquisition of {self.position!r}")

    def _require_trigger_edge(self, waveform: Waveform) -> None:
        """Raise ConnectionLostError if a record does not cross its trigger level at the trigger sample.

        The level must be within the record's extremes at most `EDGE_S` from that sample, widened by
        `EDGE_FRACTION` of the range.
        """
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
    connection: Connection,
    parameters: DaqmxParameters,
    position: str,
    board: Board,
    coil_board: Board,
    *,
    record: Record,
) -> Acquisition:
    """Build the analog-input task of one transducer, commit it, and read back the settings of the board.

    Parameters
    ----------
    board, coil_board
        Digitizer of the position; board whose counter starts the records that wait for the coil.

    Raises
    ------
    ConfigurationError
        The board would use another rate, range, level or holdoff than asked, or codes this driver does not
        know; or the coil's counter cannot start it. The task is cleared after any error.
    BusyError, ConnectionLostError
        The board is in use, or does not answer.
    """
    wiring = parameters.transducers[position]
    task = connection.create_task("digitizer")
    try:
        with translate_errors(f"setting up the acquisition of {position!r} on {board.label}"):
            channel = _configure_task(task, parameters, wiring, board, record)
            if record == "pulse" or (record == "shot" and parameters.holdoff_s is not None):
                _configure_coil_start(task, parameters, position, coil_board, board, record)
            from nidaqmx.constants import TaskMode

            task.control(TaskMode.TASK_COMMIT)
            return _verify_committed_task(task, channel, parameters, position, board, record)
    except BaseException:
        clear_task(task, f"setting up the acquisition of {position!r}")
        raise


def _configure_task(
    task: Task, parameters: DaqmxParameters, wiring: TransducerWiring, board: Board, record: Record
) -> AIChannel:
    """Configure channel, sample clock, reference clock and, for shots only, the trigger; return the channel.

    Errors of the vendor's package pass through; nothing is committed.
    """
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
        samps_per_chan=_count_record_samples(parameters, record),
    )
    if parameters.reference_clock != "onboard":
        task.timing.ref_clk_src = parameters.reference_clock
        task.timing.ref_clk_rate = _CLOCK_HZ[parameters.reference_clock]
    if record == "shot":
        task.triggers.reference_trigger.cfg_anlg_edge_ref_trig(
            physical,
            pretrigger_samples=parameters.pretrigger_samples,
            trigger_slope=Slope[parameters.trigger_slope.upper()],
            trigger_level=parameters.trigger_level_v,
        )
    return channel


def _count_record_samples(parameters: DaqmxParameters, record: Record) -> int:
    """Return the samples of a record: those of a complete strike for ``pulse``, else ``record_samples``."""
    return parameters.whole_strike_samples if record == "pulse" else parameters.record_samples


def _configure_coil_start(
    task: Task, parameters: DaqmxParameters, position: str, coil_board: Board, board: Board, record: Record
) -> None:
    """Configure and verify the start by an edge of the coil's counter output.

    Record ``pulse`` starts with the pulse, ``shot`` the holdoff after its end. Raise ConfigurationError for a
    delay that is not the holdoff, ConnectionLostError for another source, or as the driver refuses.
    """
    from nidaqmx.constants import DigitalWidthUnits, Edge, TaskMode

    source = f"/{coil_board.name}/Ctr{parameters.transducers[position].counter[3:]}InternalOutput"
    trigger = task.triggers.start_trigger
    with translate_errors(
        f"starting the acquisition of {position!r} on {board.label} by {source} of {coil_board.label} (the "
        "coil's counter must be on the digitizer's board, S Series: ctr0, or in its chassis, known to NI MAX)"
    ):
        trigger.cfg_dig_edge_start_trig(source, Edge.RISING if record == "pulse" else Edge.FALLING)
        if record == "shot":
            trigger.delay_units = DigitalWidthUnits.SECONDS
            trigger.delay = parameters.holdoff_s
        task.control(TaskMode.TASK_VERIFY)
        given = str(trigger.dig_edge_src)
        if given.strip("/").casefold() != source.strip("/").casefold():
            raise ConnectionLostError(
                f"{board.label} would be started by {given or 'nothing'} instead of {source} for {position!r}"
            )
        if record == "shot":
            _check_start_delay(parameters, board, float(trigger.delay))


def _check_start_delay(parameters: DaqmxParameters, board: Board, delay_s: float) -> None:
    """Raise ConfigurationError if the start delay ``delay_s`` of the board is not, or cannot be, the holdoff.

    A difference up to `DELAY_AGREEMENT_S` is accepted; the limits are those of `check_holdoff`.
    """
    asked_s = parameters.holdoff_s or 0.0
    try:
        parameters.check_holdoff(delay_s)
    except ValueError as error:
        raise ConfigurationError(
            f"holdoff_s is {asked_s:g} s; {board.label} would hold off for {delay_s:g} s: {error}"
        ) from error
    if not abs(delay_s - asked_s) <= DELAY_AGREEMENT_S:
        raise ConfigurationError(
            f"holdoff_s is {asked_s:g} s; {board.label} would hold off for {delay_s:g} s; "
            "choose a time it can do"
        )


_TERMINALS = {
    "default": "DEFAULT",
    "rse": "RSE",
    "nrse": "NRSE",
    "differential": "DIFF",
    "pseudo_differential": "PSEUDO_DIFF",
}
_CLOCK_HZ = {"PXI_Clk10": 10e6, "PXIe_Clk100": 100e6}


def _verify_committed_task(
    task: Task, channel: AIChannel, parameters: DaqmxParameters, position: str, board: Board, record: Record
) -> Acquisition:
    """Read back rate, range, scaling and trigger level of a committed task; return its acquisition.

    Raise ConfigurationError where rate, range or trigger level differs or the sample size is unknown,
    ConnectionLostError for a scaling that makes no sense.
    """
    from nidaqmx.stream_readers import AnalogUnscaledReader

    wiring, triggered = parameters.transducers[position], record == "shot"
    rate_hz = float(task.timing.samp_clk_rate)
    if not is_requested_value(rate_hz, parameters.sample_rate_hz):
        raise ConfigurationError(
            f"sample_rate_hz is {parameters.sample_rate_hz:.10g} Hz; {board.label} would use {rate_hz:.10g} "
            "Hz; ask for a rate that divides its time base, such as that one"
        )
    low_v, high_v = float(channel.ai_rng_low), float(channel.ai_rng_high)
    if not (is_requested_value(high_v, wiring.range_v) and is_requested_value(-low_v, wiring.range_v)):
        raise ConfigurationError(
            f"range_v is {wiring.range_v} V; {board.label} would use {low_v:g}..{high_v:g} V; choose a "
            "range it has"
        )
    calibration = _read_calibration(channel, wiring, board)
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
        buffer=np.zeros((1, _count_record_samples(parameters, record)), dtype=_DTYPES[size]),
        part_samples=parameters.record_samples,
        sample_rate_hz=rate_hz,
        pretrigger_samples=parameters.pretrigger_samples,
        calibration=calibration,
        trigger_level_v=level_v,
        triggered=triggered,
        settings=_collect_settings(parameters, wiring, board, level_v, triggered=triggered),
    )


def _read_calibration(channel: AIChannel, wiring: TransducerWiring, board: Board) -> Calibration:
    """Read the polynomial that scales the board's codes to volts, and the resolution.

    Raise ConnectionLostError if they make no sense: not finite, not 2 to 32 bits, or extreme codes that are
    not 0.99 to 1.5 times the range.
    """
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


def _collect_settings(
    parameters: DaqmxParameters, wiring: TransducerWiring, board: Board, level_v: float, *, triggered: bool
) -> dict[str, float | str]:
    """Collect the settings that are stored with each record by name, with SI units in the names.

    They are board, input, trigger, clock, pulse, calibration and transport. A record that is not
    ``triggered`` has the level NaN; ``holdoff_s`` and ``dry_run`` are there only where they apply.
    """
    settings: dict[str, float | str] = {
        "board_serial": board.serial,
        "product": board.product,
        "input": wiring.input,
        "terminal_configuration": wiring.terminal_configuration,
        "coupling": wiring.coupling,
        "trigger_level_v": level_v if triggered else math.nan,
        "trigger_slope": parameters.trigger_slope if triggered else "none",
        "reference_clock": parameters.reference_clock,
        **({"holdoff_s": parameters.holdoff_s} if triggered and parameters.holdoff_s is not None else {}),
        "pulse_s": 0.0 if parameters.dry_run else parameters.pulse_s,
        "calibration_date": board.calibration_date,
        "calibration_temperature_c": board.calibration_temperature_c,
        "transport": parameters.transport,
    }
    if parameters.dry_run:
        settings["dry_run"] = "yes"
    return settings
