"""Exportable tables, and the selection of their rows and columns in pages."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from daq_service.alarms.evidence import build_alarm_columns
from daq_service.catalogue import Catalogue, rows
from daq_service.catalogue.published_columns import PublishedColumn, Purposes, add_nested, list_shown_columns
from daq_service.catalogue.reader import Filters
from daq_service.catalogue.standard_errors import find_standard_errors
from daq_service.errors import UsageError
from daq_service.processes.freshness import Freshness
from daq_service.settings.stored import restore_settings
from daq_service.web.answers.json_answer import add_utc
from daq_service.web.tables.baselines import list_published_baselines
from daq_service.web.tables.quality import find_assessed_qualities

PAGE_ROWS = 1000
STANDARD_ERROR = "standard_error"
"""Start of the names of the columns that need the rows of the shots, too."""
ALWAYS = (
    *("id", "set_index", "unscheduled_index", "position", "shot_index", "due_h", "due_utc", "quality"),
    *("supply_quality", "climate_quality", "raised_h", "raised_utc", "kind", "priority", "state"),
    *("from_h", "from_utc", "to_h", "to_utc", "withdrawn_utc"),
)
"""Columns that identify rows and state their quality: these are always exported."""

Columns = dict[str, list[Any]]
"""Values of a page by column, nested ones as JSON text; None: not available."""


@dataclass(frozen=True, slots=True)
class TableKind:
    """Exportable table; ``unscheduled_set``: it also has rows of confirmation sets."""

    row: type[rows.Row]
    description: str
    fixed: Filters = field(default_factory=Filters)
    unscheduled_set: bool = False

    @property
    def columns(self) -> tuple[PublishedColumn, ...]:
        """Return all columns of the table, in order; a single shot has no standard error."""
        of_shots = self.fixed.get("scope") == "shot"
        return tuple(
            column
            for column in list_shown_columns(self.row)
            if not (of_shots and column.name.startswith(STANDARD_ERROR))
        )


TABLES: Mapping[str, TableKind] = {
    "sets": TableKind(rows.SetRow, "Scheduled sets and their results", unscheduled_set=True),
    "features": TableKind(rows.FeatureRow, "Features of sets", {"scope": "set"}, unscheduled_set=True),
    "shot_features": TableKind(
        rows.FeatureRow, "Features of single shots", {"scope": "shot"}, unscheduled_set=True
    ),
    "assessments": TableKind(
        rows.AssessmentRow, "Squared distances, limits and outliers", unscheduled_set=True
    ),
    "thickness": TableKind(rows.ThicknessRow, "Pulse-echo results"),
    "wall": TableKind(rows.WallRow, "Wall thickness from solitary waves"),
    "environment": TableKind(rows.EnvironmentRow, "Supply and climate around each set"),
    "baselines": TableKind(rows.BaselineRow, "Baselines of every position: lifecycle, quality, limits"),
    "alarms": TableKind(rows.AlarmRow, "Alarms with their evidence"),
    "annotations": TableKind(rows.AnnotationRow, "What people noted of hours of the test"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """Selected rows and columns of a table; ``from_h`` is included, ``to_h`` is not, None is open."""

    table: str
    position: str | None = None
    from_h: float | None = None
    to_h: float | None = None
    fields: str | None = None
    purpose: Purposes = "planned"

    def __post_init__(self) -> None:
        """Raise UsageError for an unknown table or field, a filter it lacks, or a reversed range."""
        if self.table not in TABLES:
            raise UsageError(f"there is no table {self.table!r}; choose from {', '.join(TABLES)}")
        known = [column.name for column in TABLES[self.table].columns]
        if self.position is not None and "position" not in known:
            raise UsageError(f"the table {self.table} has no positions; leave the position out")
        if self.purpose != "planned" and not TABLES[self.table].unscheduled_set:
            other_tables = ", ".join(name for name, kind in TABLES.items() if kind.unscheduled_set)
            raise UsageError(
                f"the table {self.table} has no unscheduled sets, {other_tables} have; leave the purpose out"
            )
        if self.from_h is not None and self.to_h is not None and self.to_h < self.from_h:
            raise UsageError(f"the range ends at {self.to_h:g} h, before {self.from_h:g} h; let it end later")
        unknown = sorted(set(self.chosen) - set(known))
        if self.fields is not None and (unknown or not self.chosen):
            raise UsageError(
                f"the table {self.table} has no field {', '.join(unknown) or '(none named)'}; "
                f"choose from {', '.join(known)}"
            )

    @property
    def chosen(self) -> list[str]:
        """Return the names of the chosen fields in the given order; empty: all."""
        return [part.strip() for part in (self.fields or "").split(",") if part.strip()]

    @property
    def columns(self) -> tuple[PublishedColumn, ...]:
        """Return the selected columns and those of `ALWAYS`, in the order of the table."""
        all_columns = TABLES[self.table].columns
        wanted = {column.name for column in all_columns} if self.fields is None else {*self.chosen, *ALWAYS}
        return tuple(column for column in all_columns if column.name in wanted)

    @property
    def name(self) -> str:
        """Return the name of the exported file, without suffix: table, position and purpose."""
        is_planned = self.purpose == "planned"
        return "_".join(filter(None, (self.table, self.position, None if is_planned else self.purpose)))


def read_pages(catalogue: Catalogue, fresh: Freshness, choice: Choice) -> Iterator[Columns]:
    """Yield the selected rows as columns, in pages of `PAGE_ROWS`, in the order of the table; at least one.

    Baselines are one page. Alarms are in their state at the moment of ``fresh``; a page of them may have
    fewer rows, or none. Raises StorageError if the catalogue cannot be read.
    """
    experiment = catalogue.read_experiment()
    kind, names = TABLES[choice.table], [column.name for column in choice.columns]
    if kind.row is rows.BaselineRow:
        settings = restore_settings(experiment.configuration)
        rows_json = [
            add_nested(
                rows.BaselineRow, add_utc({**rows.as_dict(row), **extra_columns}, experiment.epoch_utc_ns)
            )
            for row, extra_columns in list_published_baselines(
                catalogue, settings, experiment.epoch_utc_ns, choice.position
            )
            if _is_in_selected_hours(choice, extra_columns["from_h"], extra_columns["to_h"])
        ]
        yield _convert_to_columns(rows_json, names)
        return
    filters: Filters = {**kind.fixed, "position": choice.position}
    if kind.unscheduled_set:
        filters |= {"purpose": choice.purpose}
    by_set = kind.row is not rows.AlarmRow
    if by_set:
        filters |= {"first_h": choice.from_h, "last_h": find_last_hour_inside(choice.to_h)}
    is_first = True
    while True:
        stored: Sequence[Any] = catalogue.rows(kind.row, limit=PAGE_ROWS, **filters)
        if stored or is_first:
            selected: list[Any] = [
                row for row in stored if by_set or _is_in_selected_hours(choice, row.raised_h, row.raised_h)
            ]
            if not by_set:
                selected = list(map(fresh.expire_shelf, selected))
            rows_json = [add_utc(rows.as_dict(row), experiment.epoch_utc_ns) for row in selected]
            if kind.row is rows.AssessmentRow:
                methods = {
                    name: place["method"] for name, place in experiment.configuration["positions"].items()
                }
                for row, quality in zip(
                    rows_json, find_assessed_qualities(catalogue, methods, selected), strict=True
                ):
                    row["quality"] = quality
            if kind.row is rows.FeatureRow and any(name.startswith(STANDARD_ERROR) for name in names):
                for row, errors in zip(rows_json, find_standard_errors(catalogue, selected), strict=True):
                    row[STANDARD_ERROR] = errors
            if kind.row is rows.AlarmRow:
                baselines = catalogue.read_baselines_by_id()
                for row, alarm in zip(rows_json, selected, strict=True):
                    row.update(build_alarm_columns(alarm, baselines))
            yield _convert_to_columns([add_nested(kind.row, row) for row in rows_json], names)
        if len(stored) < PAGE_ROWS:
            return
        filters["after_id"] = stored[-1].id
        is_first = False


def find_last_hour_inside(to_h: float | None) -> float | None:
    """Return the largest number below the excluded end of a range of hours; None if the range is open."""
    return None if to_h is None else math.nextafter(to_h, -math.inf)


def _is_in_selected_hours(choice: Choice, first_h: float, last_h: float) -> bool:
    """Return whether the hours ``first_h`` to ``last_h``, both included, overlap the selected hours."""
    return (choice.from_h is None or last_h >= choice.from_h) and (
        choice.to_h is None or first_h < choice.to_h
    )


def _convert_to_columns(rows_json: Sequence[Mapping[str, object]], names: Sequence[str]) -> Columns:
    """Convert rows to columns of plain values; raise KeyError for a column that a row lacks."""
    return {name: [_convert_to_plain_value(row[name]) for row in rows_json] for name in names}


def _convert_to_plain_value(value: object) -> object:
    """Return dictionaries and lists as JSON text, and other values unchanged: a file holds no nested ones."""
    return json.dumps(value, ensure_ascii=False) if isinstance(value, dict | list) else value
