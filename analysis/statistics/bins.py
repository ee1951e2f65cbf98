"""Bins of a trend: a summary of many sets, and how bins are joined to larger ones."""

from __future__ import annotations

from collections.abc import Sequence
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

_JOINED_BY = MappingProxyType(
    {
        # Of each value, shape (n_values,):
        "count": np.add,
        "sum": np.add,
        "minimum": np.minimum,
        "maximum": np.maximum,
        # Of the bin:
        "first_set": np.minimum,
        "last_set": np.maximum,
        "first_h": np.minimum,
        "last_h": np.maximum,
        "n_sets": np.add,
        "n_missed": np.add,
        "worst_quality": np.maximum,
        "n_judged": np.add,
        "n_outliers": np.add,
        "first_outlier": np.minimum,
        "n_judged_paper": np.add,
        "n_outliers_mean_3sd": np.add,
        "n_in_baseline": np.add,
        "n_alarms": np.add,
        "first_alarm": np.minimum,
    }
)
"""What a bin says, and how it follows from the parts of the bin; of nothing, a minimum is infinite."""
_OF_EACH_VALUE = 4


def build_bin_dtype(n_values: int) -> np.dtype[np.void]:
    """Return the structured NumPy dtype of a bin with ``n_values`` numbers in each of its value fields."""
    names = list(_JOINED_BY)
    of_value = [(name, "<f8", (n_values,)) for name in names[:_OF_EACH_VALUE]]
    return np.dtype([*of_value, *((name, "<f8") for name in names[_OF_EACH_VALUE:])])


def make_bins(
    *,
    set_index: ArrayLike,
    due_h: ArrayLike,
    values: ArrayLike,
    quality: Sequence[int | None],
    missed: Sequence[bool],
    outlier: Sequence[bool | None],
    outlier_mean_3sd: Sequence[bool | None],
    in_baseline: Sequence[bool],
    n_alarms: Sequence[int],
) -> NDArray[np.void]:
    """Convert each set to a bin that represents it exactly; shape (n,), dtype of `build_bin_dtype`.

    Parameters
    ----------
    set_index, due_h
        Index and due hour of each set, shape (n,).
    values
        Shape (n, n_values); NaN where a set has none.
    quality
        The greater, the worse; None: nothing was measured.
    outlier, outlier_mean_3sd
        None: not assessed.
    """
    index, numbers = np.asarray(set_index, dtype=np.float64), np.asarray(values, dtype=np.float64)
    bins = np.zeros(index.size, build_bin_dtype(numbers.shape[1]))
    present = np.isfinite(numbers)
    bins["count"], bins["sum"] = present, np.where(present, numbers, 0.0)
    bins["minimum"], bins["maximum"] = (np.where(present, numbers, nothing) for nothing in (np.inf, -np.inf))
    bins["first_set"] = bins["last_set"] = index
    bins["first_h"] = bins["last_h"] = due_h
    worst = np.asarray(quality, dtype=np.float64)
    bins["n_sets"], bins["worst_quality"] = np.isfinite(worst), np.where(np.isfinite(worst), worst, -np.inf)
    bins["n_missed"], bins["n_in_baseline"], bins["n_alarms"] = missed, in_baseline, n_alarms
    beyond, beyond_paper = (np.asarray(flags, dtype=np.float64) for flags in (outlier, outlier_mean_3sd))
    bins["n_judged"], bins["n_outliers"] = np.isfinite(beyond), beyond == 1.0
    bins["n_judged_paper"], bins["n_outliers_mean_3sd"] = np.isfinite(beyond_paper), beyond_paper == 1.0
    bins["first_outlier"] = np.where(beyond == 1.0, index, np.inf)
    bins["first_alarm"] = np.where(bins["n_alarms"] > 0.0, index, np.inf)
    return bins


def join_bins(bins: NDArray[np.void], starts: ArrayLike) -> NDArray[np.void]:
    """Join the bins from each start to the next, the last to the end; one bin for each of ``starts``.

    ``starts`` are indices into ``bins`` that rise from 0.
    """
    numbers = np.asarray(starts, dtype=np.intp)
    joined = np.empty(numbers.size, bins.dtype)
    for name, join in _JOINED_BY.items():
        joined[name] = join.reduceat(bins[name], numbers, axis=0)
    return joined
