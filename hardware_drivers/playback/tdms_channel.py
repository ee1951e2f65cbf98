"""Channel of a LabVIEW file: its sample rate, trigger, scaling and time, from properties or the mapping.

Everything is decided from metadata, before a sample is read: a file that cannot be played back is refused
when the recording is opened, with file, group, channel and remedy.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware_drivers.errors import ConfigurationError
from hardware_drivers.measurement import Calibration, Counts
from hardware_drivers.methods import PULSE_ECHO
from hardware_drivers.nanoseconds import NS_PER_S
from hardware_drivers.playback.ni_scaling import ScalingError, build_raw_polynomial
from hardware_drivers.playback.parameters import TdmsMapping

QUANTISED_RANGE_V = 10.0
"""Full scale of scaled values where the mapping gives none: the range of common boards."""
QUANTISED_BITS = 32
"""Scaled values become 32-bit codes: off by at most one code, 4.7e-10 of full scale."""
_VOLT = {"v", "volt", "volts"}
_RAW_TYPES = {np.dtype(np.int8): 8, np.dtype(np.int16): 16, np.dtype(np.int32): 32}
_SCALED_TYPES = {np.dtype(np.float32), np.dtype(np.float64)}
_TDMS_EPOCH_S = -2_082_844_800
"""TDMS counts from 1904-01-01T00:00Z."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Channel:
    """Metadata of a channel, independent of npTDMS.

    Attributes
    ----------
    own_properties, group_properties, file_properties
        The three by themselves: NI's scales belong together and are never mixed.
    dtype
        Of the values as they lie in the file.
    """

    path: Path
    group: str
    name: str
    own_properties: Mapping[str, Any]
    group_properties: Mapping[str, Any]
    file_properties: Mapping[str, Any]
    dtype: np.dtype[np.generic]
    n_samples: int

    @property
    def where(self) -> str:
        """Return file, group and channel as text, the beginning of a message."""
        return f"{self.path}, group {self.group!r}, channel {self.name!r}"

    @property
    def properties(self) -> Mapping[str, Any]:
        """Return the merged properties; the channel's take precedence over its group's, then its file's."""
        return {**self.file_properties, **self.group_properties, **self.own_properties}

    def build_error(self, problem: str, remedy: str) -> ConfigurationError:
        """Build, not raise, a ConfigurationError that names file, group, channel, problem and remedy."""
        return ConfigurationError(f"{self.where}: {problem}; {remedy}")

    def read_float(self, name: str) -> float | None:
        """Return a property as a float, None if absent; ConfigurationError if it is no finite number.

        The channel's own property takes precedence over its group's and the file's.
        """
        value = self.properties.get(name)
        if value is None:
            return None
        try:
            number = float(value)
        except (TypeError, ValueError) as error:
            raise self.build_error(f"{name} is {value!r}, no number", "correct the file") from error
        if not math.isfinite(number):
            raise self.build_error(f"{name} is {number}", "correct the file")
        return number


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Conversion:
    """Conversion of values in the file to counts.

    Attributes
    ----------
    polynomial
        Of scaled (float) values only: volts as a polynomial of them; None where the values are counts.
    """

    calibration: Calibration
    polynomial: NDArray[np.float64] | None = None

    def convert_to_counts(self, values: NDArray[np.generic], where: str) -> Counts:
        """Convert the values of a record to counts, shape (n_samples,); ``where`` begins an error's message.

        Raw codes keep their value, as int32 if they have 4 bytes, else as int16; scaled values become int32.

        Raises
        ------
        ConfigurationError
            A scaled value is not finite or beyond the range.
        """
        if self.polynomial is None:
            # Whatever byte order the file has; 8-bit codes fit 16 bits.
            return values.astype(np.int32) if values.dtype.itemsize == 4 else values.astype(np.int16)
        return _quantise_values(values, self.polynomial, self.calibration, where)


def _quantise_values(
    values: NDArray[np.generic], polynomial: NDArray[np.float64], calibration: Calibration, where: str
) -> NDArray[np.int32]:
    """Convert scaled values to the nearest codes, int32, same shape; full scale becomes the highest code.

    So a value at full scale counts as clipped. ``polynomial`` gives volts. Raise ConfigurationError for a
    value that is not finite or beyond the range.
    """
    volts = np.polynomial.polynomial.polyval(values.astype(np.float64), polynomial)
    largest_v = float(np.max(np.abs(volts), initial=0.0))
    if not math.isfinite(largest_v):
        raise ConfigurationError(f"{where}: a value is not finite; leave this record out of the patterns")
    if largest_v > calibration.range_v:
        raise ConfigurationError(
            f"{where}: a value of {largest_v:.6g} V exceeds the range of {calibration.range_v:g} V; raise "
            "range_v of the mapping"
        )
    low, high = calibration.full_scale_counts
    codes: NDArray[np.float64] = np.rint(volts / calibration.coefficients_v[1])
    return codes.clip(low, high).astype(np.int32)


