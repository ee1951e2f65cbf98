"""Quality of assessed values, stored with the feature or the thickness."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from daq_service.assessment.methods import METHODS
from daq_service.catalogue import Catalogue
from daq_service.catalogue.reader import Filters
from daq_service.catalogue.rows import AssessmentRow
from hardware_drivers.measurement import PLANNED_SETS
from hardware_drivers.methods import Method


def assessed_qualities(
    catalogue: Catalogue, methods: Mapping[str, Method], rows: Sequence[AssessmentRow]
) -> list[str | None]:
    """Return the quality of each assessed set; ``methods`` are those of the positions."""
    if not rows:
        return []
    hours, positions = [row.due_h for row in rows], {row.position for row in rows}
    qualities: dict[tuple[str, int], str] = {}
    for method in {methods[position] for position in positions}:
        measurement = METHODS[method]
        filters: Filters = {
            "position": None if len(positions) > 1 else rows[0].position,
            "first_h": min(hours),
            "last_h": max(hours),
            "purpose": None if all(row.set_index < PLANNED_SETS for row in rows) else "any",
            **measurement.of_sets,
        }
        columns = catalogue.columns(measurement.row, ("position", "set_index", "quality"), **filters)
        keys = zip(columns["position"], columns["set_index"], strict=True)
        qualities |= zip(keys, columns["quality"], strict=True)
    return [qualities.get((row.position, row.set_index)) for row in rows]
