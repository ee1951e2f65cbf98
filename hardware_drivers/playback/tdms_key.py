"""Key of the shot of each record in a LabVIEW file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hardware_drivers.measurement import ShotKey
from hardware_drivers.playback.parameters import KEY_PARTS, TdmsMapping
from hardware_drivers.playback.tdms_channel import Channel


def build_shot_key(channel: Channel, names: Mapping[str, str | None], mapping: TdmsMapping) -> ShotKey:
    """Build the key of a channel's first record from matched names, properties and the mapping.

    A property takes precedence over the names; a set, shot or attempt that is not given is 0.

    Parameters
    ----------
    names
        Texts that the named groups of the three patterns matched.

    Raises
    ------
    ConfigurationError
        No position; a property is missing; a number is not whole, or below the first.
    """
    values: dict[str, Any] = {part: names.get(part) for part in KEY_PARTS}
    for part in ("position", "set", "shot"):
        property_name = getattr(mapping, f"{part}_property")
        if property_name:
            if property_name not in channel.properties:
                raise channel.build_error(
                    f"the property {property_name!r} that gives the {part} is missing",
                    f"correct {part}_property, or leave the channel out of the patterns",
                )
            values[part] = channel.properties[property_name]
    position = str(values["position"] if values["position"] is not None else mapping.position)
    if not position:
        raise channel.build_error("nothing names the position", "correct the patterns")
    firsts = {"set": mapping.first_set, "shot": mapping.first_shot, "attempt": 0}
    indices = {part: _parse_index(channel, part, values[part], first) for part, first in firsts.items()}
    return ShotKey(
        position=mapping.rename.get(position, position),
        set_index=indices["set"],
        shot_index=indices["shot"],
        attempt=indices["attempt"],
    )


def _parse_index(channel: Channel, part: str, values: Any, first: int) -> int:
    """Convert the number of a ``part`` (set, shot or attempt) to an index from 0; None becomes 0.

    The index is the number less ``first``. Raise ConfigurationError for no whole number, or one below it.
    """
    if values is None:
        return 0
    try:
        number = int(values)
    except (TypeError, ValueError) as error:
        raise channel.build_error(
            f"the {part} is called {values!r}, which is no whole number", f"correct what names the {part}"
        ) from error
    if number < first or number != float(values):
        raise channel.build_error(
            f"the {part} has the number {values}; whole numbers count from {first}",
            f"correct first_{part}" if part != "attempt" else "correct the pattern",
        )
    return number - first


def count_record_samples(channel: Channel, mapping: TdmsMapping) -> int:
    """Return the number of samples in each record of a channel: all of them unless records are appended.

    Raises
    ------
    ConfigurationError
        A record is cut short; the length of appended ones is unknown, or does not divide the channel's.
    """
    written = channel.read_float(mapping.samples_property)
    if not mapping.appended:
        if written is not None and written > channel.n_samples:
            raise channel.build_error(
                f"cut short, {channel.n_samples} of {written:.0f} samples ({mapping.samples_property}) are "
                "left",
                "bring the file back from a copy, or take it away: its shots are missed strikes then",
            )
        return channel.n_samples
    samples = mapping.record_samples or written
    if samples is None or samples < 1:
        raise channel.build_error(
            f"the length of a record is unknown ({mapping.samples_property} is missing)",
            "give record_samples",
        )
    if channel.n_samples % int(samples):
        raise channel.build_error(
            f"{channel.n_samples} samples are not a whole number of records of {int(samples)}",
            "correct record_samples, or take the file away if its last record was cut short",
        )
    return int(samples)
