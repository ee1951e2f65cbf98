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
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args, get_origin, get_type_hints

from hardware_drivers.measurement import OfSet, Purpose, SetKey
from hardware_drivers.methods import PULSE_ECHO, SOLITARY_WAVE, Method

Quality = Literal["good", "suspect", "bad"]
SetState = Literal["done", "partial", "missed", "disabled"]
Outcome = Literal["accepted", "superseded"]
AlarmClass = Literal["damage", "diagnostic"]
Priority = Literal["low", "medium", "high", "critical"]
AlarmState = Literal["normal", "unacknowledged", "acknowledged", "returned_unacknowledged"]
Suppression = Literal["shelved", "out_of_service"]
BaselineState = Literal["collecting", "proposed", "approved", "retired"]
CommandState = Literal["pending", "started", "done", "rejected", "expired", "failed"]
SupplyState = Literal["on", "off", "unknown", "absent"]
ReadingQuality = Literal["good", "suspect", "stale", "no_communication", "absent"]
Position = Annotated[str, "Monitored position, as the configuration names it"]
SetIndex = Annotated[int, "Index of the scheduled set, from 0"]
UnscheduledIndex = Annotated[int, "0: the scheduled set itself; n: the n-th unscheduled set after it"]
DueH = Annotated[float, "Hour of the test at which the set is due"]
LimitFPredictive = Annotated[float | None, "Predictive F limit of `distance_squared`; null: none yet"]
LimitMean3Sd = Annotated[float | None, "Limit mean + 3 SD of `distance_squared`; null: none yet"]
Limits = Annotated[
    dict[str, float] | None, "Every limit by its name (`/info` lists them); null: there is none"
]


class Row:
    """Base of all rows."""

    __slots__: tuple[str, ...] = ()  # of a dataclass with slots: the names of its columns, in order


