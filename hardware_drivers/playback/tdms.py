"""LabVIEW TDMS files as a source of recorded shots.

Opening reads the metadata of every file and finds out which shot each record is; samples are read when a
shot is asked for. Whole numbers with NI scaling are counts and their polynomial the calibration, to the
last bit. Values already scaled (SGL, DBL) become 32-bit codes of a fixed range, off by less than 1e-9 of
it, and the shot's settings say ``quantised_from``.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from hardware_drivers.errors import ConfigurationError
from hardware_drivers.instruments import Acquired, Echo
from hardware_drivers.measurement import ShotKey, Waveform
from hardware_drivers.methods import PULSE_ECHO, SOLITARY_WAVE
from hardware_drivers.nanoseconds import NS_PER_S
from hardware_drivers.playback.parameters import TdmsMapping
from hardware_drivers.playback.tdms_by_name import find_shots_by_name, is_mapped_by_name
from hardware_drivers.playback.tdms_channel import (
    Channel,
    Conversion,
    build_conversion,
    pretrigger_samples,
    read_start_utc_ns,
    sample_rate_hz,
)
from hardware_drivers.playback.tdms_file import ValuesReader, read_channels, require_nptdms
from hardware_drivers.playback.tdms_key import build_shot_key, count_record_samples

_NAMES_SHOWN = 5
"""Of names that did not match, in the message that nothing matched."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _RecordLocation:
    """Location of a record, and its conversion to a waveform."""

    path: Path
    group: str
    channel: str
    first_sample: int
    n_samples: int
    sample_rate_hz: float
    pretrigger_samples: int
    conversion: Conversion
    settings: Mapping[str, float | str]
    utc_ns: int | None

    def __str__(self) -> str:
        """Return file, group and channel as text, the beginning of a message."""
        return f"{self.path}, group {self.group!r}, channel {self.channel!r}"


class TdmsShots:
    """Opened recording; `close` it, or use it as a context manager.

    Made by `open_tdms`. One file is kept open at a time.

    Attributes
    ----------
    places
        Location of each recorded shot.
    """

    def __init__(self, places: Mapping[ShotKey, _RecordLocation], mapping: TdmsMapping) -> None:
        """Collect positions and recorded times from the locations; no file is opened here."""
        self.places = places
        self._mapping = mapping
        self._positions = {key.position: _find_method(key.position, mapping) for key in places}
        self._moments = sorted(place.utc_ns for place in places.values() if place.utc_ns is not None)
        self._reader = ValuesReader()

    @property
    def positions(self) -> Mapping[str, str]:
        """Return the recorded positions and their method: ``solitary_wave`` or ``pulse_echo``."""
        return self._positions

    def find_next_moment(self, after_utc_ns: int) -> int | None:
        """Return the first recorded time after ``after_utc_ns`` (both UTC in ns); None after the last one.

        Records without a start time are not considered.
        """
        index = bisect_right(self._moments, after_utc_ns)
        return self._moments[index] if index < len(self._moments) else None

    def has_attempt(self, key: ShotKey) -> bool:
        """Return whether the files have a record of this attempt at a shot."""
        return key in self.places

    def find(self, key: ShotKey) -> Acquired | None:
        """Read the record of a shot from its file, and convert it to counts; None if it was not recorded.

        The file is kept open.

        Raises
        ------
        ConfigurationError
            The file cannot be read any more or has changed, or a value is not finite or beyond the range.
        """
        place = self.places.get(key)
        if place is None:
            return None
        values = self._reader.read(
            place.path, place.group, place.channel, place.first_sample, place.n_samples
        )
        if len(values) != place.n_samples:
            raise ConfigurationError(
                f"{place}: {len(values)} of {place.n_samples} samples are left; the file was changed while "
                "it was played back: open the recording again"
            )
        waveform = Waveform(
            counts=place.conversion.convert_to_counts(values, str(place)),
            sample_rate_hz=place.sample_rate_hz,
            pretrigger_samples=place.pretrigger_samples,
            calibration=place.conversion.calibration,
        )
        if self._positions[key.position] == PULSE_ECHO:
            return Echo(
                waveform=waveform,
                settings=place.settings,
                gain_db=self._mapping.gain_db,
                averages=self._mapping.averages,
            )
        return Acquired(waveform=waveform, settings=place.settings)

    def close(self) -> None:
        """Close the file that is open; a later `find` opens it again."""
        self._reader.close()

    def __enter__(self) -> TdmsShots:
        """Return the recording itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the file that is open, if any."""
        self.close()


