"""Published baselines: with their hours, and the first of a position also while it collects."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial
from typing import TypedDict

from analysis.waves.features import FEATURE_NAMES
from daq_service.acquisition.schedule import list_due_hours
from daq_service.assessment.baseline_lifecycle import build_first_baseline
from daq_service.catalogue import Catalogue
from daq_service.catalogue.reader import Filters
from daq_service.catalogue.rows import BaselineRow, EnvironmentRow, FeatureRow
from daq_service.settings.tree import Settings
from hardware_drivers.methods import SOLITARY_WAVE


class BaselineHours(TypedDict):
    """Hours of the first and last set of a baseline, and temperatures around its sets."""

    from_h: float
    to_h: float
    temperature_c: list[float] | None


def list_published_baselines(
    catalogue: Catalogue, settings: Settings, epoch_utc_ns: int, position: str | None
) -> list[tuple[BaselineRow, BaselineHours]]:
    """List the baselines of a position (None: of all), the newest last, each with hours and temperatures.

    A transducer without a stored baseline gets its first one as planned; a collecting baseline counts the
    usable sets so far. Raises StorageError if the catalogue cannot be read.
    """
    rows = catalogue.rows(BaselineRow, position=position)
    positions_with_baseline = {row.position for row in rows}
    rows += [
        build_first_baseline(name, settings, epoch_utc_ns)
        for name, place in settings.positions.items()
        if place.method == SOLITARY_WAVE and name not in positions_with_baseline and position in (None, name)
    ]
    hours = list_due_hours(settings.schedule.phases)
    # Baselines of many positions have the same sets: their environment is read once.
    temperatures_c = cache(partial(_read_temperatures_c, catalogue))
    return [
        (
            replace(row, n_sets=_count_usable_sets(catalogue, row)) if row.state == "collecting" else row,
            {
                "from_h": hours[row.first_set_index],
                "to_h": hours[min(row.last_set_index, len(hours) - 1)],
                "temperature_c": temperatures_c(row.first_set_index, row.last_set_index),
            },
        )
        for row in rows
    ]


def _count_usable_sets(catalogue: Catalogue, row: BaselineRow) -> int:
    """Count the scheduled sets of a baseline that have every feature and a quality other than bad."""
    filters: Filters = {"position": row.position, "scope": "set"}
    filters |= {"first_set": row.first_set_index, "last_set": row.last_set_index}
    names = ("quality", *FEATURE_NAMES)
    columns = catalogue.columns(FeatureRow, names, **filters)
    values_of_sets = zip(*(columns[name] for name in names), strict=True)
    return sum(quality != "bad" and None not in values for quality, *values in values_of_sets)


def _read_temperatures_c(catalogue: Catalogue, first: int, last: int) -> list[float] | None:
    """Return minimum and maximum of the temperature around sets, degC, as list; None if none was measured.

    Both set indices are included.
    """
    around = catalogue.columns(EnvironmentRow, ["temperature_c"], first_set=first, last_set=last)
    measured_c = [temperature_c for temperature_c in around["temperature_c"] if temperature_c is not None]
    return [min(measured_c), max(measured_c)] if measured_c else None
