"""Models of the answers, for OpenAPI and for its contract test.

Routes answer with rows that they already trust, encoded by orjson; nothing is validated again on
the way out (10,000 rows: 2.4 ms instead of 37 ms). The tests hold every answer against these models.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import date
from types import GenericAlias
from typing import Any, Generic, Literal, TypeVar, cast

from pydantic import BaseModel, ConfigDict, Field, create_model

from daq_service.alarms import guidance
from daq_service.assessment.position_status import PositionStatus
from daq_service.catalogue import rows
from daq_service.catalogue.published_columns import PublishedColumn
from daq_service.catalogue.rows import Priority, Quality
from daq_service.commands import audit
from daq_service.corrosion_drive.supply_state import SupplyStatus
from daq_service.processes.disk_policy import Outlook
from daq_service.processes.notifications.delivery_log import Delivery
from daq_service.processes.notifications.receiver import State
from daq_service.processes.recorder_state import RecorderStatus
from daq_service.web.answers.problem import MEDIA_TYPE, ProblemDetails
from daq_service.web.answers.vocabulary import VOCABULARY
from hardware_drivers.methods import Method

A = TypeVar("A", bound="Answer")
Fields = dict[str, Any]
"""Types and defaults by name, as `create_model` takes them."""

PROBLEMS: dict[int | str, dict[str, object]] = {
    status: {
        "description": text,
        "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/ProblemDetails"}}},
    }
    for status, text in VOCABULARY.problems.items()
}


def build_problem_schemas() -> dict[str, object]:
    """Build the JSON Schemas of error answers by name, for the components of OpenAPI."""
    schema = ProblemDetails.model_json_schema(ref_template="#/components/schemas/{model}")
    return {**schema.pop("$defs"), "ProblemDetails": schema}


def describe_errors(*statuses: int) -> dict[int | str, dict[str, object]]:
    """Return the OpenAPI descriptions of error answers by HTTP status; raise KeyError for an unknown one."""
    return {status: PROBLEMS[status] for status in statuses}


def describe_files(*media_types: str) -> dict[int | str, dict[str, object]]:
    """Return the OpenAPI description of an answer that is a binary file of one of some media types."""
    binary = {"schema": {"type": "string", "format": "binary"}}
    return {200: {"content": dict.fromkeys(media_types, binary)}}


UNCHANGED: dict[int | str, dict[str, object]] = {
    304: {"description": "The client's copy, named by If-None-Match, is this answer."}
}


class Answer(BaseModel):
    """Base of all answers, without undocumented fields."""

    model_config = ConfigDict(extra="forbid")


def _copy_fields_of(kind: type[object], *without: str) -> Callable[[type[A]], type[A]]:
    """Return a class decorator that adds the fields of a dataclass, such as a catalogue row, to an answer.

    ``*_utc_ns`` leaves as RFC 3339 text ``*_utc``; the hour ``due_h`` brings its ``due_utc``, and an hour of
    the data their age. Fields of the decorated class take precedence; those in ``without`` are left out.
    """

    def add_fields(answer: type[A]) -> type[A]:
        """Create an answer model of the same name with the fields of the dataclass and of the given class."""
        fields: Fields = {}
        for column in rows.list_columns(kind):
            if column.name in ("due_utc_ns", *without):
                continue
            of_type: object = column.type
            if column.name == "id":
                of_type = int
            elif column.published_name != column.name:
                of_type = str | None if column.nullable else str
            fields[column.published_name] = (of_type, Field(description=column.description))
            if column.name == "due_h":
                fields["due_utc"] = (str, ...)
        fields |= {name: (field.annotation, field) for name, field in answer.model_fields.items()}
        if fields.keys() & {"due_h", "raised_h"}:
            fields["age_h"] = (float, ...)
        model = create_model(answer.__name__, __base__=Answer, __doc__=answer.__doc__, **fields)
        return cast(type[A], model)

    return add_fields


class AsOf(Answer):
    """Freshness of an answer, on the test clock and on the wall clock."""

    clock: Literal["simulated", "wall"]
    now_utc: str
    now_h: float
    last_write_wall_utc: str | None
    wall_age_s: float | None
    recorder: RecorderStatus
    pace_h_per_s: float | None = None


class Dated(Answer):
    """Base of the answers that state how fresh they are."""

    as_of: AsOf


@_copy_fields_of(rows.SetRow)
class SetRow(Answer):
    """One set of one position."""


@_copy_fields_of(rows.ShotRow)
class ShotRow(Answer):
    """One stored shot."""


@_copy_fields_of(rows.FeatureRow)
class FeatureRow(Answer):
    """Features of a shot, or of a set (shot_index null): mean of its valid shots."""

    standard_error: dict[str, float | None] | None = None


@_copy_fields_of(rows.ThicknessRow)
class ThicknessRow(Answer):
    """Pulse-echo result of a set."""


@_copy_fields_of(rows.WallRow)
class WallRow(Answer):
    """Wall thickness from the solitary waves of a set."""

    forecast_utc: str | None


@_copy_fields_of(rows.AssessmentRow)
class AssessmentRow(Answer):
    """Result of the novelty detection of a set."""

    quality: Quality | None


@_copy_fields_of(rows.BaselineRow)
class BaselineRow(Answer):
    """Baseline; the first, still collecting one of a position has its future id."""

    n_sets: int
    from_h: float
    from_utc: str
    to_h: float
    to_utc: str
    temperature_c: list[float] | None


class AlarmRule(Answer):
    """Rule of an alarm: `k` of `n` sets for a wall change, shots of consecutive sets for no reflection."""

    false_alarms_per_sensor_year: float | None = None
    k: int | None = None
    n: int | None = None
    shots: int | None = None
    consecutive_sets: int | None = None


class ConfirmationSet(Answer):
    """Result of an unscheduled confirmation set."""

    set_index: int
    unscheduled_index: int
    utc_ns: int
    due_h: float
    confirms: bool | None
    distance_squared: float | None
    limit: float | None
    reason: str | None


class AlarmEvidence(BaseModel):
    """Evidence of an alarm: fields by kind; for the supply, the columns of environment."""

    model_config = ConfigDict(extra="allow")

    formula: str | None = None
    rule: AlarmRule | None = None
    set_index: int | None = None
    unscheduled_index: int | None = None
    distance_squared: float | None = None
    limit_name: str | None = None
    raised_by: str | None = None
    mewma_statistic: float | None = None
    limit: float | None = None
    rate_verified: bool | None = None
    rate_not_verified_reason: str | None = None
    baseline_id: int | None = None
    contributions: dict[str, float | None] | None = None
    confirmation: ConfirmationSet | None = None
    thickness_m: float | None = None
    interval_m: list[float] | None = None
    roughness_rms_m: float | None = None
    below_minimum_probability: float | None = None
    limit_m: float | None = None
    travel_time_s: float | None = None
    reference_travel_time_s: float | None = None
    delay_s: float | None = None
    consecutive_poor_sets: int | None = None
    minimum_valid_shots: int | None = None
    shots_without_psw: int | None = None
    shots: int | None = None
    reason: str | None = None
    author: str | None = None
    note: str | None = None
    error_message: str | None = None
    stopped: bool | None = None
    free_percent: float | None = None
    stop_percent: float | None = None
    free_gb: float | None = None
    waits_in: str | None = None
    error: str | None = None
    command_id: int | None = None
    set_aside: list[str] | None = None
    damaged: dict[str, str] | None = None
    extractor_version: str | None = None


@_copy_fields_of(rows.AlarmRow)
class AlarmRow(Answer):
    """Alarm with its texts and its evidence."""

    headline: str
    action: str
    response_time_s: float
    evidence: AlarmEvidence
    evidence_sentences: list[str]


@_copy_fields_of(rows.CommandRow)
class CommandRow(Answer):
    """Command of an operator and its result."""

    expires_in_s: float | None


class Page(Dated, Generic[A]):
    """Frame of every listing."""

    next_cursor: str | None
    items: list[A]


class SetPage(Page[SetRow]):
    """Sets in order."""


class ShotPage(Page[ShotRow]):
    """Shots in order."""


class FeaturePage(Page[FeatureRow]):
    """Features in order."""


class ThicknessPage(Page[ThicknessRow]):
    """Pulse-echo results in order."""


class WallPage(Page[WallRow]):
    """Wall thickness from solitary waves in order."""


class AssessmentPage(Page[AssessmentRow]):
    """Assessments in order."""


class AlarmPage(Page[AlarmRow]):
    """Alarms in order."""


class AlarmTransition(Answer):
    """Transition of an alarm at a moment."""

    event_id: int
    kind: str
    utc: str
    wall_utc: str
    state: rows.AlarmState
    priority: Priority
    suppressed: rows.Suppression | None
    author: str | None
    reason: str | None
    shelved_until_utc: str | None


class AlarmHistory(Dated):
    """Every transition of an alarm, the oldest first."""

    items: list[AlarmTransition]


@_copy_fields_of(guidance.Guidance)
class Guidance(Answer):
    """Guidance for a kind of alarm."""

    kind: str


class GuidanceList(Answer):
    """Guidance for every kind of alarm."""

    items: list[Guidance]


@_copy_fields_of(rows.AnnotationRow)
class AnnotationRow(Answer):
    """Annotation of an hour of the test, or of a range."""

    from_utc: str
    to_utc: str


class AnnotationPage(Page[AnnotationRow]):
    """Annotations in order."""


@_copy_fields_of(rows.EnvironmentRow)
class EnvironmentRow(Answer):
    """Supply and climate around a set; null where there was no reading."""


class EnvironmentPage(Page[EnvironmentRow]):
    """Supply and climate in order."""


@_copy_fields_of(SupplyStatus)
class SupplyNow(Answer):
    """Present status of the supply, from the supply process, also without a recorder."""


class EnvironmentNow(Dated):
    """Supply and climate around the newest set, and the supply now."""

    latest: EnvironmentRow | None
    supply_now: SupplyNow | None


@_copy_fields_of(PublishedColumn, "nullable")
class TableColumn(Answer):
    """A column of an exported table."""


class TableInfo(Answer):
    """A table that can be exported."""

    table: str
    description: str
    columns: list[TableColumn]


class TableList(Answer):
    """Tables, and the formats that this installation writes."""

    formats: list[str]
    items: list[TableInfo]


class BaselineList(Dated):
    """Every baseline, retired and collecting ones too, oldest first."""

    items: list[BaselineRow]


class PositionStanding(Answer):
    """Status of a monitored position."""

    position: str
    label: str
    method: Method
    state: PositionStatus
    stale: bool
    data_h: float | None
    age_h: float | None


class PositionState(PositionStanding):
    """Present state of a monitored position."""

    serial_number: str
    data_utc: str | None
    last_set: SetRow | None
    last_feature: FeatureRow | None
    last_thickness: ThicknessRow | None
    last_wall: WallRow | None
    last_assessment: AssessmentRow | None
    disabled_reason: str | None
    active_alarms: int
    suppressed_alarms: int
    shelved_until_utc: str | None
    highest_priority: Priority | None


class PositionList(Dated):
    """All monitored positions."""

    items: list[PositionState]


class ClockInfo(Answer):
    """Clock of the test."""

    kind: Literal["simulated", "wall"]
    epoch_utc: str
    pace_h_per_s: float | None
    system_ahead_s: float | None
    can_finish_now: bool


class ScheduleInfo(Answer):
    """Schedule of the test."""

    n_sets: int
    end_h: float
    baseline_h: float
    shots_per_set: int


class CalibrationInfo(Answer):
    """External calibration of a position's sensor, by its certificate."""

    certificate: str
    calibrated_on: date | None
    due_on: date | None
    sensitivity_v_per_n: float | None


