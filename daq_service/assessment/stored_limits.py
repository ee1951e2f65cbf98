"""Limits and statistics of stored rows by name, whatever version wrote them.

The list of limits is imported when it is needed: SciPy comes with it, which is slow to import.
"""

from __future__ import annotations

from daq_service.catalogue.rows import AssessmentRow, BaselineRow
from daq_service.settings.tree import AlarmSettings


def collect_limits_by_name(row: BaselineRow | AssessmentRow) -> dict[str, float]:
    """Return the limits of a stored row by name; empty if it has none.

    Rows of earlier versions have at most two limits, in columns.
    """
    if row.limits is not None:
        return dict(row.limits)
    from analysis.statistics.limits import F_PREDICTIVE, PAPER_MEAN_3SD

    of_columns = {F_PREDICTIVE: row.limit_f_predictive, PAPER_MEAN_3SD: row.limit_mean_3sd}
    return {name: limit for name, limit in of_columns.items() if limit is not None}


def find_limit_statistic(row: AssessmentRow, limit_name: str) -> float | None:
    """Return the value of the statistic that a named limit applies to; None if the row does not have it.

    Raises
    ------
    KeyError
        There is no limit of this name.
    """
    from analysis.statistics.named_limits import DISTANCE, LIMITS, MEWMA

    name = LIMITS[limit_name].of
    columns = {DISTANCE: row.distance_squared, MEWMA: row.mewma_statistic}
    return columns[name] if name in columns else (row.statistics or {}).get(name)


def find_chart_statistic(row: AssessmentRow | None, alarms: AlarmSettings) -> tuple[float, float] | None:
    """Return statistic and limit of the MEWMA control chart if it decides the wall alarm, else None.

    None also without an assessment, a statistic or a limit.
    """
    if row is None or row.mewma_statistic is None or alarms.decides_by != "chart":
        return None
    from analysis.statistics.named_limits import MEWMA

    limit = collect_limits_by_name(row).get(MEWMA)
    return None if limit is None else (row.mewma_statistic, limit)
