"""Causes of the deviations from the paper's values in the test that this version runs by itself."""

from __future__ import annotations

from collections.abc import Mapping

from daq_service.cli.reproduce.paper_values import PaperValue
from daq_service.cli.reproduce.texts import TEXTS, find_remark

MEASURED = ("table1", "fig7", "fig8", "fig9", "fig11", "fig14", "fig15")
"""Items that show measurements; the others are models of the paper's specimen, for any test."""


def find_deviation_cause(value: PaperValue, *, origin: str) -> str:
    """Return the documented reason for a deviation from the paper; empty if none is documented.

    Its numbers are still names, see `fill_numbers`.

    Parameters
    ----------
    origin
        ``shipped``: the test that this version runs by itself; ``twin``: another one on the twin;
        ``specimen``: a real one. Causes in the twin hold for the first only.
    """
    if value.item in MEASURED and origin != "shipped":
        return ""
    return find_remark(TEXTS.causes, f"{value.item}.{value.quantity}")


def fill_numbers(cause: str, numbers: Mapping[str, Mapping[str, float]]) -> str:
    """Fill the numbers of this run, by item and quantity, into a cause; empty if one was not computed."""
    try:
        return cause.format_map(numbers)
    except KeyError:
        return ""