class PositionInfo(Answer):
    """Configuration of a position."""

    position: str
    label: str
    method: Method
    serial_number: str
    calibration: CalibrationInfo
    minimum_wall_m: float | None


class NamedLimitInfo(Answer):
    """Limit of a statistic; baselines and assessments hold its value by this name."""

    name: str
    description: str
    of: str
    unit: str


class LimitInfo(Answer):
    """The limits and the alarm rule."""

    deciding: str
    decides_by: Literal["chart", "k_of_n"]
    false_alarms_per_sensor_year: float
    named: list[NamedLimitInfo]
    false_alarm_rate: float
    k: int
    n: int
    thickness_loss_fraction: float


class InstrumentInfo(Answer):
    """One instrument of a mixed rig."""

    name: str
    kind: str
    serves: dict[str, list[str]]


class AskedInfo(Answer):
    """Request to a person to do something now."""

    text: str
    position: str | None = None
    set_index: int | None = None
    unscheduled_index: int | None = None
    shot_index: int | None = None
    attempt: int | None = None
    within_s: float
    left_s: float


class SupplyInfo(Answer):
    """Limits of commands to the supply, and conditions that switch it off."""

    voltage_v: float
    current_limit_a: float
    voltage_cap_v: float
    current_cap_a: float
    interlock_current_a: float
    off_at_end: bool
    watchdog_timeout_s: float


