"""Steps of an NI-SCOPE acquisition: open, configure, read back, fetch.

Functions of a session of the `niscope` package; which step follows after a fault is `board`'s business.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hardware_drivers.errors import ConfigurationError, ConnectionLostError
from hardware_drivers.niscope.averaging import Codes, compute_code_scale, require_32_bit_sum
from hardware_drivers.niscope.parameters import NiscopeParameters, ProbeWiring
from hardware_drivers.niscope.vendor_errors import read_metadata

if TYPE_CHECKING:
    from niscope import Session
    from niscope.waveform_info import WaveformInfo

FULL_BANDWIDTH_HZ = -1.0
"""NI-SCOPE's value for an input without noise filter."""

TRIGGER_TERMINALS = {"external": "VAL_EXTERNAL", "pfi_0": "VAL_PFI_0", "pfi_1": "VAL_PFI_1"}

RELATIVE_TOLERANCE = 1e-9
"""Asked and given are equal but for the rounding of a decimal number."""


def import_niscope() -> ModuleType:
    """Import the package `niscope`, check that the library of NI-TClk loads, and return the package.

    Raises
    ------
    ConfigurationError
        The package is not installed, or NI-TClk, a part of the NI-SCOPE runtime, is not.
    """
    try:
        import niscope
        import nitclk
    except ImportError as error:
        raise ConfigurationError(
            "the rig has ultrasonic probes on NI-SCOPE, but the Python package niscope is not installed; "
            'install it with: python -m pip install "solimon[niscope]"'
        ) from error
    try:
        # `niscope.Session` opens the board first and loads NI-TClk after: without it the board would stay
        # open with no one to close it. A reference to no session loads the library and calls nothing.
        nitclk.SessionReference(0)
    except nitclk.errors.Error as error:
        raise ConfigurationError(
            f"the NI-SCOPE runtime, or its part NI-TClk, cannot be loaded: {error} Install NI-SCOPE with all "
            "of its parts"
        ) from error
    return niscope  # type: ignore[no-any-return]


def open_session(niscope: ModuleType, resource: str) -> Session:
    """Open the board named ``resource`` without resetting it, and return its session.

    Nothing stays open if that fails half-way. Raise ConfigurationError if NI-SCOPE is not installed; other
    errors of the package pass through.
    """
    session = niscope.Session.__new__(niscope.Session)
    try:
        session.__init__(resource)
    except niscope.errors.DriverNotInstalledError as error:
        raise ConfigurationError(
            f"opening {resource!r}: the NI-SCOPE runtime is not installed or of the wrong bitness; install "
            "NI-SCOPE from ni.com/downloads"
        ) from error
    except Exception:
        # The package forgets a board that it opened but could not ask for its channels. If opening itself
        # failed, closing is refused, which changes nothing: the first error is the one to report.
        with contextlib.suppress(niscope.errors.Error, AttributeError):
            close_session(niscope, session)
        raise
    return session


def close_session(niscope: ModuleType, session: Session) -> None:
    """Close a board, with a second attempt if NI-SCOPE refuses: no later call can close it.

    The error of the second attempt passes through.
    """
    handle = session._interpreter.get_session_handle()
    try:
        session.close()
    except niscope.errors.Error:
        # The package forgets the handle of a board that refused to be closed.
        session._interpreter.set_session_handle(handle)
        session.close()


@dataclass(frozen=True, slots=True, kw_only=True)
class Board:
    """Description of a board."""

    resource: str
    serial_number: str
    product: str
    driver_version: str
    channels: tuple[str, ...]