class RowOfSet(OfSet, Row):
    """Base of the rows of a set at a position."""

    __slots__ = ()
    if TYPE_CHECKING:  # the column is that of the rows
        position: str


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
    set_index: SetIndex
    unscheduled_index: UnscheduledIndex = 0
    position: Position
    method: Annotated[Method, "Measuring method"]
    due_utc_ns: int
    due_h: DueH
    started_utc_ns: Annotated[int | None, "Time of its first strike; null: none"] = None
    ended_utc_ns: Annotated[int | None, "Time of its last record; null: none"] = None
    state: Annotated[SetState, "Result of the set"]
    reason: Annotated[str | None, "Why the set is not complete; null: it is"] = None
    n_planned: Annotated[int, "Planned shots"]
    n_taken: Annotated[int, "Stored shots"] = 0
    n_valid: Annotated[int, "Valid shots"] = 0
    n_missed: Annotated[int, "Strikes that left no record"] = 0
    n_restrikes: Annotated[int, "Strikes repeated by the quality gate"] = 0
    file: Annotated[str | None, "Set file, relative to the data folder; null: none yet"] = None
    file_sha256: Annotated[str | None, "SHA-256 of the file; null: none yet"] = None
    purpose: Annotated[
        Purpose | None, "`confirmation`: unscheduled, outside chart and baseline; null: scheduled"
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ShotRow(RowOfSet):
    """One stored shot; a pulse-echo record is a shot too."""

    sequence: Annotated[int, "Number of the record in the order of acquisition"]
    set_index: SetIndex
    unscheduled_index: UnscheduledIndex = 0
    position: Position
    shot_index: Annotated[int, "Index of the shot in its set, from 0; null: the complete set"]
    attempt: Annotated[int, "Number of the strike for this shot, from 0: the quality gate repeats some"]
    utc_ns: int
    mono_ns: Annotated[int, "Monotonic ns within boot_id"]
    boot_id: Annotated[str, "Boot of the computer; null: the system does not name it"]
    crc32: Annotated[int, "CRC-32 of the samples"]
    valid: Annotated[bool, "The shot is valid"]
    flags: Annotated[list[str], "Flags of the quality gate"]
    outcome: Annotated[Outcome, "`superseded`: a repetition of the same shot counts instead"] = "accepted"


@dataclass(frozen=True, slots=True, kw_only=True)
class FeatureRow(RowOfSet):
    """Solitary-wave features of a shot, or of a set: the mean of its valid shots."""

    id: int | None = None
    set_index: SetIndex
    unscheduled_index: UnscheduledIndex = 0
    position: Position
    shot_index: Annotated[int | None, "Index of the shot in its set, from 0; null: the complete set"]
    sequence: Annotated[int | None, "Number of the record in the order of acquisition"]
    due_h: DueH
    extractor_version: Annotated[str, "Version of the code that computed the values"]
    quality: Annotated[Quality, "Quality of the value"]
    n_valid: Annotated[int, "Valid shots"]
    # As `analysis.waves.features.ALL_FEATURE_NAMES`: a test compares them.
    tof_pp_s: Annotated[float | None, "Time of flight between incident and reflected peak"] = None
    tof_ac_s: Annotated[float | None, "Time of flight by autocorrelation"] = None
    amplitude_ratio: Annotated[float | None, "Reflected peak divided by incident peak"] = None
    autocorrelation_coefficient: Annotated[float | None, "Second peak of the autocorrelation"] = None
    psw_area_v_s: Annotated[float | None, "Area below the reflected wave"] = None
    tof_mf_s: Annotated[float | None, "Time of flight by matched filter"] = None
    isw_amplitude_v: Annotated[float | None, "Peak of the incident wave"] = None
    psw_amplitude_v: Annotated[float | None, "Peak of the primary reflected wave"] = None
    ssw_amplitude_v: Annotated[float | None, "Peak of the secondary reflected wave; null: none"] = None
    isw_time_s: Annotated[float | None, "Time of the incident peak after the trigger"] = None
    psw_time_s: Annotated[float | None, "Time of the primary reflected peak after the trigger"] = None
    ssw_time_s: Annotated[float | None, "Time of the secondary reflected peak after the trigger"] = None
    isw_fwhm_s: Annotated[float | None, "Full width at half maximum of the incident wave"] = None
    psw_isw_area_ratio: Annotated[float | None, "Reflected area divided by incident area"] = None
    noise_rms_v: Annotated[float | None, "RMS noise before the incident wave"] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ThicknessRow(RowOfSet):
    """Pulse-echo result of a set."""

    id: int | None = None
    set_index: SetIndex
    unscheduled_index: UnscheduledIndex = 0
    position: Position
    sequence: Annotated[int | None, "Number of the record in the order of acquisition"]
    due_h: DueH
    extractor_version: Annotated[str, "Version of the code that computed the values"]
    quality: Annotated[Quality, "Quality of the value"]
    travel_time_s: Annotated[float | None, "Travel time of the echo through the wall and back"] = None
    thickness_m: Annotated[float | None, "Wall thickness"] = None
    thickness_loss_m: Annotated[float | None, "Wall loss since the start of the test"] = None
    correlation_coefficient: Annotated[float | None, "Correlation of the echo with the reference"] = None
    interval_low_m: Annotated[float | None, "Lower end of the 95 % interval of `thickness_m`"] = None
    interval_high_m: Annotated[float | None, "Upper end of the 95 % interval of `thickness_m`"] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class WallRow(RowOfSet):
    """Wall thickness from the solitary waves of a set: mean over a disc of 10 mm radius at the contact."""

    id: int | None = None
    set_index: SetIndex
    unscheduled_index: UnscheduledIndex = 0
    position: Position
    due_h: DueH
    extractor_version: Annotated[str, "Version of the code that computed the features"]
    quality: Annotated[Quality, "`suspect`: diagnosed as sensor or coupling, or only an upper end is known"]
    thickness_m: Annotated[float | None, "Wall thickness, median"] = None
    interval_low_m: Annotated[float | None, "Lower end of the 90 % interval of `thickness_m`"] = None
    interval_high_m: Annotated[float | None, "Upper end of the 90 % interval of `thickness_m`"] = None
    loss_rate_m_per_s: Annotated[float | None, "Rate of the wall loss, median"] = None
    minimum_m: Annotated[float | None, "Minimum wall of the configuration; null: none"] = None
    below_minimum_probability: Annotated[float | None, "Probability of a wall below its minimum"] = None
    time_to_minimum_s: Annotated[float | None, "Time until the minimum at this rate, median"] = None
    time_to_minimum_low_s: Annotated[float | None, "The same, 5 % quantile"] = None
    forecast_h: Annotated[float | None, "Hour of the forecast at this rate; null: none"] = None
    forecast_m: Annotated[float | None, "Wall thickness at that hour, median"] = None
    forecast_low_m: Annotated[float | None, "Lower end of the 90 % interval of `forecast_m`"] = None
    forecast_high_m: Annotated[float | None, "Upper end of the 90 % interval of `forecast_m`"] = None
    curve: Annotated[str | None, "Most likely wall curve of the twin: model, shape, size"] = None
    reason: Annotated[str | None, "Why there is no thickness, or it is not good; null: it is"] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class EnvironmentRow(Row):
    """Values of supply and climate probe around a set; None if not available."""

    id: int | None = None
    set_index: SetIndex
    due_h: DueH
    supply_state: Annotated[SupplyState, "Output of the supply"]
    supply_quality: Annotated[ReadingQuality, "Freshness of the supply's reading"]
    supply_age_s: Annotated[float | None, "Age of the newest reading when the row was written"] = None
    supply_tripped: Annotated[str | None, "Why the interlock is open; null: it is closed"] = None
    voltage_v: Annotated[float | None, "Mean over the readings since the set before"] = None
    voltage_min_v: Annotated[float | None, "Minimum of these readings"] = None
    voltage_max_v: Annotated[float | None, "Maximum of these readings"] = None
    current_a: Annotated[float | None, "Mean over the readings since the set before"] = None
    current_min_a: Annotated[float | None, "Minimum of these readings"] = None
    current_max_a: Annotated[float | None, "Maximum of these readings"] = None
    charge_coulomb: Annotated[float | None, "Since hour 0, by measured current only"] = None
    unknown_s: Annotated[float | None, "Time since hour 0 without a measured current"] = None
    climate_quality: Annotated[ReadingQuality, "Freshness of the climate's reading"]
    climate_age_s: Annotated[float | None, "Age of the newest reading when the row was written"] = None
    temperature_c: Annotated[float | None, "Air temperature"] = None
    relative_humidity: Annotated[float | None, "0 to 1"] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class BaselineRow(Row):
    """A baseline; its numbers never change once it is frozen, a new one gets a new id.

    The first baseline of a position gets its row when it is frozen, a later one when its collection starts.
    """

    id: int | None = None
    name: str
    position: Position
    created_utc_ns: int = 0  # when it was stored; 0 until then
    first_set_index: Annotated[int, "First set of the baseline, planned if it is collecting"]
    last_set_index: Annotated[int, "Last set of the baseline, planned if it is collecting"]
    n_sets: int
    feature_names: Annotated[list[str], "Features of the baseline, in the order of `mean`"]
    mean: Annotated[list[float | None], "Mean of each feature in its own unit, shape (p,)"]
    covariance: Annotated[list[list[float | None]], "Covariance in products of these units, shape (p, p)"]
    limit_f_predictive: LimitFPredictive = None
    limit_mean_3sd: LimitMean3Sd = None
    limit_reason: Annotated[str | None, "Why there is no limit; null: there is one"] = None
    approval: Annotated[str, "`automatic`, `by_a_person` until a person approves, or the name of that person"]
    provenance: Annotated[dict[str, Any], "Set ids, suspects, extractor, versions"]
    limits: Limits = None
    baseline_quality: Annotated[
        dict[str, Any] | None,
        "How far it can be trusted, and whether the chart keeps its rate",
    ] = None
    state: Annotated[
        BaselineState, "`collecting`, `proposed` until approval, `approved`, or `retired` by a person"
    ] = "approved"
    approved_utc_ns: Annotated[int | None, "Time of approval on the test clock; null: none"] = None
    retired_utc_ns: Annotated[int | None, "Time of retirement on the test clock; null: none"] = None
    retired_by: Annotated[str | None, "Person who retired it"] = None
    retired_reason: Annotated[str | None, "Reason of the retirement"] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class AssessmentRow(RowOfSet):
    """Assessment of a set by novelty detection."""

    id: int | None = None
    set_index: SetIndex
    unscheduled_index: UnscheduledIndex = 0
    position: Position
    due_h: DueH
    baseline_id: Annotated[int | None, "Baseline of the assessment; null: none"] = None
    in_baseline: Annotated[bool, "The set belongs to the baseline"]
    distance_squared: Annotated[float | None, "Squared Mahalanobis distance from the baseline"] = None
    limit_name: Annotated[str, "The limit above which the set is an outlier"]
    limit_f_predictive: LimitFPredictive = None
    limit_mean_3sd: LimitMean3Sd = None
    outlier: Annotated[bool | None, "Above the limit `limit_name`; null: not assessed"] = None
    outlier_mean_3sd: Annotated[bool | None, "Above `limit_mean_3sd`; null: not assessed"] = None
    reason: Annotated[str | None, "Why there is no assessment; null: there is one"] = None
    contributions: Annotated[dict[str, float | None] | None, "Part of `distance_squared` of each feature"] = (
        None
    )
    mewma_statistic: Annotated[
        float | None, "Statistic of the chart that keeps the budget of false alarms"
    ] = None
    mewma_alarm: Annotated[bool | None, "Above the chart's limit, or not yet back; null: not assessed"] = None
    statistics: Annotated[
        dict[str, float] | None, "The other statistics that limits bound, by name; null: not assessed"
    ] = None
    limits: Limits = None
    averages: Annotated[
        dict[str, list[float]] | None, "Exponentially weighted vector of each chart; null: not assessed"
    ] = None
    diagnosis: Annotated[
        str | None,
        "`ok`, `wall`, `sensor`, `coupling`, `environment` or `undetermined`; null: not assessed",
    ] = None
    diagnosis_probability: Annotated[float | None, "Probability of that class, or of the likeliest"] = None
    diagnosis_details: Annotated[
        dict[str, Any] | None,
        "Sentence and action for operators, probability of every cause and of a step, relative changes",
    ] = None
    confirms: Annotated[
        bool | None,
        "A confirmation set agrees with the scheduled sets before it, not with the baseline; "
        "null: undecided, or a scheduled set",
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmRow(Row):
    """One alarm (ISA-18.2 states) with its evidence; every change is also an event."""

    id: int | None = None
    position: Annotated[str | None, "Monitored position; null: the complete test"]
    kind: Annotated[str, "Kind of alarm, from a fixed list"]
    alarm_class: Annotated[AlarmClass, "Damage of the wall, or a fault of a device"]
    priority: Annotated[Priority, "Priority of the alarm"]
    state: Annotated[AlarmState, "State according to ISA-18.2"]
    raised_utc_ns: Annotated[int, "Time when it was raised, on the test clock"]
    raised_h: Annotated[float, "Hour of the test when it was raised"]
    raised_set_index: Annotated[int | None, "Set with which it was raised; null: none"] = None
    raised_unscheduled_index: UnscheduledIndex = 0
    changed_utc_ns: Annotated[int, "Time of its last change, on the test clock"]
    cleared_utc_ns: Annotated[int | None, "Time when the condition ended; null: it has not"] = None
    acknowledged_utc_ns: Annotated[int | None, "Time of the acknowledgement; null: none"] = None
    acknowledged_by: Annotated[str | None, "Person who acknowledged it; null: none"] = None
    note: str | None = None
    message: Annotated[str, "Headline, key evidence, action"]
    evidence: dict[str, Any]  # sets, features, baseline, limit, formula, contributions, versions
    suppressed: Annotated[
        Suppression | None, "Suppressed by a person: `shelved` for a while, or `out_of_service`"
    ] = None
    suppressed_by: Annotated[str | None, "Person who shelved it or took it out of service; null: none"] = None
    suppressed_reason: Annotated[str | None, "Reason of the suppression; null: none"] = None
    shelved_until_utc_ns: Annotated[int | None, "End of the shelving on the test clock; null: none"] = None
    shelved_until_wall_utc_ns: Annotated[int | None, "The same in real time; the first one ends it"] = None

    @property
    def raised_set_key(self) -> SetKey | None:
        """Return the key of the set with which it was raised; None without one."""
        index = self.raised_set_index
        return None if index is None else SetKey(index, self.raised_unscheduled_index)


@dataclass(frozen=True, slots=True, kw_only=True)
class AnnotationRow(Row):
    """A person's note for an hour or a range of hours; it is withdrawn, never deleted."""

    id: int | None = None
    position: Annotated[str | None, "null: the complete test"] = None
    from_h: float
    to_h: Annotated[float, "The same as `from_h`: an instant"]
    text: str
    author: str
    written_utc_ns: Annotated[int, "Time when it was written"]
    withdrawn_utc_ns: Annotated[int | None, "Time when it was withdrawn; null: it was not"] = None
    withdrawn_by: Annotated[str | None, "Person who withdrew it; null: none"] = None


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
        """Return the key of the set that the event is about; None without one."""
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
    arguments: Annotated[dict[str, Any], "Arguments of the command, by kind"]
    state: Annotated[CommandState, "State of the command"]
    result: Annotated[str | None, "Result; null: none yet"] = None
    finished_wall_utc_ns: Annotated[int | None, "Time of its end by the computer's clock; null: none yet"] = (
        None
    )
    deadline_wall_utc_ns: Annotated[int | None, "Not started by then, it expires; null: no deadline"] = None
    deadline_boot_ns: Annotated[int | None, "The same in ns of the boot `boot_id`, sleep included"] = None
    boot_id: Annotated[str | None, "Boot of the computer; null: the system does not name it"] = None


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
    """Part of the state of a position's assessor after its newest set (`recording.set_assessor`)."""

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
MEASURED: Mapping[type[Row], tuple[str, ...]] = MappingProxyType(
    {
        kind: tuple(item.name for item in fields(kind) if item.default is None and item.name != "id")
        for kind in MEASURED_BY.values()
    }
)
"""Names of the nullable values of a measurement's row."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """A field of a row; ``description`` is its text in the API, None if its name suffices."""

    name: str
    type: Any
    nullable: bool
    description: str | None

    @property
    def published_name(self) -> str:
        """Return the name in the API and in tables: ``_utc_ns`` becomes ``_utc``, whose values are text."""
        is_time = self.name == "utc_ns" or self.name.endswith("_utc_ns")
        return self.name.removesuffix("_ns") if is_time else self.name


def list_columns(kind: type[object]) -> tuple[Column, ...]:
    """List the fields of a dataclass in order; of a kind of row, the first one is the primary key."""
    columns = []
    for name, hint in get_type_hints(kind, include_extras=True).items():
        of_type, description = get_args(hint) if get_origin(hint) is Annotated else (hint, None)
        if name != "__slots__":
            nullable = NoneType in get_args(of_type)
            columns.append(Column(name=name, type=of_type, nullable=nullable, description=description))
    return tuple(columns)


def as_dict(row: Row) -> dict[str, Any]:
    """Convert a row to a new dictionary of its columns, in order; nested values are not copied."""
    return {name: getattr(row, name) for name in row.__slots__}