class Info(Dated):
    """Identity and configuration of the test."""

    name: str
    uuid: str
    site: str | None
    version: str
    configuration_hash: str
    rig: str
    rig_label: str
    rig_identity: dict[str, str]
    instruments: list[InstrumentInfo]
    clock: ClockInfo
    schedule: ScheduleInfo
    limits: LimitInfo
    initial_thickness_m: float
    probe_delay_s: float
    probe_delay_is_assumed: bool
    supply: SupplyInfo | None
    positions: list[PositionInfo]
    paused: str | None
    asked: AskedInfo | None
    dry_run: bool | None
    last_event_id: int


class Liveness(Answer):
    """The web process answers."""

    status: Literal["ok"]
    data: bool
    recorder: RecorderStatus | None = None
    doing: str | None = None


class RecorderHealth(Answer):
    """Status and heartbeat of the recorder."""

    state: RecorderStatus
    description: str
    doing: str | None
    beat_age_s: float | None
    deadline_s: float | None


@_copy_fields_of(Outlook)
class DiskOutlook(Answer):
    """Forecast of the disk space; null: unknown before the first set file."""


class ServiceHealth(Dated):
    """Health of recorder, storage and service."""

    recorder: RecorderHealth
    counts: dict[str, int]
    stream_clients: int
    waveform_clients: int
    disk_free_bytes: int
    disk: DiskOutlook


