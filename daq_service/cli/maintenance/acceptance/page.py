"""Write the acceptance report as one self-contained, printable HTML page."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import groupby

from daq_service.cli.maintenance.acceptance.contents import AcceptanceReport
from daq_service.cli.maintenance.acceptance.criteria import Comparison
from daq_service.cli.maintenance.acceptance.quantity import Quantity
from daq_service.web.templates import NOT_KNOWN, render_template

SCALES = ((1e9, "GB"), (1e6, "MB"), (1e3, "kB"))


def choose_display_unit(unit: str, value: float) -> tuple[float, str]:
    """Return the factor and the name of the display unit of a value; bytes get the largest unit that fits.

    A unit that does not start with B has the factor 1 and keeps its name.
    """
    if not unit.startswith("B"):
        return 1.0, unit
    scale, name = next(((scale, name) for scale, name in SCALES if abs(value) >= scale), (1.0, "B"))
    return scale, f"{name}{unit[1:]}"


def render_report(report: AcceptanceReport, pictures: Mapping[str, bytes]) -> bytes:
    """Build the HTML page of the report, in UTF-8.

    Parameters
    ----------
    pictures
        PNG of each series that has values, by its name.
    """
    sections = groupby(report.quantities, key=lambda item: item.section)
    return render_template(
        "acceptance.html.j2",
        title=f"Acceptance report of the test {report.identity['test']}",
        report=report,
        pictures=pictures,
        sections=[(name, list(quantities)) for name, quantities in sections],
        asked=format_limit,
        interval=format_quantity,
    )


def format_with_interval(unit: str, *values: float | int | None) -> str:
    """Format a number with its unit; further numbers are its interval.

    Four digits; bytes in the largest unit that fits the first. A missing value gives `NOT_KNOWN`; an interval
    with a missing end is left out.
    """
    value, *ends = values
    if value is None:
        return NOT_KNOWN
    scale, scaled = choose_display_unit(unit, value)
    numbers = [
        f"{item:,}" if isinstance(item, int) and scale == 1.0 else f"{item / scale:.4g}"
        for item in values
        if item is not None
    ]
    text = f"{numbers[0]} ({' to '.join(numbers[1:])})" if len(numbers) == 1 + len(ends) > 1 else numbers[0]
    return text if unit == "1" else f"{text} {scaled.removeprefix('1 ')}"


def format_quantity(item: Quantity) -> str:
    """Format a quantity with its unit and, if there is one, its interval; `NOT_KNOWN` without a value."""
    return format_with_interval(item.unit, item.value, item.low, item.high)


def format_limit(item: Comparison) -> str:
    """Format the limit of a criterion as ``at most 5 s``; empty if none is required."""
    criterion = item.criterion
    return (
        ""
        if criterion.limit is None
        else f"{criterion.sense} {format_with_interval(item.quantity.unit, criterion.limit)}"
    )
