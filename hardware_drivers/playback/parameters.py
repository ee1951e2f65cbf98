"""Parameters of a playback: the folder of the shots, and the mapping of LabVIEW's names to them."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import field
from pathlib import Path
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le

from hardware_drivers.bounds import bounded

KEY_PARTS = ("position", "set", "shot", "attempt")
"""Named groups that the patterns may have: together they say which shot a record is."""


@bounded
class TdmsMapping:
    """Mapping from files, groups, channels and properties of LabVIEW TDMS files to shots.

    Position, set, shot and attempt are named groups of the three patterns (Python regular expressions
    that must match the whole name) or properties; each comes from one place at most. Names that do
    not match are left out. A set, shot or attempt that no place names is 0.
    """

    files: str = "**/*.tdms"
    """Files looked at, a glob below the source folder (a source that is one file needs none)."""
    file_pattern: str = r".*set_(?P<set>\d+)\.tdms"
    """Matched with the file's path below the source folder, with forward slashes."""
    group_pattern: str = r"(?P<position>[A-Za-z0-9]+)"
    """Matched with the group's name."""
    channel_pattern: str = r"shot_(?P<shot>\d+)"
    """Matched with the channel's name."""
    position_property: str = ""
    """Property that names the position, of the channel, else its group, else the file; empty: none."""
    set_property: str = ""
    """Property that counts the sets; empty: none."""
    shot_property: str = ""
    """Property that counts the shots of a set; empty: none."""
    position: str = ""
    """Position of every record, where the files do not name it."""
    rename: Mapping[str, str] = field(default_factory=dict)
    """Name in the files to position, for example `{ ai0 = "B" }`; other names stay as they are."""
    first_set: Annotated[int, Ge(0)] = 0
    """Number of the first set in the files: LabVIEW users often count from 1."""
    first_shot: Annotated[int, Ge(0)] = 0
    """Number of the first shot of a set in the files."""
    appended: bool = False
    """A channel holds several records one after the other, shot by shot, as a loop of writes leaves them."""
    record_samples: Annotated[int, Gt(0)] | None = None
    """Samples of an appended record; absent: `wf_samples` of the channel."""
    shot_interval_s: Annotated[float, Gt(0.0), Le(3600.0)] = 4.0
    """Seconds between appended records: their channel has one start time only (paper: 0.25 Hz)."""
    pulse_echo_positions: tuple[str, ...] = ()
    """Positions (as renamed) whose records are pulse-echo records."""
    gain_db: Annotated[float, Ge(-200.0), Le(200.0)] = 0.0
    """Receiver gain of the pulse-echo records."""
    averages: Annotated[int, Ge(1)] = 1
    """Records averaged in a pulse-echo record."""
    increment_property: str = "wf_increment"
    """Seconds between two samples."""
    start_offset_property: str = "wf_start_offset"
    """Time of the first sample from the trigger in s: negative where the record has a pre-trigger."""
    start_time_property: str = "wf_start_time"
    """UTC of the record."""
    samples_property: str = "wf_samples"
    """Samples of one write."""
    unit_property: str = "unit_string"
    """Unit of the scaled values: V unless `volts_per_unit` is given."""
    settings_properties: Mapping[str, str] = field(default_factory=dict)
    """Property to the name it is stored under with the shot, for example `{ Serial = "board_serial" }`."""
    sample_rate_hz: Annotated[float, Gt(0.0), Le(1e12)] | None = None
    """Sample rate of every record; absent: that of its file."""
    pretrigger_samples: Annotated[int, Ge(0)] | None = None
    """Samples before the trigger; absent: from the start offset of the file."""
    coefficients_v: tuple[float, ...] = ()
    """Volts as a polynomial of the raw values, constant first; empty: the NI scaling of the file."""
    volts_per_unit: float | None = None
    """Volts in one unit of the scaled values, where that unit is missing or not V."""
    range_v: Annotated[float, Gt(0.0), Le(1e6)] | None = None
    """Full scale. Absent: of raw values what the ADC's extreme codes mean; of scaled ones 10 V."""
    resolution_bits: Annotated[int, Ge(2), Le(32)] | None = None
    """ADC resolution of raw values (a 12-bit board clips at 2047 of an int16); absent: that of their type."""

    def __post_init__(self) -> None:
        """Raise ValueError if a part of the key has two sources, the position none, or a pattern is invalid.

        Also for appended records whose shot is named, a single or non-finite coefficient, and
        ``volts_per_unit`` of 0.
        """
        sources = [
            (f"{part}_property", {part}) for part in KEY_PARTS[:3] if getattr(self, f"{part}_property")
        ]
        for name in ("file_pattern", "group_pattern", "channel_pattern"):
            sources.append((name, _list_named_groups(name, getattr(self, name))))
        if self.position:
            sources.append(("position", {"position"}))
        for part in KEY_PARTS:
            places = [name for name, parts in sources if part in parts]
            if len(places) > 1:
                raise ValueError(f"{' and '.join(places)} both name the {part}; keep one of them")
        if not any("position" in parts for _, parts in sources):
            raise ValueError(
                "nothing names the position; give a pattern with (?P<position>...), position_property, "
                "or position"
            )
        if self.appended and any("shot" in parts for _, parts in sources):
            raise ValueError("appended records are counted as shots; take (?P<shot>...) out of the patterns")
        if len(self.coefficients_v) == 1 or not all(map(math.isfinite, self.coefficients_v)):
            raise ValueError(f"coefficients_v is {self.coefficients_v}; it needs two finite numbers or more")
        if self.volts_per_unit == 0.0:
            raise ValueError("volts_per_unit is 0.0; it must be finite and not 0")


@bounded
class PlaybackParameters:
    """Recording that replaces the instruments."""

    source: Path
    """Archive: a data folder. TDMS: a folder of files, or one file. Relative to the configuration file."""
    format: Literal["archive", "tdms"] = "archive"
    """`archive`: solimon's own sets; `tdms`: LabVIEW files (needs the extra `solimon[tdms]`)."""
    tdms: TdmsMapping | None = None
    """How LabVIEW's names lead to shots; absent with `format = "tdms"`: the defaults of its keys."""

    def __post_init__(self) -> None:
        """Raise ValueError if the table ``tdms`` is given for another format."""
        if self.format != "tdms" and self.tdms is not None:
            raise ValueError(
                f'format is "{self.format}", yet [tdms] is given; set format = "tdms" or take it out'
            )


def _list_named_groups(name: str, pattern: str) -> set[str]:
    """Return the named groups of a regular expression; empty if it has none.

    Raise ValueError, with the key ``name``, for no regular expression or a group that is not in `KEY_PARTS`.
    """
    try:
        parts = set(re.compile(pattern).groupindex)
    except re.error as error:
        raise ValueError(f"{name} is {pattern!r}, no regular expression: {error}") from error
    if unknown := parts - set(KEY_PARTS):
        raise ValueError(
            f"{name} has the named group {sorted(unknown)[0]!r}; there are: {', '.join(KEY_PARTS)}"
        )
    return parts
