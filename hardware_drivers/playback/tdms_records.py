"""Raw records of a LabVIEW file, independent of the names of its groups and channels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware_drivers.methods import SOLITARY_WAVE
from hardware_drivers.playback.parameters import TdmsMapping
from hardware_drivers.playback.tdms_channel import (
    Channel,
    Conversion,
    build_conversion,
    pretrigger_samples,
    sample_rate_hz,
)
from hardware_drivers.playback.tdms_file import ValuesReader, read_channels, require_nptdms
from hardware_drivers.playback.tdms_key import count_record_samples


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChannelRecords:
    """Records of one channel, consecutive as a loop of writes leaves them.

    Attributes
    ----------
    conversion
        From values to counts or, of scaled values, to volts (`volts`).
    """

    channel: Channel
    n: int
    samples: int
    sample_rate_hz: float
    pretrigger_samples: int
    conversion: Conversion

    def values(self) -> Iterator[NDArray[Any]]:
        """Yield each record's unscaled values in file order, shape (samples,); the file is closed at the end.

        Raise ConfigurationError if the file is gone or damaged.
        """
        reader = ValuesReader()
        try:
            for number in range(self.n):
                first = number * self.samples
                found = self.channel
                yield reader.read(found.path, found.group, found.name, first, self.samples)
        finally:
            reader.close()

    def volts(self, values: NDArray[Any]) -> NDArray[np.float64]:
        """Convert values that `values` yields into volts (float64, same shape)."""
        if self.conversion.polynomial is None:
            return self.conversion.calibration.volts(values)
        return np.asarray(
            np.polynomial.polynomial.polyval(values.astype(np.float64), self.conversion.polynomial)
        )


def list_channel_records(
    path: Path,
    mapping: TdmsMapping,
    *,
    pretrigger_s: float | None,
    rails_marked: bool,
    unitless_are_volts: bool = False,
) -> list[ChannelRecords]:
    """List the records of each channel with numeric values in a file, in file order; read no samples.

    Parameters
    ----------
    pretrigger_s
        Length of the pre-trigger in s, in place of the file's; None: as in the file.
    rails_marked
        Clipping is detected elsewhere: 32-bit codes need no known resolution.
    unitless_are_volts
        Scaled values without a unit are volts.

    Raises
    ------
    ConfigurationError
        npTDMS is missing; the file is damaged; a channel lacks rate, trigger, scaling or unit.
    """
    require_nptdms()
    found = []
    for channel in read_channels(path, lambda *_: True):
        if channel.dtype.kind not in "fiu":
            continue
        own = mapping
        if rails_marked and channel.dtype == np.int32:
            own = replace(own, resolution_bits=32)
        unit = str(channel.properties.get(mapping.unit_property, "")).strip()
        if unitless_are_volts and channel.dtype.kind == "f" and not unit:
            own = replace(own, volts_per_unit=1.0)
        written = channel.read_float(mapping.samples_property)
        # DAQmx logs a whole record with wf_samples of 1.
        if written is not None and 1 < written < channel.n_samples:
            own = replace(own, appended=True, channel_pattern=".*")
        rate_hz = sample_rate_hz(channel, own)
        if pretrigger_s is not None:
            own = replace(own, pretrigger_samples=round(pretrigger_s * rate_hz))
        samples = count_record_samples(channel, own)
        found.append(
            ChannelRecords(
                channel=channel,
                n=channel.n_samples // samples,
                samples=samples,
                sample_rate_hz=rate_hz,
                pretrigger_samples=pretrigger_samples(
                    channel, own, rate_hz=rate_hz, record_samples=samples, method=SOLITARY_WAVE
                ),
                conversion=build_conversion(channel, own),
            )
        )
    return found
