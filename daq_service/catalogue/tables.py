"""Tables of the catalogue (SQLAlchemy Core), derived from `rows` with keys, constraints and indices.

`events` is append-only and its ids are ordered: it is the bus between recorder and web service.
"""

from __future__ import annotations

from types import NoneType
from typing import Any, Literal, get_args, get_origin

import sqlalchemy as sa
from sqlalchemy.schema import SchemaItem
from sqlalchemy.types import TypeEngine

from daq_service.catalogue import rows

metadata = sa.MetaData(
    naming_convention={
        "ix": "ix_%(column_0_label)s",
        "uq": "uq_%(table_name)s_%(column_0_name)s",
        "fk": "fk_%(table_name)s_%(column_0_name)s_%(referred_table_name)s",
        "pk": "pk_%(table_name)s",
    }
)

ROW_CRC32 = "row_crc32"
"""The last column of each table: the checksum of the others, which no dataclass has."""

TABLES: dict[type[rows.Row], sa.Table] = {}
"""Table of each kind of row."""
# None is SQL's NULL, not the JSON text "null": so NOT NULL is effective.
_TYPES: dict[Any, TypeEngine[Any]] = {
    bool: sa.Boolean(),
    bytes: sa.LargeBinary(),
    dict: sa.JSON(none_as_null=True),
    float: sa.Float(),
    int: sa.Integer(),
    list: sa.JSON(none_as_null=True),
    str: sa.String(),
    Literal: sa.String(),
}
_BIG_INTEGERS = ("_ns", "crc32")


def _create_table(
    name: str,
    kind: type[rows.Row],
    *constraints: SchemaItem,
    autoincrement: bool = False,
    **additions: sa.ForeignKey | sa.DefaultClause,
) -> sa.Table:
    """Create the table of a kind of row, with its checksum as last column, add it to `TABLES` and return it.

    The first column is the primary key. ``additions`` adds foreign keys and defaults to columns by name;
    ``autoincrement`` never uses an id again.
    """
    columns = [
        sa.Column(
            column.name,
            _choose_sql_type(column),
            *([additions[column.name]] if column.name in additions else []),
            primary_key=number == 0,
            nullable=column.nullable and number > 0,
        )
        for number, column in enumerate(rows.list_columns(kind))
    ]
    columns.append(sa.Column(ROW_CRC32, sa.BigInteger()))
    # With AUTOINCREMENT ids are never used again, even after a deletion.
    TABLES[kind] = sa.Table(name, metadata, *columns, *constraints, sqlite_autoincrement=autoincrement)
    return TABLES[kind]


def _choose_sql_type(column: rows.Column) -> TypeEngine[Any]:
    """Choose the SQL type of a column by its name, else by its type; KeyError for a type without one."""
    if column.name.endswith(_BIG_INTEGERS):
        return sa.BigInteger()
    if column.name == "configuration_hash":
        return sa.String(64)
    alternatives = get_args(column.type) if column.nullable else (column.type,)
    (of_type,) = (kind for kind in alternatives if kind is not NoneType)
    return _TYPES[get_origin(of_type) or of_type]


def _make_constraint(table: str, *names: str) -> sa.UniqueConstraint:
    """Create the unique constraint ``uq_<table>_<names>``, named after its first three columns."""
    return sa.UniqueConstraint(*names, name=f"uq_{table}_{'_'.join(names[:3])}")


def _add_index(table: sa.Table, *names: str) -> None:
    """Add the index ``ix_<table>_<names>`` of columns, named after all of them, to a table."""
    sa.Index(f"ix_{table.name}_{'_'.join(names)}", *(table.c[name] for name in names))