def describe_board(session: Session, resource: str) -> Board:
    """Read serial number, product, driver version and channel names of an open board.

    Errors of the `niscope` package pass through.
    """
    return Board(
        resource=resource,
        serial_number=session.serial_number,
        product=session.instrument_model,
        driver_version=session.specific_driver_revision,
        channels=tuple(session.get_channel_names(range(session.channel_count))),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Setup:
    """Settings of the hardware for one probe, read back after the commit."""

    sample_rate_hz: float
    record_samples: int
    records: int
    range_v: float
    offset_v: float
    resolution_bits: int
    sample_bits: int
    calibration_date: str
    calibration_temperature_c: float


def configure_board(
    niscope: ModuleType, session: Session, board: Board, parameters: NiscopeParameters, wiring: ProbeWiring
) -> Setup:
    """Configure the board for one probe, disable its other channels, and read back and return its settings.

    Errors of the `niscope` package pass through.

    Raises
    ------
    ConfigurationError
        No such channel, the board coerced a value, or the sum of the records may exceed 32 bits.
    ConnectionLostError
        The board reports another trigger source, or a resolution that no ADC has.
    """
    if wiring.channel not in board.channels:
        raise ConfigurationError(
            f"channel is {wiring.channel!r}; the {board.product} at {board.resource!r} has "
            f"{', '.join(board.channels)}"
        )
    others = [name for name in board.channels if name != wiring.channel]
    if others:
        session.channels[others].channel_enabled = False
    channel = session.channels[wiring.channel]
    coupling = niscope.VerticalCoupling.AC if wiring.coupling == "ac" else niscope.VerticalCoupling.DC
    channel.configure_vertical(range=2.0 * wiring.range_v, coupling=coupling, offset=wiring.offset_v)
    channel.configure_chan_characteristics(
        float(wiring.input_impedance_ohm), wiring.bandwidth_hz or FULL_BANDWIDTH_HZ
    )
    session.configure_horizontal_timing(
        min_sample_rate=parameters.sample_rate_hz,
        min_num_pts=parameters.record_samples,
        ref_position=0.0,
        num_records=parameters.averages,
        enforce_realtime=True,
    )
    _configure_trigger(niscope, session, wiring)
    session.commit()
    setup = _read_back_settings(niscope, session, channel, board)
    _reject_coerced_settings(parameters, wiring, setup, channel, board)
    if session.trigger_source != find_trigger_terminal(wiring):
        raise ConnectionLostError(
            f"the board at {board.resource!r} waits for a trigger at {session.trigger_source!r}, not at "
            f"{find_trigger_terminal(wiring)!r} as configured"
        )
    require_32_bit_sum(parameters.averages, max(setup.sample_bits, setup.resolution_bits))
    return setup


def find_trigger_terminal(wiring: ProbeWiring) -> str:
    """Return NI-SCOPE's name of a probe's trigger source; for ``channel`` the input's own channel."""
    return TRIGGER_TERMINALS.get(wiring.trigger_source, wiring.channel)


def _configure_trigger(niscope: ModuleType, session: Session, wiring: ProbeWiring) -> None:
    """Configure the trigger by the pulser's sync, delayed by ``firing_delay_s`` to the firing pulse.

    A PFI line is a digital trigger, any other source an analog edge at ``trigger_level_v``. Nothing is
    committed; errors of the `niscope` package pass through.
    """
    slope = getattr(niscope.TriggerSlope, "POSITIVE" if wiring.trigger_slope == "rising" else "NEGATIVE")
    terminal = find_trigger_terminal(wiring)
    if wiring.trigger_source.startswith("pfi"):
        session.configure_trigger_digital(terminal, slope=slope, delay=wiring.firing_delay_s)
        return
    session.configure_trigger_edge(
        terminal,
        wiring.trigger_level_v,
        niscope.TriggerCoupling.DC,
        slope=slope,
        delay=wiring.firing_delay_s,
    )


def _read_back_settings(niscope: ModuleType, session: Session, channel: Session, board: Board) -> Setup:
    """Read the settings that the board has committed, and its last self-calibration.

    ``range_v`` is half of the board's peak-to-peak range. A calibration's date (empty) or temperature (NaN)
    that cannot be read is logged as a warning. ConnectionLostError if the board is gone; other errors of the
    `niscope` package pass through.
    """
    last = read_metadata(
        niscope,
        # A board that never calibrated itself says 0-0-0, which is no date.
        lambda: str(session.get_self_cal_last_date_and_time().date().isoformat()),
        "",
        f"when {board.resource!r} was calibrated",
    )
    return Setup(
        sample_rate_hz=session.horz_sample_rate,
        record_samples=session.horz_record_length,
        records=session.horz_num_records,
        range_v=0.5 * channel.vertical_range,
        offset_v=channel.vertical_offset,
        resolution_bits=session.resolution,
        sample_bits=session.binary_sample_width,
        calibration_date=last,
        calibration_temperature_c=read_metadata(
            niscope,
            lambda: float(session.get_self_cal_last_temp()),
            math.nan,
            f"how warm {board.resource!r} was then",
        ),
    )


def _reject_coerced_settings(
    parameters: NiscopeParameters, wiring: ProbeWiring, setup: Setup, channel: Session, board: Board
) -> None:
    """Raise ConfigurationError if rate, samples, averages, range or impedance is not what was requested.

    Values within `RELATIVE_TOLERANCE` are equal. A resolution outside 2 to 32 bits is a ConnectionLostError.
    """
    pairs: Mapping[str, tuple[float, float]] = {
        "sample_rate_hz": (parameters.sample_rate_hz, setup.sample_rate_hz),
        "record_samples": (parameters.record_samples, setup.record_samples),
        "averages": (parameters.averages, setup.records),
        "range_v": (wiring.range_v, setup.range_v),
        "input_impedance_ohm": (wiring.input_impedance_ohm, channel.input_impedance),
    }
    for key, (requested, given) in pairs.items():
        if not math.isclose(requested, given, rel_tol=RELATIVE_TOLERANCE):
            raise ConfigurationError(
                f"{key} is {requested}; the {board.product} at {board.resource!r} would use {given}: ask for "
                "that or for another value that the board has"
            )
    if not 2 <= setup.resolution_bits <= 32:
        raise ConnectionLostError(
            f"the board at {board.resource!r} reports a resolution of {setup.resolution_bits} bits"
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fetched:
    """Single records of one acquisition.

    Attributes
    ----------
    records
        int16 or int32, shape (n_records, record_samples).
    gain_v, offset_v
        Volts of a record: ``gain_v * count + offset_v``.
    codes
        Scale of the counts.
    first_sample_s
        float64, shape (n_records,): time from the trigger to each record's first sample.
    """

    records: NDArray[np.int16] | NDArray[np.int32]
    gain_v: float
    offset_v: float
    codes: Codes
    first_sample_s: NDArray[np.float64]


def fetch_records(session: Session, setup: Setup, wiring: ProbeWiring, timeout_s: float) -> Fetched:
    """Acquire and return all single records of one average; the board is idle again on return.

    Parameters
    ----------
    timeout_s
        Longest wait for all records; the package raises its own error after it.

    Raises
    ------
    ConnectionLostError
        The driver reports success, but records are missing or repeated, were never written, start at a wrong
        time, or differ in gain or offset.
    """
    shape = (setup.records, setup.record_samples)
    records: NDArray[np.int16] | NDArray[np.int32] = (
        np.empty(shape, dtype=np.int16) if setup.sample_bits <= 16 else np.empty(shape, dtype=np.int32)
    )
    buffer = records.reshape(-1)
    # From rail to rail at every sample: no input does that, so what is still there was never written.
    limits = np.iinfo(records.dtype)
    buffer[0::2], buffer[1::2] = limits.min, limits.max
    untouched = records.copy()
    with session.initiate():
        waveforms = session.channels[wiring.channel].fetch_into(buffer, timeout=timeout_s)
    if [len(waveform.samples) for waveform in waveforms] != [setup.record_samples] * setup.records:
        raise ConnectionLostError(
            f"asked for {setup.records} records of {setup.record_samples} samples, the driver handed over "
            f"{[len(waveform.samples) for waveform in waveforms]}"
        )
    if any(map(np.array_equal, records, untouched)):
        raise ConnectionLostError("the driver reports success but left the buffer as it was")
    first_sample_s = np.array([waveform.relative_initial_x for waveform in waveforms])
    _check_record_times(waveforms, first_sample_s, setup, wiring)
    gains = {(waveform.gain, waveform.offset) for waveform in waveforms}
    if len(gains) != 1:
        raise ConnectionLostError(f"gain and offset differ between the records of one acquisition: {gains}")
    (gain_v, offset_v), *_ = gains
    if not math.isfinite(offset_v):
        raise ConnectionLostError(f"the board reports an offset of {offset_v} V")
    return Fetched(
        records=records,
        gain_v=gain_v,
        offset_v=offset_v,
        codes=compute_code_scale(gain_v=gain_v, range_v=setup.range_v, resolution_bits=setup.resolution_bits),
        first_sample_s=first_sample_s,
    )


def _check_record_times(
    waveforms: list[WaveformInfo], first_sample_s: NDArray[np.float64], setup: Setup, wiring: ProbeWiring
) -> None:
    """Raise ConnectionLostError unless time zero of each record is the firing pulse, one firing per record.

    The driver's times decide: a wrong sample interval, a start (``first_sample_s``, after the trigger) more
    than two samples from ``firing_delay_s``, or equal time stamps of two records. Boards without time stamps
    pass the last check.
    """
    step_s = 1.0 / setup.sample_rate_hz
    steps = {waveform.x_increment for waveform in waveforms}
    if not all(math.isclose(step, step_s, rel_tol=RELATIVE_TOLERANCE) for step in steps):
        raise ConnectionLostError(
            f"the samples are {steps} s apart; at the rate read back they are {step_s} s"
        )
    # The trigger falls somewhere between two samples, and the delay is a whole number of them.
    departure_s = np.abs(first_sample_s - wiring.firing_delay_s)
    if not bool((departure_s <= 2.0 * step_s).all()):
        raise ConnectionLostError(
            f"a record starts {first_sample_s[np.argmax(departure_s)]} s after its trigger; the firing pulse "
            f"comes after {wiring.firing_delay_s} s"
        )
    # Boards without a time stamp report 0; a counter that rolls over steps back, but never stands still.
    stamps_s = np.array([waveform.absolute_initial_x for waveform in waveforms])
    if bool(stamps_s.any()) and np.unique(stamps_s).size < stamps_s.size:
        raise ConnectionLostError("two records have one time stamp; a record was handed over twice")


def read_package_version() -> str:
    """Return the version of the installed `niscope` package; PackageNotFoundError if it is not installed."""
    return version("niscope")
