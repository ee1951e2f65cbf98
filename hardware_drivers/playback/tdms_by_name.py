"""Shots of LabVIEW files with one group: the channel's own name identifies the shot.

``B`` is shot 0 of position B; ``B_3``, ``B shot 3`` and ``B3`` are its shot 3.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping

from hardware_drivers.errors import ConfigurationError
from hardware_drivers.playback.parameters import TdmsMapping

_NUMBER = r"[ _.-]*(?:shot)?[ _.-]*(?P<shot>\d+)"


def is_mapped_by_name(mapping: TdmsMapping) -> bool:
    """Return whether shots may be identified by the names of channels.

    That is so if the mapping has the default patterns of group and channel, and no key names the position, or
    the properties of position, set and shot.
    """
    defaults = TdmsMapping()
    keys = (
        "group_pattern",
        "channel_pattern",
        "position",
        "position_property",
        "set_property",
        "shot_property",
    )
    return all(getattr(mapping, key) == getattr(defaults, key) for key in keys)


def find_shots_by_name(
    channels: Collection[tuple[str, str]], positions: Collection[str], mapping: TdmsMapping, file: str
) -> dict[tuple[str, str], Mapping[str, str | None]]:
    """Return position and shot number of each channel named after a position, by group and name.

    Other channels are left out; empty if the channels are not all in one group. The shot is a text of
    digits, None for a bare position.

    Parameters
    ----------
    channels
        Group and name of each channel of a file.

    Raises
    ------
    ConfigurationError
        A name fits two positions, or two names are one shot: the names found.
    """
    if len({group for group, _ in channels}) != 1:
        return {}
    found: dict[tuple[str, str], Mapping[str, str | None]] = {}
    of_shot: dict[tuple[str, int], str] = {}
    for group, name in channels:
        fits = _list_possible_shots(mapping.rename.get(name, name), positions)
        if not fits:
            continue
        (position, shot), *others = fits
        number = mapping.first_shot if shot is None else int(shot)
        twin = of_shot.setdefault((position, number), name)
        if others or twin != name:
            names = ", ".join(sorted(name for _, name in channels))
            indices = (
                f"channel {name!r} is shot {shot} of {position!r}, or of {others[0][0]!r}"
                if others
                else f"channels {twin!r} and {name!r} are both shot {number} of {position!r}"
            )
            raise ConfigurationError(
                f"{file}, group {group!r}: {indices}; its channels are: {names}; assign it by "
                "channel_pattern with (?P<position>...) and (?P<shot>...), or by rename"
            )
        found[group, name] = {"position": position, "shot": shot}
    return found


def _list_possible_shots(name: str, positions: Collection[str]) -> list[tuple[str, str | None]]:
    """Return each position and shot number (digits) that a channel's name may mean; empty if none.

    A name that is a position means that position alone, without a number (None). Letter case is ignored
    otherwise.
    """
    if name in positions:
        return [(name, None)]
    matches = ((one, re.fullmatch(re.escape(one) + _NUMBER, name, re.IGNORECASE)) for one in positions)
    return [(one, match["shot"]) for one, match in matches if match is not None]
