"""Compare two assessments of a test: new, missing and moved alarms; rows column by column. Pure functions.

Rows are compared by their fields, so new columns are included.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import orjson

from analysis.statistics.named_limits import AVERAGE, MEWMA
from daq_service.catalogue import Catalogue
from daq_service.catalogue.rows import (
    AssessmentRow,
    BaselineRow,
    EventRow,
    FeatureRow,
    Row,
    ThicknessRow,
    as_dict,
)
from hardware_drivers.nanoseconds import NS_PER_H

ONSETS = ("alarm_raised", "alarm_reactivated")
NOT_COMPARED = frozenset({"id", "created_utc_ns"})
"""Columns about the storage of a row, not its contents."""
LIFE = ("state", "approval", "approved_utc_ns", "retired_utc_ns", "retired_by", "retired_reason")
"""Columns of a baseline that a person's step changes."""
EXTRACTED = (FeatureRow, ThicknessRow)
ASSESSED = (BaselineRow, AssessmentRow)


@dataclass(frozen=True, slots=True, kw_only=True)
class Onset:
    """An alarm is raised, or active again before it was acknowledged."""

    position: str
    kind: str
    set_index: int
    hour: float
    priority: str
    message: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Moved:
    """An alarm that both assessments raise, with different sets."""

    stored: Onset
    again: Onset


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmChanges:
    """Differences of alarms; ``kept`` are raised with the same set."""

    kept: Sequence[Onset]
    come: Sequence[Onset]
    go: Sequence[Onset]
    moved: Sequence[Moved]


@dataclass(frozen=True, slots=True, kw_only=True)
class Difference:
    """A column of rows that differs between the two assessments.

    Attributes
    ----------
    column
        Of a column that holds named values, ``column.name``.
    n_rows, first_set_index
        How many rows differ, and the set of the first one (of a baseline the last set that is in it).
    stored, again
        Their values in the first one.
    """

    table: str
    position: str
    column: str
    n_rows: int
    first_set_index: int
    stored: Any
    again: Any


def list_onsets(catalogue: Catalogue, up_to_set: int | None = None) -> list[Onset]:
    """List the onsets of alarms about positions that a set raised, in the order of the events.

    ``up_to_set`` is the last set index (None: all); alarms without position or set are left out.
    """
    epoch_utc_ns = catalogue.read_experiment().epoch_utc_ns
    return [
        Onset(
            position=event.position,
            kind=event.payload["kind"],
            set_index=event.set_index,
            hour=(event.utc_ns - epoch_utc_ns) / NS_PER_H,
            priority=event.payload["priority"],
            message=event.payload["message"],
        )
        for event in catalogue.rows(EventRow, topic="alarms")
        if event.kind in ONSETS and event.position is not None and event.set_index is not None
        if up_to_set is None or event.set_index <= up_to_set
    ]


def compare_alarm_onsets(stored: Iterable[Onset], again: Iterable[Onset]) -> AlarmChanges:
    """Compare the alarm onsets of two assessments by position and kind.

    Onsets with the same set are kept. Of the others the k-th stored and the k-th new one are a moved pair;
    the remaining ones go or come. Each list is sorted by position, kind and set.
    """
    before, after = _group_by_position(stored), _group_by_position(again)
    kept: list[Onset] = []
    come: list[Onset] = []
    go: list[Onset] = []
    moved: list[Moved] = []
    for place in sorted({*before, *after}):
        old, new = before.get(place, {}), after.get(place, {})
        kept += [new[index] for index in sorted(old.keys() & new.keys())]
        disappeared = [old[index] for index in sorted(old.keys() - new.keys())]
        added = [new[index] for index in sorted(new.keys() - old.keys())]
        n_moved = min(len(disappeared), len(added))
        moved += [
            Moved(stored=a, again=b) for a, b in zip(disappeared[:n_moved], added[:n_moved], strict=True)
        ]
        go += disappeared[n_moved:]
        come += added[n_moved:]
    return AlarmChanges(kept=kept, come=come, go=go, moved=moved)


def _group_by_position(found: Iterable[Onset]) -> dict[tuple[str, str], dict[int, Onset]]:
    """Group onsets by position and kind, then by set index; of several in a set the last one is kept."""
    by_place: dict[tuple[str, str], dict[int, Onset]] = {}
    for onset in found:
        by_place.setdefault((onset.position, onset.kind), {})[onset.set_index] = onset
    return by_place