class TrendBins(Answer):
    """Further values of the bins of a trend, one entry per bin, by column."""

    minimum: dict[str, list[float | None]]
    maximum: dict[str, list[float | None]]
    count: dict[str, list[int]]
    last_h: list[float]
    last_set_index: list[int]
    n_sets: list[int]
    n_missed: list[int]
    n_outliers: list[int]
    n_outliers_mean_3sd: list[int]
    first_outlier_set_index: list[int | None]
    n_alarms: list[int]
    first_alarm_set_index: list[int | None]


TREND_ASSESSMENTS = (
    *("distance_squared", "limit_f_predictive", "limit_mean_3sd"),
    *("outlier", "outlier_mean_3sd", "in_baseline", "mewma_statistic", "reason"),
)
"""Columns of a trend from the assessment."""
MEASURED_FIELDS = tuple(
    dict.fromkeys(name for kind in rows.MEASURED_BY.values() for name in rows.MEASURED[kind])
)
TREND_STANDARD_ERRORS = {f"standard_error_{name}": name for name in rows.MEASURED[rows.FeatureRow]}
"""Columns of a trend with the standard errors of a feature."""
TREND_WALL = ("thickness_m", "interval_low_m", "interval_high_m")
"""Columns of a transducer's trend with its wall thickness; a probe measures them."""
TREND_FIELDS = (*MEASURED_FIELDS, *TREND_ASSESSMENTS, *TREND_STANDARD_ERRORS)


def _build_trend_columns() -> type[Answer]:
    """Create the answer model with one list field, empty by default, for each column of a trend."""
    of_assessment = {column.name: column for column in rows.list_columns(rows.AssessmentRow)}
    kinds: Fields = dict.fromkeys(TREND_FIELDS, float | None)
    kinds |= {name: of_assessment[name].type for name in TREND_ASSESSMENTS}
    kinds |= {"set_index": int, "due_h": float, "due_utc": str, "age_h": float, "quality": Quality | None}
    errors = {column: f"Standard error of `{name}`" for column, name in TREND_STANDARD_ERRORS.items()}
    fields: Fields = {
        name: (GenericAlias(list, (kind | None,)), Field(default_factory=list, description=errors.get(name)))
        for name, kind in kinds.items()
    }
    description = "The columns that were asked for, and hour, age and quality; one entry a set or bin."
    return create_model("TrendColumns", __base__=Answer, __doc__=description, **fields)


