"""Propose patterns for LabVIEW TDMS files from the names of their files, groups and channels."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from hardware_drivers.errors import ConfigurationError
from hardware_drivers.playback.parameters import TdmsMapping
from hardware_drivers.playback.tdms_file import read_channels, require_nptdms

_SHOT = r"(?P<shot>\d+)"
_WORDS = ("shot", "strike")
"""Words before the number of a shot, also without a separator."""


def propose_mapping(source: Path, mapping: TdmsMapping) -> TdmsMapping:
    """Propose a mapping for a folder of TDMS files, or one file; the channels of the first file are read.

    A set has the last number in the files' names that differs, a shot the number at the end of its channel's
    name. The position is the rest of that name, or the group's name.

    Parameters
    ----------
    mapping
        Its ``files`` are looked at; keys other than the patterns are kept.

    Raises
    ------
    ConfigurationError
        npTDMS is missing, no file is found, or the first one cannot be read or has no values.
    """
    require_nptdms()
    paths = [source] if source.is_file() else sorted(source.glob(mapping.files))
    if not paths:
        raise ConfigurationError(f"{source} has no file {mapping.files!r}; give another folder or pattern")
    channels = read_channels(paths[0], lambda group, channel: True)
    if not channels:
        raise ConfigurationError(f"{paths[0]} has no channel with values; give other files")
    names = [channel.name for channel in channels]
    prefixes = _find_prefixes(names)
    prefix, several_groups = next(iter(prefixes), ""), len({channel.group for channel in channels}) > 1
    group_pattern, channel_pattern = ".*", "(?P<position>.+)"
    if len(prefixes) > 1:
        channel_pattern = rf"(?P<position>.+?)(?i:[ _.-]*(?:{'|'.join(_WORDS)})?[ _.-]*){_SHOT}"
    elif prefixes and (several_groups or not prefix[-1:].isalpha() or prefix.lower() in _WORDS):
        group_pattern, channel_pattern = channel_pattern, _escape(prefix) + _SHOT
    numbered = "<shot>" in channel_pattern
    file_pattern, first_set = _propose_file_pattern(
        [path.relative_to(source).as_posix() if path != source else path.name for path in paths]
    )
    samples = channels[0].read_float(mapping.samples_property)
    return replace(
        mapping,
        file_pattern=file_pattern,
        group_pattern=group_pattern,
        channel_pattern=channel_pattern,
        first_set=first_set,
        first_shot=min(int(re.findall(r"\d+", name)[-1]) for name in names) if numbered else 0,
        appended=not numbered and samples is not None and channels[0].n_samples > samples,
    )


def _find_prefixes(names: Iterable[str]) -> set[str]:
    """Return the texts before the number that each name ends in; empty if one ends in no number."""
    matches = [re.fullmatch(r"(.*?)\d+", name) for name in names]
    return set() if None in matches else {match[1] for match in matches if match is not None}


def _propose_file_pattern(names: Sequence[str]) -> tuple[str, int]:
    """Return a pattern for the most frequent form of names, and its lowest set number.

    Numbers that are equal in all of these names are part of the pattern. One name alone is set 0.
    """
    parts = [re.split(r"(\d+)", name) for name in names]
    form, _ = Counter(tuple(part[::2]) for part in parts).most_common(1)[0]
    numbers = list(zip(*(part[1::2] for part in parts if tuple(part[::2]) == form), strict=True))
    differing = [index for index, texts in enumerate(numbers) if len(set(texts)) > 1]
    pattern = _escape(form[0])
    for index, literal in enumerate(form[1:]):
        number = r"\d+" if index in differing else numbers[index][0]
        pattern += (r"(?P<set>\d+)" if index in differing[-1:] else number) + _escape(literal)
    return pattern, min(map(int, numbers[differing[-1]])) if differing else 0


def _escape(text: str) -> str:
    """Return a regular expression for a text, with spaces and hyphens as they are."""
    return re.escape(text).replace("\\ ", " ").replace("\\-", "-")