def build_conversion(channel: Channel, mapping: TdmsMapping) -> Conversion:
    """Build the conversion of a channel's values to counts, with the calibration that turns these into volts.

    Raises
    ------
    ConfigurationError
        Values of another type; no scaling, or one that is no polynomial; values that are not volts; or an
        unknown resolution or range.
    """
    if channel.dtype in _SCALED_TYPES:
        range_v = QUANTISED_RANGE_V if mapping.range_v is None else mapping.range_v
        step_v = range_v / 2.0 ** (QUANTISED_BITS - 1)
        return Conversion(
            calibration=Calibration(
                coefficients_v=np.array([0.0, step_v]), resolution_bits=QUANTISED_BITS, range_v=range_v
            ),
            polynomial=_build_volts_polynomial(channel, mapping, default=np.array([0.0, 1.0])),
        )
    if channel.dtype not in _RAW_TYPES:
        raise channel.build_error(
            f"values of type {channel.dtype} are neither counts nor volts",
            "write I16, I32, SGL or DBL, or leave the channel out of channel_pattern",
        )
    bits = _find_resolution_bits(channel, mapping)
    coefficients_v = _build_volts_polynomial(channel, mapping, default=None)
    return Conversion(
        calibration=Calibration(
            coefficients_v=coefficients_v,
            resolution_bits=bits,
            range_v=mapping.range_v or _compute_range_v(channel, coefficients_v, bits),
        )
    )


def _find_resolution_bits(channel: Channel, mapping: TdmsMapping) -> int:
    """Return the ADC resolution in bits: the mapping's, else that of the stored type (8 or 16).

    Raise ConfigurationError for 32-bit codes without a resolution, or one above that of the stored type.
    """
    stored_bits = _RAW_TYPES[channel.dtype]
    if mapping.resolution_bits is None and stored_bits == 32:
        raise channel.build_error(
            "32-bit codes of a converter of unknown resolution: clipping could not be seen",
            "give resolution_bits (18 for a PXIe-6396)",
        )
    bits = stored_bits if mapping.resolution_bits is None else mapping.resolution_bits
    if bits > stored_bits:
        raise channel.build_error(
            f"resolution_bits is {bits}, yet the codes have {stored_bits}", "correct resolution_bits"
        )
    return bits


def _compute_range_v(channel: Channel, coefficients_v: NDArray[np.float64], bits: int) -> float:
    """Compute the range in V as the larger magnitude of the volts at the two extreme codes of ``bits`` bits.

    ``coefficients_v`` is constant first. Raise ConfigurationError if it is not positive and finite.
    """
    codes = np.array([-(2.0 ** (bits - 1)), 2.0 ** (bits - 1) - 1.0])
    range_v = float(np.abs(np.polynomial.polynomial.polyval(codes, coefficients_v)).max())
    if not (math.isfinite(range_v) and range_v > 0.0):
        raise channel.build_error(
            f"the scaling {coefficients_v.tolist()} gives a range of {range_v} V", "give range_v"
        )
    return range_v


def _build_volts_polynomial(
    channel: Channel, mapping: TdmsMapping, *, default: NDArray[np.float64] | None
) -> NDArray[np.float64]:
    """Return the coefficients of volts as a polynomial of the values in the file, constant first, 1-D.

    They are the mapping's, else NI's scaling, else ``default``; the latter two are multiplied by
    ``volts_per_unit`` unless the unit is V. Raise ConfigurationError where scaling or unit is missing.
    """
    if mapping.coefficients_v:
        return np.array(mapping.coefficients_v)
    scaling = _read_scaling(channel)
    unit = str(channel.properties.get(mapping.unit_property, "")).strip()
    if scaling is None:
        scaling = default
    if scaling is None and (unit.casefold() in _VOLT or mapping.volts_per_unit is None):
        raise channel.build_error(
            "whole numbers without NI scaling",
            "give coefficients_v of the board (volts as a polynomial of its codes)",
        )
    if scaling is None:
        scaling = np.array([0.0, 1.0])
    if unit.casefold() in _VOLT:
        return scaling
    if mapping.volts_per_unit is None:
        unit_text = f"the unit is {unit!r}" if unit else f"no unit ({mapping.unit_property} is missing)"
        raise channel.build_error(f"{unit_text}, V is needed", "give volts_per_unit")
    return scaling * mapping.volts_per_unit