experiment = _create_table("experiment", rows.ExperimentRow, uuid=sa.DefaultClause(""))
_KEY = ("position", "set_index", "unscheduled_index")
_SCHEDULED = sa.DefaultClause("0")
sets = _create_table(
    "sets",
    rows.SetRow,
    _make_constraint("sets", *_KEY),
    unscheduled_index=_SCHEDULED,
    n_missed=sa.DefaultClause("0"),
    n_restrikes=sa.DefaultClause("0"),
)
# What the routes, `solimon status` and a start ask for is found in an index, never by reading every row:
# hours by the set that is due then (`reader.build_set_at_query`), states, the latest end.
_add_index(sets, "set_index")
_add_index(sets, "due_h")
_add_index(sets, "ended_utc_ns")
_add_index(sets, "state", "set_index")
_add_index(sets, "position", "state", "set_index")
shots = _create_table(
    "shots",
    rows.ShotRow,
    _make_constraint("shots", *_KEY, "shot_index", "attempt"),
    unscheduled_index=_SCHEDULED,
    outcome=sa.DefaultClause("accepted"),
)
features = _create_table(
    "features", rows.FeatureRow, unscheduled_index=_SCHEDULED, sequence=sa.ForeignKey("shots.sequence")
)
_add_index(features, *_KEY, "shot_index")
# One feature a set, and the trend of a position without reading past its shots.
sa.Index(
    "uq_features_set",
    *(features.c[name] for name in _KEY),
    unique=True,
    sqlite_where=features.c.shot_index.is_(None),
)
_add_index(features, "set_index")
thickness = _create_table(
    "thickness",
    rows.ThicknessRow,
    _make_constraint("thickness", *_KEY),
    unscheduled_index=_SCHEDULED,
    sequence=sa.ForeignKey("shots.sequence"),
)
_add_index(thickness, "set_index")
wall = _create_table("wall", rows.WallRow, _make_constraint("wall", *_KEY), unscheduled_index=_SCHEDULED)
_add_index(wall, "set_index")
environment = _create_table("environment", rows.EnvironmentRow, _make_constraint("environment", "set_index"))
_add_index(environment, "due_h")
baselines = _create_table(
    "baselines", rows.BaselineRow, _make_constraint("baselines", "name"), state=sa.DefaultClause("approved")
)
assessments = _create_table(
    "assessments",
    rows.AssessmentRow,
    _make_constraint("assessments", *_KEY),
    unscheduled_index=_SCHEDULED,
    baseline_id=sa.ForeignKey("baselines.id"),
)
_add_index(assessments, "set_index")
# The few unscheduled sets are found without reading past the others.
for _of_sets in (sets, shots, features, thickness, assessments):
    _few = _of_sets.c.unscheduled_index > sa.literal_column("0")
    sa.Index(f"ix_{_of_sets.name}_unscheduled", *(_of_sets.c[name] for name in _KEY[1:]), sqlite_where=_few)
alarms = _create_table("alarms", rows.AlarmRow, raised_unscheduled_index=_SCHEDULED)
_add_index(alarms, "position", "kind")
_add_index(alarms, "state")
_add_index(alarms, "position", "raised_set_index")
annotated = _create_table("annotations", rows.AnnotationRow)  # the other word is a feature of Python's
_add_index(annotated, "from_h")
events = _create_table("events", rows.EventRow, autoincrement=True, unscheduled_index=_SCHEDULED)
RARE_TOPICS = ("service", "alarms")
"""Topics with few events, each with its own index."""
for _topic in RARE_TOPICS:
    _few = events.c.topic == sa.literal(_topic, literal_execute=True)
    sa.Index(f"ix_events_{_topic}", events.c.kind, events.c.position, sqlite_where=_few)
commands = _create_table("commands", rows.CommandRow, autoincrement=True)
_add_index(commands, "state")
counts = _create_table("counts", rows.CountsRow)
trend_blocks = _create_table("trend_blocks", rows.TrendBlockRow)
assessor_states = _create_table("assessor_states", rows.AssessorStateRow)

KINDS = tuple(TABLES)
"""Kinds of rows; a referenced kind comes before the referring one."""
