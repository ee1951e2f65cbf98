"""A row of each table as a frozen dataclass: the one definition of the catalogue's columns.

Tables (`tables`), the API's answers (`web.answers.models`) and the payloads of events are made from
these. Times are integer nanoseconds of UTC, values SI with the unit in the name; None is "not
available", never zero. An id is None until its row is stored. A text in `Annotated` describes the
column in the API.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType, NoneType
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

from hardware_drivers.measurement import Purpose, SetKey
from hardware_drivers.methods import PULSE_ECHO, SOLITARY_WAVE, Method

Quality = Literal["good", "suspect", "bad"]
SetState = Literal["done", "partial", "missed", "disabled"]
Outcome = Literal["accepted", "superseded"]
AlarmClass = Literal["damage", "diagnostic"]
Priority = Literal["low", "medium", "high", "critical"]
AlarmState = Literal["normal", "unacknowledged", "acknowledged", "returned_unacknowledged"]
Suppression = Literal["shelved", "out_of_service"]
BaselineState = Literal["collecting", "proposed", "approved", "retired"]
CommandState = Literal["pending", "started", "done", "refused", "expired", "failed"]
SupplyState = Literal["on", "off", "unknown", "absent"]
ReadingQuality = Literal["good", "suspect", "stale", "lost", "absent"]


class Row:
    """Base of all rows."""

    __slots__: tuple[str, ...] = ()  # of a dataclass with slots: the names of its columns, in order


class RowOfSet(Row):
    """Base of the rows of a set.

    Attributes
    ----------
    position, set_index, unscheduled_index
        Position, index of the scheduled set, and number of the unscheduled set after it (0: none).
    """

    __slots__ = ()
    position: str
    set_index: int
    unscheduled_index: int

    @property
    def set_key(self) -> SetKey:
        """Return the key of the set."""
        return SetKey(self.set_index, self.unscheduled_index)


@dataclass(frozen=True, slots=True, kw_only=True)
class ExperimentRow(Row):
    """Which experiment a folder belongs to; there is one row."""

    id: int = 1
    name: str
    configuration_hash: str
    configuration: dict[str, Any]
    created_utc_ns: int
    epoch_utc_ns: int  # hour 0 of the experiment
    clock: str
    solimon_version: str
    uuid: str  # of the test, given when it is created
    site: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class SetRow(RowOfSet):
    """One set of one position; partial: some records are stored, missed: none."""

    id: int | None = None
    set_index: int
    unscheduled_index: int = 0
    position: str
    method: Method
    due_utc_ns: int
    due_h: float  # hours since the epoch
    started_utc_ns: int | None = None
    ended_utc_ns: int | None = None
    state: SetState
    cause: str | None = None  # why it is partial, missed or retired
    n_planned: int
    n_taken: int = 0
    n_valid: int = 0
    n_missed: Annotated[int, "Strikes that left no record"] = 0
    n_restrikes: Annotated[int, "Strikes repeated by the quality gate"] = 0
    file: str | None = None  # relative to the data folder
    file_sha256: Annotated[str | None, "Of the file, once it is made"] = None
    purpose: Annotated[
        Purpose | None, "`confirmation`: beside the plan, outside chart and baseline; null: planned"
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ShotRow(RowOfSet):
    """One stored shot; a pulse-echo record is a shot too."""

    sequence: int
    set_index: int
    unscheduled_index: int = 0
    position: str
    shot_index: int
    attempt: int
    utc_ns: int
    mono_ns: Annotated[int, "Monotonic ns within boot_id"]
    boot_id: str
    crc32: int
    valid: bool
    flags: list[str]  # clipped, missed, no_psw, noisy, ...
    outcome: Annotated[Outcome, "`superseded`: a repetition of the same shot counts instead"] = "accepted"


@dataclass(frozen=True, slots=True, kw_only=True)
class FeatureRow(RowOfSet):
    """Solitary-wave features of a shot, or of a set: the mean of its valid shots."""

    id: int | None = None
    set_index: int
    unscheduled_index: int = 0
    position: str
    shot_index: int | None  # None: the set's feature
    sequence: int | None
    due_h: float
    extractor_version: str
    quality: Quality
    n_valid: int
    # As `analysis.waves.features.ALL_FEATURE_NAMES`: a test compares them.
    tof_pp_s: float | None = None
    tof_ac_s: float | None = None
    amplitude_ratio: float | None = None
    autocorrelation_coefficient: float | None = None
    psw_area_v_s: float | None = None
    tof_mf_s: float | None = None
    isw_amplitude_v: float | None = None
    psw_amplitude_v: float | None = None
    ssw_amplitude_v: float | None = None
    isw_time_s: float | None = None
    psw_time_s: float | None = None
    ssw_time_s: float | None = None
    isw_fwhm_s: float | None = None
    psw_isw_area_ratio: float | None = None
    noise_rms_v: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ThicknessRow(RowOfSet):
    """Pulse-echo result of a set."""

    id: int | None = None
    set_index: int
    unscheduled_index: int = 0
    position: str
    sequence: int | None
    due_h: float
    extractor_version: str
    quality: Quality
    travel_time_s: float | None = None
    thickness_m: float | None = None
    thickness_loss_m: float | None = None
    correlation_coefficient: float | None = None
    interval_low_m: Annotated[float | None, "Of the 95 % interval of `thickness_m`"] = None
    interval_high_m: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class EnvironmentRow(Row):
    """Values of supply and climate probe around a set; None if not available."""

    id: int | None = None
    set_index: int
    due_h: float
    supply_state: SupplyState
    supply_quality: ReadingQuality
    supply_age_s: Annotated[float | None, "Of the newest reading, when the row was written"] = None
    supply_tripped: Annotated[str | None, "Why the interlock is open; null: it is closed"] = None
    voltage_v: Annotated[float | None, "Mean over the readings since the set before"] = None
    voltage_min_v: float | None = None
    voltage_max_v: float | None = None
    current_a: float | None = None
    current_min_a: float | None = None
    current_max_a: float | None = None
    charge_coulomb: Annotated[float | None, "Since hour 0, by measured current only"] = None
    unknown_s: Annotated[float | None, "Since hour 0: time whose current nobody measured"] = None
    climate_quality: ReadingQuality
    climate_age_s: float | None = None
    temperature_c: float | None = None
    relative_humidity: Annotated[float | None, "0 to 1"] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class BaselineRow(Row):
    """A baseline; its numbers never change once it is frozen, a new one gets a new id.

    The first baseline of a position gets its row when it is frozen, a later one when its collection starts.
    """

    id: int | None = None
    name: str
    position: str
    created_utc_ns: int = 0  # when it was stored; 0 until then
    first_set_index: int
    last_set_index: int
    n_sets: int
    feature_names: list[str]
    mean: list[float | None]  # (p,)
    covariance: list[list[float | None]]  # (p, p)
    limit_f_predictive: float | None = None  # two of `limits`, as columns: for trends and older clients
    limit_mean_3sd: float | None = None
    limit_reason: str | None = None  # why there is no limit
    approval: str  # "automatic", "by_a_person" until a person approves, or the name of that person
    provenance: dict[str, Any]  # set ids, suspects, extractor, versions
    limits: Annotated[
        dict[str, float] | None,
        "Every limit by its name (`/info` lists them); null: there is none",
    ] = None
    baseline_quality: Annotated[
        dict[str, Any] | None,
        "How far it can be trusted, and whether the chart keeps its rate",
    ] = None
    state: Annotated[
        BaselineState, "`collecting`, `proposed` until a person signs, `approved`, or `retired` by a person"
    ] = "approved"
    approved_utc_ns: int | None = None
    retired_utc_ns: int | None = None
    retired_by: str | None = None
    retired_reason: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class AssessmentRow(RowOfSet):
    """Assessment of a set by novelty detection."""

    id: int | None = None
    set_index: int
    unscheduled_index: int = 0
    position: str
    due_h: float
    baseline_id: int | None = None
    in_baseline: bool
    distance_squared: float | None = None
    limit_name: Annotated[str, "The limit beyond which the set is an outlier"]
    limit_f_predictive: float | None = None  # as in `BaselineRow`
    limit_mean_3sd: float | None = None
    outlier: bool | None = None  # None: not assessed, see reason
    outlier_mean_3sd: bool | None = None
    reason: str | None = None
    contributions: dict[str, float | None] | None = None  # {feature: part of distance_squared}
    mewma_statistic: Annotated[
        float | None, "Statistic of the chart that keeps the budget of false alarms"
    ] = None
    mewma_alarm: Annotated[bool | None, "Beyond the chart's limit, or not yet back; null: not judged"] = None
    statistics: Annotated[
        dict[str, float] | None, "The other statistics that limits bound, by name; null: not judged"
    ] = None
    limits: Annotated[
        dict[str, float] | None, "Every limit by its name (`/info` lists them); null: there is none"
    ] = None
    averages: Annotated[
        dict[str, list[float]] | None, "Exponentially weighted vector behind each chart; null: not judged"
    ] = None
    diagnosis: Annotated[
        str | None,
        "`ok`, `wall`, `sensor`, `coupling`, `environment` or `undetermined`; null: not judged",
    ] = None
    diagnosis_probability: Annotated[float | None, "Of that cause, or of the likeliest"] = None
    diagnosis_details: Annotated[
        dict[str, Any] | None,
        "Sentence and action for operators, probability of every cause and of a step, relative changes",
    ] = None
    confirms: Annotated[
        bool | None,
        "Of a confirmation set: it lies where the planned sets before it do, not where the baseline does; "
        "null: it cannot tell, or the set is a planned one",
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmRow(Row):
    """One alarm (ISA-18.2 states) with its evidence; every change is also an event."""

    id: int | None = None
    position: str | None  # None: the service itself
    kind: str  # "wall_change", "no_reflection", "thickness_low", "few_valid_shots", ...
    alarm_class: AlarmClass
    priority: Priority
    state: AlarmState
    raised_utc_ns: int
    raised_h: float
    raised_set_index: int | None = None
    raised_unscheduled_index: int = 0
    changed_utc_ns: int
    cleared_utc_ns: int | None = None
    acknowledged_utc_ns: int | None = None
    acknowledged_by: str | None = None
    note: str | None = None
    message: str
    evidence: dict[str, Any]  # sets, features, baseline, limit, formula, contributions, versions
    suppressed: Annotated[
        Suppression | None, "A person does not want to be told: `shelved` for a while, or `out_of_service`"
    ] = None
    suppressed_by: str | None = None
    suppressed_reason: str | None = None
    shelved_until_utc_ns: int | None = None  # on the experiment's clock
    shelved_until_wall_utc_ns: int | None = None  # in real time; whichever comes first ends it

    @property
    def raised_set_key(self) -> SetKey | None:
        """Return the key of the set with which it was raised; None without one."""
        index = self.raised_set_index
        return None if index is None else SetKey(index, self.raised_unscheduled_index)


@dataclass(frozen=True, slots=True, kw_only=True)
class AnnotationRow(Row):
    """A person's note for an hour or a range of hours; it is withdrawn, never deleted."""

    id: int | None = None
    position: Annotated[str | None, "null: the whole test"] = None
    from_h: float
    to_h: Annotated[float, "The same as `from_h`: an instant"]
    text: str
    author: str
    written_utc_ns: int
    withdrawn_utc_ns: int | None = None
    withdrawn_by: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class EventRow(Row):
    """One event: its ids increase and are never used again."""

    id: int | None = None
    utc_ns: int  # experiment time
    wall_utc_ns: int = 0  # when it was written; 0 until then
    topic: str  # "sets", "features", "assessments", "alarms", ...: the list is `web.routes.stream.TOPICS`
    kind: str  # "set_done", "alarm_raised", "recorder_started", "gap", ...
    position: str | None = None
    set_index: int | None = None
    unscheduled_index: int = 0
    payload: dict[str, Any]

    @property
    def set_key(self) -> SetKey | None:
        """Return the key of its set; None without one."""
        return None if self.set_index is None else SetKey(self.set_index, self.unscheduled_index)


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandRow(Row):
    """A command of an operator, and the recorder's answer.

    ``started`` is stored before the act: what a recorder died over is never carried out a second time.
    """

    id: int
    wall_utc_ns: int
    author: str
    kind: str  # "finish_now", "stop", "pause", "disable", ...
    arguments: dict[str, Any]
    state: CommandState
    result: str | None = None
    finished_wall_utc_ns: int | None = None
    deadline_wall_utc_ns: int | None = None  # if it has not started by then, it expires
    deadline_boot_ns: Annotated[int | None, "The same in ns of the boot `boot_id`, sleep included"] = None
    boot_id: str | None = None  # None where the system names no boot