def _read_scaling(channel: Channel) -> NDArray[np.float64] | None:
    """Return NI's scaling as coefficients of the raw value, constant first; None if absent.

    It is that of the channel, else of its group, else of the file. Raise ConfigurationError for a scaling
    that is no polynomial.
    """
    for properties in (channel.own_properties, channel.group_properties, channel.file_properties):
        try:
            polynomial = build_raw_polynomial(properties)
        except ScalingError as error:
            raise channel.build_error(str(error), "give coefficients_v") from error
        if polynomial is not None:
            return polynomial
    return None


def sample_rate_hz(channel: Channel, mapping: TdmsMapping) -> float:
    """Return the sample rate in Hz: the mapping's, else the reciprocal of the increment property (s).

    A rate within 1e-12 (relative) of a whole number of hertz is rounded to it.

    Raises
    ------
    ConfigurationError
        Neither is there, or the increment is no positive number.
    """
    if mapping.sample_rate_hz is not None:
        return mapping.sample_rate_hz
    increment_s = channel.read_float(mapping.increment_property)
    if increment_s is None:
        raise channel.build_error(
            f"no sample rate ({mapping.increment_property} is missing)", "give sample_rate_hz"
        )
    if not increment_s > 0.0:
        raise channel.build_error(
            f"{mapping.increment_property} is {increment_s} s; it must be positive", "give sample_rate_hz"
        )
    rate_hz = 1.0 / increment_s
    # The reciprocal of a rounded reciprocal is off by a few last bits (2e-16): rates are whole hertz.
    return float(round(rate_hz)) if abs(rate_hz - round(rate_hz)) < 1e-12 * rate_hz else rate_hz


def pretrigger_samples(
    channel: Channel, mapping: TdmsMapping, *, rate_hz: float, record_samples: int, method: str
) -> int:
    """Return the number of samples before the trigger: the mapping's, else from the start offset.

    It is 0 for pulse-echo records (``method``), which start at the firing pulse.

    Parameters
    ----------
    rate_hz, record_samples
        Sample rate, and length of the record.

    Raises
    ------
    ConfigurationError
        The file does not show where the trigger is, it is outside the record, or a pulse-echo record has a
        start offset.
    """
    name = mapping.start_offset_property
    if method == PULSE_ECHO:
        if channel.read_float(name):
            raise channel.build_error(
                f"{name} is {channel.read_float(name)} s, yet a pulse-echo record starts at the firing pulse",
                "write it from the pulse on",
            )
        return 0
    samples = mapping.pretrigger_samples
    if samples is None:
        offset_s = channel.read_float(name)
        if offset_s is None or offset_s >= 0.0:
            problem = f"{name} is missing" if offset_s is None else f"{name} is {offset_s} s"
            raise channel.build_error(
                f"the position of the trigger is unknown: {problem}, a pre-trigger needs a negative one",
                "give pretrigger_samples",
            )
        samples = round(-offset_s * rate_hz)
    if samples >= record_samples:
        raise channel.build_error(
            f"the trigger at sample {samples} is outside the record of {record_samples} samples",
            "give pretrigger_samples",
        )
    return samples


def read_start_utc_ns(channel: Channel, mapping: TdmsMapping) -> int | None:
    """Return UTC of the channel's first record in ns since 1970, rounded; None if the file has no time.

    Raise ConfigurationError if the property is no time stamp.
    """
    stamp = channel.properties.get(mapping.start_time_property)
    if stamp is None:
        return None
    try:
        seconds, fractions = int(stamp.seconds), int(stamp.second_fractions)
    except AttributeError as error:
        raise channel.build_error(
            f"{mapping.start_time_property} is {stamp!r}, no time stamp", "give another start_time_property"
        ) from error
    # Fractions are 2^-64 s; half is added to round to the nearest nanosecond.
    return (seconds + _TDMS_EPOCH_S) * NS_PER_S + ((fractions * NS_PER_S + (1 << 63)) >> 64)
