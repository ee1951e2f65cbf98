"""Unit of a quantity from the suffix of its name, as NeXus (UDUNITS) writes it."""

from __future__ import annotations

_UNITS = {
    "s": "s",
    "ms": "ms",
    "us": "us",
    "h": "h",
    "hz": "Hz",
    "m": "m",
    "n": "N",
    "v": "V",
    "a": "A",
    "pa": "Pa",
    "kg": "kg",
    "k": "K",
    "c": "degC",
    "coulomb": "C",
    "rad": "rad",
    "j": "J",
    "db": "dB",
    "v_s": "V s",
    "n_s": "N s",
    "ns": "ns",
}


def find_unit(name: str) -> str:
    """Return the unit of a name such as ``drop_height_m`` or ``velocity_m_per_s``; empty if it has none.

    The suffix after the last ``_per_`` is the denominator; an unknown one gives no unit. The unit is that of
    NeXus (UDUNITS), where a number without unit has an empty one.
    """
    numerator, _, denominator = name.rpartition("_per_")
    if numerator:
        return f"{find_unit(numerator)}/{_UNITS[denominator]}" if denominator in _UNITS else ""
    words = name.split("_")
    for count in (2, 1):
        # The name itself is no suffix: a quantity called "n" has no unit.
        if len(words) > count and "_".join(words[-count:]) in _UNITS:
            return _UNITS["_".join(words[-count:])]
    return ""
