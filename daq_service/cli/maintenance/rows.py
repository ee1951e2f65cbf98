"""Compare the rows of a set with its file."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from daq_service.archive import SetRecord, SetReference
from daq_service.assessment.results_in_file import build_result_tables
from daq_service.assessment.results_in_file import find_differences as results_differ
from daq_service.catalogue.rows import FeatureRow, Outcome, Row, ShotRow, ThicknessRow, as_dict
from daq_service.recording.set_assessor import build_shot_row
from hardware_drivers.methods import PULSE_ECHO

R = TypeVar("R", bound=Row)
Found = Mapping[str, Any]
"""A row of the catalogue: column to value."""
_ASSESSED_COLUMNS = ("valid", "flags")
"""Columns of a shot that do not follow from its record alone."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RowsOfSet:
    """The catalogue's rows of one set."""

    sets: Sequence[Found]
    shots: Sequence[Found]
    features: Sequence[Found]
    assessments: Sequence[Found]
    thickness: Sequence[Found]


def find_row_differences(
    rows: RowsOfSet, record: SetRecord, file: SetReference, lost: frozenset[int]
) -> Iterator[tuple[int | None, str]]:
    """Yield the differences between rows and file as texts, each with the id of its shot or None.

    Parameters
    ----------
    record
        The readable part of the file.
    lost
        Ids of its unreadable shots; with any, columns of sets and stored results are not compared.
    """
    of_position = {row["position"]: row for row in rows.sets}
    for position in record.positions:
        taken = [item for item in record.records if item.key.position == position.position]
        row = of_position.pop(position.position, None)
        where = f"sets, set {record.set_key} of {position.position}"
        if row is None:
            yield None, f"{where}: there is no row"
        elif not lost:
            state = "partial" if taken else "missed"
            wanted = {
                "method": position.method,
                "due_utc_ns": record.due_utc_ns,
                "due_h": record.due_h,
                "started_utc_ns": record.started_utc_ns,
                "ended_utc_ns": record.ended_utc_ns,
                "state": state if position.cause else "done",
                "reason": position.cause or None,
                "n_planned": position.n_planned,
                "n_taken": len(taken),
                "n_missed": record.n_missed(position.position),
                "n_restrikes": record.n_restrikes(position.position),
                "file": file if taken else None,
            }
            for difference in _find_column_differences(where, row, wanted):
                yield None, difference
        for difference in _find_result_differences(rows, position.position, position.method):
            yield None, f"{where}: {difference}"
    for name, row in of_position.items():
        if row["n_taken"] or row["file"] is not None:
            yield None, f"sets, set {record.set_key} of {name}: the file has no such position"
    yield from _find_shot_differences(rows.shots, record, lost)
    if record.results and not lost:
        copy = build_result_tables(
            [_to_current_row(FeatureRow, row) for row in rows.features],
            [_to_current_row(ThicknessRow, row) for row in rows.thickness],
            [_to_current_row(ShotRow, {**row, "flags": _decode_flags(row)}) for row in rows.shots],
        )
        for difference in results_differ(record.results, copy):
            yield None, f"set {record.set_key}, {difference}"


def _to_current_row(kind: type[R], row: Found) -> R:
    """Create a row of a current kind from a stored one, without columns that the kind does not have."""
    return kind(**{name: row[name] for name in kind.__slots__ if name in row})


def _decode_flags(row: Found) -> list[str]:
    """Decode the quality flags of a shot; corrupt JSON gives one flag, its text."""
    try:
        found = json.loads(row["flags"])
    except (TypeError, ValueError):  # corrupt: then it differs from the file
        return [str(row["flags"])]
    return [str(flag) for flag in found] if isinstance(found, list) else [str(found)]


def _find_shot_differences(
    found: Sequence[Found], record: SetRecord, lost: frozenset[int]
) -> Iterator[tuple[int | None, str]]:
    """Yield the differences between stored shots and their rows, each with the id of its shot.

    Rows of shots in ``lost`` are no differences.
    """
    by_sequence = {row["sequence"]: row for row in found}
    for item in record.records:
        outcome: Outcome = "superseded" if record.outcomes.get(item.sequence) == "superseded" else "accepted"
        wanted = as_dict(build_shot_row(item, valid=True, flags=(), outcome=outcome))
        row, where = by_sequence.pop(item.sequence, None), f"shots, sequence {item.sequence}"
        if row is None:
            yield item.sequence, f"{where}: there is no row"
            continue
        wanted = {name: value for name, value in wanted.items() if name not in _ASSESSED_COLUMNS}
        yield from (
            (item.sequence, difference) for difference in _find_column_differences(where, row, wanted)
        )
    for sequence in by_sequence.keys() - lost:
        yield sequence, f"shots, sequence {sequence}: the file has no such shot"


def _find_column_differences(where: str, row: Found, wanted: Found) -> Iterator[str]:
    """Yield a text, after ``where``, for each column of both mappings whose values differ, in any order."""
    for name in wanted.keys() & row.keys():
        if row[name] != wanted[name]:
            yield f"{where}: {name} is {row[name]!r}, in the file {wanted[name]!r}"


def _find_result_differences(rows: RowsOfSet, position: str, method: str) -> Iterator[str]:
    """Yield a text for each table of results whose rows do not match the stored shots of a position."""
    shots = {row["sequence"] for row in rows.shots if row["position"] == position}
    if method == PULSE_ECHO:
        read = [row["sequence"] for row in rows.thickness if row["position"] == position]
        if set(read) != shots:
            yield f"thickness is of shots {sorted(map(str, read))}, stored are {sorted(map(str, shots))}"
        return
    features = [row for row in rows.features if row["position"] == position]
    of_sets = [row for row in features if row["shot_index"] is None]
    assessment_rows = [row for row in rows.assessments if row["position"] == position]
    if len(of_sets) != len(assessment_rows):
        yield f"{len(of_sets)} rows of features of the set, but {len(assessment_rows)} assessments"
    if features and {row["sequence"] for row in features if row["shot_index"] is not None} != shots:
        yield "features and shots are not of the same records"
