"""Limits and statistics of stored rows by name, whatever version wrote them."""

from __future__ import annotations

from analysis.statistics.limits import F_PREDICTIVE, PAPER_MEAN_3SD
from analysis.statistics.named_limits import CHART, DISTANCE, LIMITS
from daq_service.catalogue.rows import BaselineRow, VerdictRow


def limits_by_name(row: BaselineRow | VerdictRow) -> dict[str, float]:
    """Return the limits of a row; one of an earlier version has two, in columns."""
    if row.limits is not None:
        return dict(row.limits)
    of_columns = {F_PREDICTIVE: row.limit_f, PAPER_MEAN_3SD: row.limit_paper}
    return {name: limit for name, limit in of_columns.items() if limit is not None}


def statistic_of(row: VerdictRow, limit_name: str) -> float | None:
    """Return what a limit bounds; None: the set was not judged by it."""
    name = LIMITS[limit_name].of
    columns = {DISTANCE: row.distance_squared, CHART: row.chart}
    return columns[name] if name in columns else (row.statistics or {}).get(name)
