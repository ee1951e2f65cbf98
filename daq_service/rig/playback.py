"""A recording as the instruments of a rig: a data folder of our own, or LabVIEW TDMS files.

`hardware_drivers.playback` plays back any source of shots and knows no archive; here an archive becomes
one.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol

from daq_service.archive import (
    CorruptArchiveError,
    FolderSetReader,
    SetReader,
    SetRecord,
    SetReference,
    parse_due_utc_ns,
)
from daq_service.archive.errors import ArchiveError
from daq_service.errors import UsageError
from hardware_drivers.errors import AcquisitionTimeoutError, ConfigurationError
from hardware_drivers.instruments import Acquired, Clock
from hardware_drivers.kinds import Finding, Kind, Opened, Opening
from hardware_drivers.measurement import SetKey, ShotKey
from hardware_drivers.methods import PULSE_ECHO, SOLITARY_WAVE
from hardware_drivers.nanoseconds import NS_PER_H
from hardware_drivers.playback.clock import RecordedClock
from hardware_drivers.playback.instruments import build_instruments
from hardware_drivers.playback.parameters import PlaybackParameters
from hardware_drivers.playback.source import Record, ShotsBySet, ShotSource


class Recorded(ShotSource, Protocol):
    """A source that knows when its shots were recorded."""

    def find_next_moment(self, after_utc_ns: int) -> int | None:
        """Return the first recorded time after a time, ns since 1970 (UTC); None after the last one."""
        ...


class ArchivedShots:
    """The sets of an archive as a source of shots, read set by set when they are asked for.

    A damaged record is a missed strike whose cause names the damage; the others of its set are played.

    Parameters
    ----------
    archive
        Of a data folder, or of a copy of one: only ``sets/`` is needed.

    Raises
    ------
    UsageError
        No set there can be read.
    """

    def __init__(self, archive: SetReader) -> None:
        self._archive = archive
        self._files = archive.sets()
        if not self._files:
            raise UsageError(
                f"{archive.name} holds no sets; give the data folder of a test (the one that holds sets/)"
            )
        self._due_utc_ns = [parse_due_utc_ns(file) for file in self._files.values()]
        self._damaged: dict[SetKey, str] = {}
        self._missed: set[ShotKey] = set()
        first = self._find_first_readable_set()
        self.rig_kind = first.rig_kind
        self.epoch_utc_ns = first.due_utc_ns - round(first.due_h * NS_PER_H)
        self.configuration: dict[str, Any] = first.provenance.get("configuration", {})
        self.configuration_hash = str(first.provenance.get("configuration_hash", ""))
        self._shots = ShotsBySet(_find_positions(first), self._read_set_records)
        self._moments: dict[SetKey, list[int]] = {}

    @property
    def positions(self) -> Mapping[str, str]:
        """Return the recorded positions and their method (``solitary_wave`` or ``pulse_echo``)."""
        return self._shots.positions

    def find(self, key: ShotKey) -> Acquired | None:
        """Return the record of a shot, None if it was not recorded; the first request reads the complete set.

        Raises
        ------
        AcquisitionTimeoutError
            Its record, or the file of its set, is corrupt.
        ConfigurationError
            Its file cannot be opened.
        """
        found = self._shots.find(key)
        if found is None and key.set_key in self._damaged:
            raise AcquisitionTimeoutError(
                f"shot {key.shot_index} of set {key.set_key} at {key.position!r} cannot be played back: "
                f"{self._damaged[key.set_key]}"
            )
        return found

    def has_attempt(self, key: ShotKey) -> bool:
        """Return whether a shot was recorded or missed; of a corrupt set only recorded shots are known.

        Raises ConfigurationError if the file of its set cannot be opened.
        """
        recorded = self._shots.has_attempt(key)
        return recorded or (key in self._missed and key.set_key not in self._damaged)

    def find_next_moment(self, after_utc_ns: int) -> int | None:
        """Return the first recorded time after a time, ns since 1970 (UTC); None after the last one.

        A recorded time is the start of a set or the time stamp of a record; sets are read as needed. Raises
        ConfigurationError if a set file cannot be opened.
        """
        # A set may last into the next one's time, but not into that of the one after it.
        first = max(0, bisect_right(self._due_utc_ns, after_utc_ns) - 2)
        for set_key in islice(self._files, first, None):
            moments = self._list_record_times(set_key)
            if moments and moments[-1] > after_utc_ns:
                return next(moment for moment in moments if moment > after_utc_ns)
        return None

    def _list_record_times(self, set_key: SetKey) -> list[int]:
        """Return the start of a set and the time stamps of its records, ns since 1970, ascending; cached.

        Empty if the set is completely corrupt. Raises ConfigurationError if its file cannot be opened.
        """
        if set_key not in self._moments:
            self._shots.records_of_set(set_key)
        return self._moments[set_key]

    def _find_first_readable_set(self) -> SetRecord:
        """Read and return the first set that can be read, without its corrupt records.

        Raises UsageError if no set can be read.
        """
        for file in self._files.values():
            try:
                return self._archive.read_set(file, skip_damaged=True)
            except ArchiveError:
                continue
        raise UsageError(
            f"none of the {len(self._files)} sets of {self._archive.name} can be read; see `solimon verify`"
        )

    def _read_set_records(self, set_key: SetKey) -> Iterable[Record]:
        """Return the intact records of a set; store its times, missed shots and a description of corruption.

        Empty if the file is missing or completely corrupt. Raises ConfigurationError if it cannot be opened.
        """
        file = self._files.get(set_key)
        if file is None:
            return ()
        try:
            record = self._read_intact_records(set_key, file)
        except CorruptArchiveError as error:
            self._damaged[set_key] = str(error)
            self._moments[set_key] = []
            return ()
        except ArchiveError as error:
            raise ConfigurationError(f"the recording cannot be read: {error}") from error
        self._missed |= {item.key for item in record.missed}
        self._moments[set_key] = sorted(
            {record.started_utc_ns, *(item.stamp.utc_ns for item in record.records)}
        )
        return record.records

    def _read_intact_records(self, set_key: SetKey, file: SetReference) -> SetRecord:
        """Read a set; of a corrupt one keep the intact records and store a description of the corruption.

        Raises CorruptArchiveError if not even these can be read, and another ArchiveError if the file cannot
        be opened.
        """
        try:
            return self._archive.read_set(file)
        except CorruptArchiveError:
            left = self._archive.read_set(file, skip_damaged=True)
            damages = "; ".join(map(str, self._archive.verify_set(file)))
            self._damaged[set_key] = f"{self._archive.name}/{file}: {damages}"
            return left


def _find_positions(record: SetRecord) -> dict[str, str]:
    """Return the method of each position: that of the set, else that of its stored configuration."""
    configured = record.provenance.get("configuration", {}).get("positions", {})
    return {
        **{name: place["method"] for name, place in configured.items()},
        **{place.position: place.method for place in record.positions},
    }


@contextmanager
def open_recording(
    parameters: PlaybackParameters, folder: Path, wanted: Mapping[str, str] = MappingProxyType({})
) -> Iterator[Recorded]:
    """Open a recording as a source of shots within a context; on exit TDMS files are closed.

    A relative path counts from ``folder``.

    Parameters
    ----------
    wanted
        Positions that will be requested and their method; used for TDMS files only.

    Raises
    ------
    UsageError
        The recording cannot be played back: the cause and the remedy.
    """
    source = folder / parameters.source
    if parameters.format == "archive":
        yield ArchivedShots(FolderSetReader(source))
        return
    from hardware_drivers.playback.tdms import open_tdms

    try:
        shots = open_tdms(source, parameters.tdms, positions=wanted)
    except ConfigurationError as error:
        raise UsageError(f"the recording cannot be played back: {error}") from error
    with shots:
        yield shots


def build_playback_instruments(
    source: Recorded,
    clock: Clock,
    *,
    wanted: Mapping[str, str],
    identity: Mapping[str, str],
    recorded_times: bool,
    shot_interval_s: float,
) -> Opened:
    """Build the instruments that play back a recording and, on request, the clock of its recorded times.

    Parameters
    ----------
    clock
        The experiment's clock. A simulated one that starts at the recording's epoch plays a simulated
        recording to the same stamps.
    wanted
        Positions of the experiment and their method.
    identity
        Description of the recording's origin, stored with every set.
    recorded_times
        Let the clock meet the recorded times rather than the planned ones (needs a simulated clock).
    shot_interval_s
        Between two strikes: half of it is how much later than planned a shot may have been recorded.

    Raises
    ------
    UsageError
        A wanted position was not recorded.
    """
    try:
        instruments = build_instruments(source, wanted=wanted)
    except ConfigurationError as error:
        raise UsageError(f"the recording does not fit the configuration: {error}") from error
    recorded = RecordedClock(clock, source.find_next_moment, tolerance_s=shot_interval_s / 2.0)
    return Opened(
        clock=recorded if recorded_times else None,
        striker=instruments.striker,
        digitizer=instruments.digitizer,
        pulse_echo=instruments.pulse_echo,
        identity=identity,
    )


@contextmanager
def _open_playback(parameters: PlaybackParameters, opening: Opening) -> Iterator[Opened]:
    """Open a recording as an instrument; a relative path counts from the current folder.

    Raises UsageError if it cannot be played back or lacks a served position.
    """
    wanted = {
        **dict.fromkeys(opening.serves.get("digitizer", ()), SOLITARY_WAVE),
        **dict.fromkeys(opening.serves.get("pulse_echo", ()), PULSE_ECHO),
    }
    with open_recording(parameters, Path.cwd(), wanted) as source:
        yield build_playback_instruments(
            source,
            opening.clock,
            wanted=wanted,
            identity={"recording": str(parameters.source)},
            recorded_times=opening.experiment["clock"]["kind"] == "simulated",
            shot_interval_s=opening.shot_interval_s,
        )


def _check_boards(parameters: PlaybackParameters, opening: Opening) -> Iterator[Finding]:
    """Yield the only finding of a playback: state ``ok``, because there are no boards to check."""
    yield Finding(subject="rig", check="", state="ok", detail="playback: no boards to check")


def _list_packages(parameters: PlaybackParameters) -> tuple[str, ...]:
    """Return the packages that are needed to read the recording: npTDMS for TDMS, none for a data folder."""
    return ("npTDMS",) if parameters.format == "tdms" else ()


KIND = Kind(parameters=PlaybackParameters, open=_open_playback, check=_check_boards, packages=_list_packages)