def open_tdms(
    source: Path, mapping: TdmsMapping | None = None, *, positions: Mapping[str, str] = MappingProxyType({})
) -> TdmsShots:
    """Find every shot in a folder of TDMS files, or in one file, by their metadata; read no samples.

    Parameters
    ----------
    positions
        Positions that will be used, and their method. Unless the mapping identifies shots otherwise, files
        with all channels in one group are played by the channels' names.

    Raises
    ------
    ConfigurationError
        npTDMS is missing; no file, or no record that the patterns match; a file is damaged; a record lacks
        rate, trigger, scaling or unit; two records are the same shot. Names file, group, channel, remedy.
    """
    mapping = mapping or TdmsMapping()
    require_nptdms()
    by_name = tuple(positions) if is_mapped_by_name(mapping) else ()
    if by_name and not mapping.pulse_echo_positions:
        probes = tuple(name for name, method in positions.items() if method == PULSE_ECHO)
        mapping = replace(mapping, pulse_echo_positions=probes)
    if by_name and source.is_file() and re.fullmatch(mapping.file_pattern, source.name) is None:
        mapping = replace(mapping, file_pattern=".*")  # one file alone is set 0
    places: dict[ShotKey, _RecordLocation] = {}
    shared: dict[tuple[object, ...], Conversion] = {}
    others: list[str] = []
    for path, name in _find_files(source, mapping):
        for key, place in _find_file_records(path, name, mapping, shared, others, by_name):
            if key in places:
                raise ConfigurationError(
                    f"{place} and {places[key]} are both shot {key.shot_index} of set {key.set_index} at "
                    f"{key.position!r}; use patterns that distinguish them"
                )
            places[key] = place
    if not places:
        nor = f", nor one group with channels named after {', '.join(by_name)}" if by_name else ""
        raise ConfigurationError(
            f"{source} has no record that matches file_pattern {mapping.file_pattern!r}, group_pattern "
            f"{mapping.group_pattern!r} and channel_pattern {mapping.channel_pattern!r}{nor}; correct the "
            f"patterns; names found: {', '.join(others[:_NAMES_SHOWN]) or 'none'}"
        )
    return TdmsShots(places, mapping)


def _find_files(source: Path, mapping: TdmsMapping) -> list[tuple[Path, str]]:
    """Return the files of the source, sorted, each with the name that `file_pattern` is matched with.

    The name is the path relative to the folder, with forward slashes. Raise ConfigurationError without a
    source, or for a folder without a matching file.
    """
    if source.is_file():
        return [(source, source.name)]
    if not source.is_dir():
        raise ConfigurationError(f"there is no TDMS file or folder {source}; correct source")
    found = sorted(path for path in source.glob(mapping.files) if path.is_file())
    if not found:
        raise ConfigurationError(f"{source} has no file {mapping.files!r}; correct source, or files")
    return [(path, path.relative_to(source).as_posix()) for path in found]


def _find_file_records(
    path: Path,
    name: str,
    mapping: TdmsMapping,
    shared: dict[tuple[object, ...], Conversion],
    others: list[str],
    by_name: Sequence[str],
) -> Iterator[tuple[ShotKey, _RecordLocation]]:
    """Yield key and location of each record of the matching channels in one file; read no samples.

    Channels are matched by the patterns, else by the positions ``by_name``. Names that do not match are
    appended to ``others``, conversions added to ``shared``. Raise ConfigurationError for a damaged file,
    incomplete metadata or ambiguous names.
    """
    from_file = re.fullmatch(mapping.file_pattern, name)
    if from_file is None:
        others.append(name)
        return
    matched: dict[tuple[str, str], Mapping[str, str | None]] = {}
    unmatched: list[tuple[str, str]] = []

    def is_wanted(group: str, channel: str) -> bool:
        """Return whether the names of group and channel match their patterns.

        The texts of the named groups are stored in `matched`, names that do not match in `unmatched`.
        """
        from_group = re.fullmatch(mapping.group_pattern, group)
        from_channel = re.fullmatch(mapping.channel_pattern, channel)
        if from_group is None or from_channel is None:
            unmatched.append((group, channel))
            return False
        matched[group, channel] = {
            **from_file.groupdict(),
            **from_group.groupdict(),
            **from_channel.groupdict(),
        }
        return True

    channels = read_channels(path, is_wanted)
    if not matched and by_name:
        named = find_shots_by_name(unmatched, by_name, mapping, name)
        matched |= {place: {**from_file.groupdict(), **parts} for place, parts in named.items()}
        channels = read_channels(path, lambda group, channel: (group, channel) in matched)
    others += [f"{name}/{group}/{channel}" for group, channel in unmatched if (group, channel) not in matched]
    for channel in channels:
        key = build_shot_key(channel, matched[channel.group, channel.name], mapping)
        place = _find_first_location(
            channel, f"{name}/{channel.group}/{channel.name}", key.position, mapping, shared
        )
        yield from _yield_appended_records(key, place, channel.n_samples, mapping)


