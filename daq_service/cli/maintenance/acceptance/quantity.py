"""Quantities of an acceptance report: value, unit, method or reason of absence; and their statistics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from daq_service.cli.maintenance.acceptance.texts import TEXTS, SeriesText, TableText

WARM_UP, WARM_UP_SETS = 0.2, 10
"""First part of a recorder's sets, and so many at least: it imports, compiles, fills its caches, freezes
baselines."""
FEWEST_READINGS = 30
"""Minimum number of readings for a slope."""
MOST_BLOCKS = 300
"""Readings of a long test are put together, neighbours to their median: all pairs of them are looked at."""
CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True)
class Quantity:
    """One number of the report.

    Attributes
    ----------
    name
        Key in the JSON, with the unit at its end where it has one.
    text, unit, how
        Description; unit, "1" for a pure number; method of computation.
    value
        None: there is none.
    missing
        Why there is no value; empty if there is one.
    low, high
        Ends of its interval; None: it has no uncertainty.
    applies
        False: it cannot be measured in this test, so no criterion needs it.
    """

    section: str
    name: str
    text: str
    unit: str
    how: str
    value: float | int | None = None
    missing: str = ""
    low: float | None = None
    high: float | None = None
    applies: bool = True

    def __post_init__(self) -> None:
        """Remove the reason of a missing value if there is a value."""
        if self.value is not None:
            object.__setattr__(self, "missing", "")


def make_quantity(
    name: str,
    value: float | None,
    missing: str = "",
    interval: tuple[float | None, float | None] = (None, None),
    *,
    applies: bool = True,
    **facts: object,
) -> Quantity:
    """Create a quantity with its texts; ``facts`` fill the placeholders of its method.

    ``missing`` is the reason without a value, ``interval`` its lower and upper end. Raises KeyError if
    ``texts.toml`` has no such quantity.
    """
    text, (low, high) = TEXTS.quantities[name], interval
    return Quantity(
        text.section, name, text.text, text.unit, text.how.format(**facts), value, missing, low, high, applies
    )


@dataclass(frozen=True, slots=True)
class Table:
    """Table of events; the names of columns contain the units."""

    name: str
    rows: Sequence[tuple[object, ...]]

    @property
    def text(self) -> TableText:
        """Return title, columns, and the text of an empty table; raise KeyError for an unknown name."""
        return TEXTS.tables[self.name]


@dataclass(frozen=True, slots=True)
class Series:
    """One number over the hours of the test.

    Attributes
    ----------
    hours, values
        Shape (n,); a reading that the system did not give is left out.
    missing
        Why there is nothing to show; where there is something, it is left empty.
    label, others
        Legend of the series, and further lines by name: hours and values.
    steps
        It is constant between two readings.
    """

    name: str
    hours: Sequence[float]
    values: Sequence[float]
    missing: str
    others: Mapping[str, tuple[Sequence[float], Sequence[float]]] = field(default_factory=dict)
    label: str = "measured"
    steps: bool = False

    def __post_init__(self) -> None:
        """Remove the reason of missing values if there are values."""
        if self.values:
            object.__setattr__(self, "missing", "")

    @property
    def text(self) -> SeriesText:
        """Return title, unit and source of the series; raise KeyError for an unknown name."""
        return TEXTS.series[self.name]


def compute_quantile(values: Sequence[float], part: float) -> float:
    """Return the smallest value that at least the fraction ``part`` (0 to 1) of the values does not exceed.

    Raises IndexError if there are no values.
    """
    return float(np.quantile(np.asarray(values, dtype=np.float64), part, method="inverted_cdf"))


@dataclass(frozen=True, slots=True, kw_only=True)
class Growth:
    """Slope per 1,000 sets with its interval, and the number of readings."""

    slope: float
    low: float
    high: float
    n: int


def estimate_growth(set_indices: Sequence[int], values: Sequence[float]) -> Growth | None:
    """Compute the median slope of all pairs (Theil and Sen) with its 95 % interval (Sen 1968).

    A step or a burst changes it little. Consecutive readings are correlated, so the interval of a short test
    may be too narrow. More than `MOST_BLOCKS` readings are first reduced to that many medians of consecutive
    ones.

    Returns
    -------
    Growth or None
        Slope per 1,000 sets; None for fewer than `FEWEST_READINGS` values.
    """
    if len(values) < FEWEST_READINGS:
        return None
    from scipy.stats import theilslopes

    blocks = min(len(values), MOST_BLOCKS)
    x = [float(np.median(part)) for part in np.array_split(np.asarray(set_indices, dtype=np.float64), blocks)]
    y = [float(np.median(part)) for part in np.array_split(np.asarray(values, dtype=np.float64), blocks)]
    found = theilslopes(y, x, alpha=CONFIDENCE)
    return Growth(
        slope=1e3 * float(found.slope),
        low=1e3 * float(found.low_slope),
        high=1e3 * float(found.high_slope),
        n=len(values),
    )