class Trend(Dated):
    """Columns of equal length, one entry per set, or per bin where there are more sets than points."""

    position: str
    method: Method
    units: dict[str, str]
    bin_sets: int
    columns: _build_trend_columns()  # type: ignore[valid-type] # made of the rows
    bins: TrendBins | None


class Fit(Dated):
    """Second-order polynomial through a trend: value = c0 + c1 t + c2 t^2, t in hours."""

    position: str
    field: str
    unit: str
    n: int
    coefficients: list[float | None] | None
    r_squared: float | None
    residual_sd: float | None
    from_h: float | None
    to_h: float | None
    reason: str | None


class TwinWaveform(Dated):
    """Simulated waveform of a set: no measured value."""

    position: str
    set_index: int
    unscheduled_index: int
    wall: WallRow
    sample_rate_hz: float
    pretrigger_samples: int
    voltage_v: list[float] | None
    reason: str | None


class WaveformAnswer(Dated):
    """One stored record in volts."""

    position: str
    method: Method
    set_index: int
    unscheduled_index: int
    shot_index: int
    sequence: int
    utc: str
    due_h: float
    due_utc: str
    valid: bool
    flags: list[str]
    quality: Quality | None
    sample_rate_hz: float
    pretrigger_samples: int
    n_samples: int
    downsampled: bool
    time_s: list[float]
    voltage_v: list[float]
    age_h: float


class Waterfall(Answer):
    """All waveforms of a position over the test, as cells of extremes; also the header of the binary form."""

    position: str
    method: Method
    align: Literal["trigger", "isw", "first_echo"]
    shown: Literal["volts", "normalised", "difference"]
    unit: Literal["V", "1"]
    rows: int
    columns: int
    row_sets: int
    cell_s: float
    first_s: float
    whole_s: list[float] = Field(min_length=2, max_length=2)
    sample_rate_hz: float
    delay_s: float | None
    velocity_m_per_s: float | None
    baseline_sets: int | None
    first_set: list[int]
    last_set: list[int]
    n_sets: list[int]
    first_h: list[float]
    last_h: list[float]
    until_h: list[float]
    pending_sets: int
    unreadable_sets: list[int]
    minimum: list[list[float | None]]
    maximum: list[list[float | None]]


class Session(Answer):
    """Person of a request, and their permissions."""

    token_needed: bool
    name: str | None
    role: Literal["viewer", "operator", "engineer", "admin", "claimed"] | None
    may: list[str]


class TokenEntry(Answer):
    """Stored data of an access token."""

    name: str
    role: Literal["viewer", "operator", "engineer", "admin"]
    state: Literal["valid", "expired", "revoked"]
    created_utc: str
    expires_utc: str | None
    revoked_utc: str | None


class NewToken(TokenEntry):
    """New access token."""

    token: str


class TokenList(Answer):
    """All tokens."""

    items: list[TokenEntry]


@_copy_fields_of(audit.AuditEntry)
class AuditEntry(Answer):
    """Entry of the audit log."""

    id: int
    outcome: str | None


class AuditPage(Answer):
    """The newest first."""

    next_cursor: str | None
    items: list[AuditEntry]


class HeartbeatState(Answer):
    """Heartbeat messages to a receiver."""

    every_s: float
    state: Literal["off", "ok", "failing", "withheld"]
    result: str
    last_utc: str | None
    next_utc: str | None


@_copy_fields_of(State, "heartbeat_result", "last_heartbeat_utc_ns", "next_heartbeat_utc_ns")
class ReceiverState(Answer):
    """State of a receiver of notifications; counts are since the start of the service."""

    name: str
    kind: Literal["webhook", "apprise"]
    address: str
    rules: list[int]
    state: Literal["idle", "waiting", "failing", "dead"]
    last_sent_age_s: float | None
    heartbeat: HeartbeatState | None


class NotificationsState(Answer):
    """State of the notifications; times are of the computer's clock."""

    sending: bool
    not_sending_reason: str
    receivers: list[ReceiverState]


class TrialResult(Answer):
    """Result of a test message."""

    receiver: str
    ok: bool
    status: int | None
    result: str
    took_s: float


@_copy_fields_of(Delivery, "place")
class DeliveryEntry(Answer):
    """Line of the delivery log."""

    id: int


class DeliveryPage(Answer):
    """The newest first."""

    next_cursor: str | None
    items: list[DeliveryEntry]
