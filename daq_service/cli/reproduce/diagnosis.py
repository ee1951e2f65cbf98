"""Causes of the deviations from the paper's values.

A cause that rests on the twin's choices holds for the test that this version runs by itself; any other
test is another specimen or another choice.
"""

from __future__ import annotations

from daq_service.cli.reproduce.paper_values import PaperValue
from daq_service.cli.reproduce.texts import TEXTS

OWN_SPECIMEN = "another specimen, rig or schedule than the paper's"
OTHER_TEST = "another configuration of the twin than the one that this version runs by itself"

GIVEN = "no independent agreement"
"""Start of the cause of a value that the twin was given: shown even without a deviation."""

MEASURED = ("table1", "fig7", "fig8", "fig9", "fig11", "fig14", "fig15")
"""Items that show measurements; the others are models of the paper's specimen, for any test."""

_CAUSES = {name: cause.text for cause in TEXTS.causes for name in cause.of}


def find_deviation_cause(value: PaperValue, *, origin: str) -> str:
    """Return the documented reason for a deviation from the paper; empty if none is documented.

    The most specific text counts: the longest beginning of ``item.quantity``.

    Parameters
    ----------
    origin
        ``shipped``: the test that this version runs by itself; ``twin``: another one on the twin;
        ``specimen``: a real one.
    """
    if value.item in MEASURED and origin != "shipped":
        return OWN_SPECIMEN if origin == "specimen" else OTHER_TEST
    name = f"{value.item}.{value.quantity}"
    known = [beginning for beginning in _CAUSES if name.startswith(beginning)]
    return _CAUSES[max(known, key=len)] if known else ""