def _find_first_location(
    channel: Channel,
    name: str,
    position: str,
    mapping: TdmsMapping,
    shared: dict[tuple[object, ...], Conversion],
) -> _RecordLocation:
    """Return location and conversion of a channel's first record; reuse an equal conversion in ``shared``.

    ``name`` is stored with its shots. Raise ConfigurationError where rate, trigger, scaling or a settings
    property is missing or wrong.
    """
    n_samples = count_record_samples(channel, mapping)
    rate_hz = sample_rate_hz(channel, mapping)
    conversion = _reuse_conversion(build_conversion(channel, mapping), shared)
    return _RecordLocation(
        path=channel.path,
        group=channel.group,
        channel=channel.name,
        first_sample=0,
        n_samples=n_samples,
        sample_rate_hz=rate_hz,
        pretrigger_samples=pretrigger_samples(
            channel,
            mapping,
            rate_hz=rate_hz,
            record_samples=n_samples,
            method=_find_method(position, mapping),
        ),
        conversion=conversion,
        settings=_collect_settings(channel, name, mapping, conversion),
        utc_ns=read_start_utc_ns(channel, mapping),
    )


def _yield_appended_records(
    key: ShotKey, place: _RecordLocation, n_samples: int, mapping: TdmsMapping
) -> Iterator[tuple[ShotKey, _RecordLocation]]:
    """Yield key and location of a channel's first record and of those appended to it, in file order.

    ``key`` and ``place`` are those of the first one, ``n_samples`` all samples of the channel. The shot index
    rises by 1 for each, the time by ``shot_interval_s`` (None if the file has no time).
    """
    for number in range(n_samples // place.n_samples):
        later_ns = round(number * mapping.shot_interval_s * NS_PER_S)
        yield (
            replace(key, shot_index=key.shot_index + number),
            replace(
                place,
                first_sample=number * place.n_samples,
                utc_ns=None if place.utc_ns is None else place.utc_ns + later_ns,
            ),
        )


def _reuse_conversion(conversion: Conversion, known: dict[tuple[object, ...], Conversion]) -> Conversion:
    """Return the conversion in ``known`` that equals this one; if none does, add this one and return it.

    It saves memory: a recording has thousands of channels.
    """
    calibration = conversion.calibration
    polynomial = None if conversion.polynomial is None else conversion.polynomial.tobytes()
    key = (
        calibration.coefficients_v.tobytes(),
        calibration.resolution_bits,
        calibration.range_v,
        polynomial,
    )
    return known.setdefault(key, conversion)


def _collect_settings(
    channel: Channel, name: str, mapping: TdmsMapping, conversion: Conversion
) -> Mapping[str, float | str]:
    """Collect the settings that are stored with each shot of a channel, by name.

    They are ``tdms_channel``, the properties of ``settings_properties`` and, for quantised values, their type
    and step in V. Raise ConfigurationError if such a property is missing.
    """
    settings: dict[str, float | str] = {"tdms_channel": name}
    properties = channel.properties
    for property_name, setting in mapping.settings_properties.items():
        if property_name not in properties:
            raise channel.build_error(
                f"the property {property_name!r} is missing", "take it out of settings_properties"
            )
        value = properties[property_name]
        settings[setting] = float(value) if isinstance(value, (int, float, np.number)) else str(value)
    if conversion.polynomial is not None:
        settings["quantised_from"] = str(channel.dtype)
        settings["quantisation_step_v"] = float(conversion.calibration.coefficients_v[1])
    return settings


def _find_method(position: str, mapping: TdmsMapping) -> str:
    """Return ``pulse_echo`` if the mapping lists the position as such, else ``solitary_wave``."""
    return PULSE_ECHO if position in mapping.pulse_echo_positions else SOLITARY_WAVE