@dataclass(frozen=True, slots=True, kw_only=True)
class CountsRow(Row):
    """Current numbers of sets, records and events, updated with every commit; there is one row."""

    id: int = 1
    sets: int = 0  # due times with at least one record
    missed_sets: int = 0  # due times that were missed altogether
    partial_sets: int = 0  # of the `sets`, those that lack something
    shots: int = 0  # solitary waves
    pulse_echo_records: int = 0
    events: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class TrendBlockRow(Row):
    """Summary of some sets of a position, derived from their rows (see `rollups`)."""

    place: str  # position, pyramid, sets of the block, its first set
    block: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class AssessorStateRow(Row):
    """Part of the state of a position's assessor after its newest set (`assessment.position_assessors`)."""

    place: str  # position and part
    position: str
    baseline_id: int | None  # of the baseline that the state belongs to; None for a probe
    configuration_hash: str  # of the settings that it was computed with
    format: int
    state: str  # JSON


MEASURED_BY: Mapping[Method, type[FeatureRow] | type[ThicknessRow]] = MappingProxyType(
    {SOLITARY_WAVE: FeatureRow, PULSE_ECHO: ThicknessRow}
)
"""Kind of row of each method's results."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """A field of a row; ``description`` is its text in the API, None if its name suffices."""

    name: str
    type: Any
    nullable: bool
    description: str | None


def columns_of(kind: type[Row]) -> tuple[Column, ...]:
    """Return the columns of a kind of row in order; the first one is the primary key."""
    columns = []
    hints = get_type_hints(kind, include_extras=True)
    for name in kind.__slots__:
        hint = hints[name]
        of_type, description = get_args(hint) if get_origin(hint) is Annotated else (hint, None)
        columns.append(
            Column(name=name, type=of_type, nullable=NoneType in get_args(of_type), description=description)
        )
    return tuple(columns)


def measured(kind: type[Row]) -> tuple[str, ...]:
    """Return the names of the nullable values of a measurement's row."""
    return tuple(item.name for item in fields(kind) if item.default is None and item.name != "id")  # type: ignore[arg-type] # every kind of row is a dataclass


def values(row: Row) -> dict[str, Any]:
    """Return the value of each column by name, in order; nested values are not copied."""
    return {name: getattr(row, name) for name in row.__slots__}


def payload_of(row: Row, *, last: str = "") -> dict[str, object]:
    """Return the row as payload of its event: without a missing id, column ``last`` at the end."""
    columns = {name: value for name, value in values(row).items() if name != "id" or value is not None}
    return {name: columns[name] for name in sorted(columns, key=last.__eq__)}
