"""A row, its table, its response and its event have the same columns."""

import dataclasses
from types import NoneType
from typing import Literal, get_args, get_origin

import pytest

from analysis.waves.features import ALL_FEATURE_NAMES
from daq_service.alarms.evidence import build_alarm_columns
from daq_service.catalogue import rows
from daq_service.catalogue.tables import ROW_CRC32, TABLES, metadata
from daq_service.catalogue.writer import build_event_payload
from daq_service.web.answers import models
from daq_service.web.answers.json_answer import add_utc
from daq_service.web.answers.vocabulary import VOCABULARY

KINDS = [kind for kind in vars(rows).values() if isinstance(kind, type) and issubclass(kind, rows.Row)]
KINDS = [kind for kind in KINDS if kind not in (rows.Row, rows.RowOfSet)]
ANSWERED = [kind for kind in KINDS if hasattr(models, kind.__name__)]
EXAMPLES = {bytes: b"\x00\xff", bool: True, dict: {}, float: 1.5, int: 7, list: [], str: "text"}


def example(kind):
    """Return a row with a value in every column."""
    given = {}
    for column in rows.list_columns(kind):
        (of_type,) = [part for part in alternatives(column.type) if part is not NoneType]
        origin = get_origin(of_type) or of_type
        given[column.name] = get_args(of_type)[0] if origin is Literal else EXAMPLES[origin]
    return kind(**given)


def alternatives(of_type):
    return (of_type,) if get_origin(of_type) in (Literal, list, dict) else get_args(of_type) or (of_type,)


def test_every_table_holds_one_kind_of_row():
    assert len(KINDS) == 16
    assert {TABLES[kind].name for kind in KINDS} == set(metadata.tables)


@pytest.mark.parametrize("kind", KINDS)
def test_a_table_has_the_fields_of_its_row_in_their_order(kind):
    table = TABLES[kind]
    assert list(table.columns.keys()) == [*(field.name for field in dataclasses.fields(kind)), ROW_CRC32]
    assert [column.name for column in table.primary_key] == [dataclasses.fields(kind)[0].name]
    hints = {column.name: alternatives(column.type) for column in rows.list_columns(kind)}
    for column in table.columns:
        if not column.primary_key and column.name != ROW_CRC32:
            assert column.nullable == (NoneType in hints[column.name]), column.name


def test_features_are_the_columns_of_a_feature_row():
    names = [field.name for field in dataclasses.fields(rows.FeatureRow)]
    assert tuple(names[-len(ALL_FEATURE_NAMES) :]) == ALL_FEATURE_NAMES


def test_every_response_row_is_one_of_the_catalogue():
    assert {name for name in vars(models) if name.endswith("Row")} == {kind.__name__ for kind in ANSWERED}


@pytest.mark.parametrize("kind", ANSWERED)
def test_a_response_is_its_row_with_times_as_text_and_an_age(kind):
    row = example(kind)
    answer = add_utc(rows.as_dict(row), 0)
    if {"due_h", "raised_h"} & answer.keys():
        answer["age_h"] = 0.0
    if kind is rows.BaselineRow:
        answer["temperature_c"] = [18.5, 22.0]
        answer |= {
            f"{end}_{unit}": 0.5 if unit == "h" else "1970-01-01T00:30:00Z"
            for end in ("from", "to")
            for unit in ("h", "utc")
        }
    if kind is rows.AssessmentRow:
        answer["quality"] = "good"
    if kind is rows.AlarmRow:
        answer |= build_alarm_columns(row)
    if kind is rows.CommandRow:
        answer["expires_in_s"] = 1.0
    model = getattr(models, kind.__name__)
    assert model.model_validate(answer, strict=True).model_dump(exclude_unset=True) == answer
    for column in rows.list_columns(kind):
        if column.description is not None and column.name != "due_utc_ns":
            assert model.model_fields[column.published_name].description == column.description


GENERAL = {"id", "name", "kind", "author", "note", "text", "n_sets", "from_h", "utc", "created_utc"}
GENERAL |= {"due_utc", "evidence", "wall_utc"}
"""Names with the same meaning in answers that are no rows: `vocabulary` describes them."""


def test_a_column_is_described_on_its_row_and_nowhere_else():
    texts = set(VOCABULARY.meanings.values())
    for kind in ANSWERED:
        for column in rows.list_columns(kind):
            assert column.description is not None or column.published_name in GENERAL, (kind, column.name)
            assert column.description not in texts, (kind, column.name)


def test_an_event_payload_omits_an_id_that_is_not_assigned():
    row = example(rows.AlarmRow)
    assert build_event_payload(row) == rows.as_dict(row)
    assert list(build_event_payload(row, last="id"))[-1] == "id"
    new = dataclasses.replace(row, id=None)
    assert build_event_payload(new) == {
        name: value for name, value in rows.as_dict(row).items() if name != "id"
    }