def compare_rows(
    kinds: Iterable[type[Row]],
    stored: Catalogue,
    again: Catalogue,
    *,
    position: str | None = None,
    up_to_set: int | None = None,
) -> list[Difference]:
    """Compare the rows of these kinds in two catalogues, column by column.

    Of features those of complete sets are compared. A column that no stored row has is of a later version and
    is ignored. A set with a row in only one of the two differs in the column ``row``. Up to a set, actions of
    people on a baseline are not compared: its row has the present state, which may be later than the set. The
    result is empty if all rows agree.
    """
    found = []
    for kind in kinds:
        old, new = (_collect_rows(kind, catalogue, position, up_to_set) for catalogue in (stored, again))
        known = {name for _, row in old.values() for name, value in row.items() if value is not None}
        columns: dict[tuple[str, str], list[tuple[int, Any, Any]]] = {}
        for key in sorted({*old, *new}):
            set_index, _ = old.get(key) or new[key]
            for name, stored_value, new_value in find_differing_columns(
                old.get(key, (0, None))[1], new.get(key, (0, None))[1]
            ):
                if name.partition(".")[0] in known or name == "row":
                    columns.setdefault((key[0], name), []).append((set_index, stored_value, new_value))
        found += [
            Difference(
                table=kind.__name__.removesuffix("Row").lower(),
                position=place,
                column=name,
                n_rows=len(values_that_differ),
                first_set_index=values_that_differ[0][0],
                stored=values_that_differ[0][1],
                again=values_that_differ[0][2],
            )
            for (place, name), values_that_differ in columns.items()
        ]
    return found


def _collect_rows(
    kind: type[Row], catalogue: Catalogue, position: str | None, up_to_set: int | None
) -> dict[tuple[str, int], tuple[int, dict[str, Any]]]:
    """Collect set index and columns of each row, up to a set (None: all), by position and set index.

    Baselines are keyed by position and number from 0, with the index of their last set.
    """
    found: dict[tuple[str, int], tuple[int, dict[str, Any]]] = {}
    baselines: Counter[str] = Counter()
    left_out = NOT_COMPARED if up_to_set is None or kind is not BaselineRow else NOT_COMPARED.union(LIFE)
    rows: list[Any] = catalogue.rows(kind, position=position, scope="set" if kind is FeatureRow else None)
    for row in rows:
        set_index = row.last_set_index if kind is BaselineRow else row.set_index
        if up_to_set is not None and set_index > up_to_set:
            continue
        key = baselines[row.position] if kind is BaselineRow else set_index
        baselines[row.position] += 1
        columns = {
            name: value for name, value in drop_diagnosis_state(as_dict(row)).items() if name not in left_out
        }
        found[row.position, key] = set_index, columns
    return found


def drop_diagnosis_state(columns: Mapping[str, Any]) -> dict[str, Any]:
    """Return a copy of columns whose ``averages`` lack the diagnosis state that earlier versions kept there.

    Averages of which nothing is left become None.
    """
    averages = columns.get("averages")
    if averages is None:
        return dict(columns)
    charts = {name: average for name, average in averages.items() if name in (AVERAGE, MEWMA)}
    return {**columns, "averages": charts or None}


def find_differing_columns(
    stored: Mapping[str, Any] | None, again: Mapping[str, Any] | None
) -> Iterator[tuple[str, Any, Any]]:
    """Yield name and both values of each differing column, of nested ones ``column.key``.

    If one of the rows is missing, only ``row`` is yielded. Columns that only ``again`` has are ignored.
    """
    if stored is None or again is None:
        presence = [None if row is None else "there" for row in (stored, again)]
        yield "row", presence[0], presence[1]
        return
    for name in stored:
        stored_value, new_value = _to_json_value(stored[name]), _to_json_value(again[name])
        if isinstance(stored_value, Mapping) and isinstance(new_value, Mapping):
            for key in {**stored_value, **new_value}:
                if stored_value.get(key) != new_value.get(key):
                    yield f"{name}.{key}", stored_value.get(key), new_value.get(key)
        elif stored_value != new_value:
            yield name, stored_value, new_value


def _to_json_value(value: Any) -> Any:
    """Convert a value to its JSON form: NaN becomes None, an array a list; TypeError if it has none."""
    return orjson.loads(orjson.dumps(value, option=orjson.OPT_SERIALIZE_NUMPY))
