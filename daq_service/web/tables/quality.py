"""Quality of assessed values, stored with the feature or the thickness."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from daq_service.assessment.methods import METHODS
from daq_service.catalogue import Catalogue
from daq_service.catalogue.reader import Filters
from daq_service.catalogue.rows import AssessmentRow
from hardware_drivers.measurement import SetKey
from hardware_drivers.methods import Method


def find_assessed_qualities(
    catalogue: Catalogue, methods: Mapping[str, Method], rows: Sequence[AssessmentRow]
) -> list[str | None]:
    """Return the quality of the feature or thickness of each assessment, in their order; None if unknown.

    ``methods`` gives the method of each position; KeyError is raised for a missing one. Raises StorageError
    if the catalogue cannot be read.
    """
    if not rows:
        return []
    hours, positions = [row.due_h for row in rows], {row.position for row in rows}
    qualities: dict[tuple[str, SetKey], str] = {}
    for method in {methods[position] for position in positions}:
        measurement = METHODS[method]
        filters: Filters = {
            "position": None if len(positions) > 1 else rows[0].position,
            "first_h": min(hours),
            "last_h": max(hours),
            "purpose": "any" if any(row.unscheduled_index for row in rows) else None,
            **measurement.of_sets,
        }
        measured_rows = catalogue.rows(measurement.row, **filters)
        qualities |= {(row.position, row.set_key): row.quality for row in measured_rows}
    return [qualities.get((row.position, row.set_key)) for row in rows]
