"""Models of the answers, for OpenAPI and for its contract test.

Routes answer with rows that they already trust, encoded by orjson; nothing is validated again on
the way out (10,000 rows: 2.4 ms instead of 37 ms). The tests hold every answer against these models.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, TypeVar, cast

from pydantic import BaseModel, ConfigDict, Field, create_model

from daq_service.assessment.position_status import PositionStatus
from daq_service.catalogue import rows
from daq_service.catalogue.rows import Priority, Quality, ReadingQuality, SupplyState
from daq_service.commands.audit import Result
from daq_service.processes.notifications.delivery_log import DeliveryKind
from daq_service.web.answers.problem import MEDIA_TYPE, ProblemDetails
from hardware_drivers.methods import Method

A = TypeVar("A", bound="Answer")

PROBLEMS: dict[int | str, dict[str, object]] = {
    status: {
        "description": text,
        "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/ProblemDetails"}}},
    }
    for status, text in {
        400: "The body is not what its media type says",
        401: "A token is needed, or the one given does not open",
        403: "The role does not allow it, the request comes from another origin, or it was not encrypted",
        404: "There is no such thing",
        409: "The request does not fit the present state",
        413: "The request body is too large",
        416: "There is no such range of bytes",
        422: "The request is not valid",
        429: "Too many wrong tokens came from this address",
        503: "No data yet, or the data folder cannot be read",
    }.items()
}


def problem_schemas() -> dict[str, object]:
    """Return the JSON schemas of error answers, for the components of OpenAPI."""
    schema = ProblemDetails.model_json_schema(ref_template="#/components/schemas/{model}")
    return {**schema.pop("$defs"), "ProblemDetails": schema}


def problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the documentation of the error answers of a route."""
    return {status: PROBLEMS[status] for status in statuses}


class Answer(BaseModel):
    """Base of all answers, without undocumented fields."""

    model_config = ConfigDict(extra="forbid")


def _of_row(kind: type[rows.Row]) -> Callable[[type[A]], type[A]]:
    """Return a decorator that adds the columns of a catalogue row and its age to an answer.

    ``*_utc_ns`` leaves as RFC 3339 text ``*_utc``; the hour ``due_h`` brings its ``due_utc``.
    """

    def derive(answer: type[A]) -> type[A]:
        fields: dict[str, Any] = {}
        for column in rows.columns_of(kind):
            if column.name == "due_utc_ns":
                continue
            if column.name == "due_h":
                fields |= {"due_h": (float, ...), "due_utc": (str, ...)}
            elif column.name == "id":
                fields["id"] = (int, ...)
            elif column.name.endswith("utc_ns"):
                fields[column.name.removesuffix("_ns")] = (str | None if column.nullable else str, ...)
            else:
                fields[column.name] = (column.type, Field(description=column.description))
        fields |= {name: (field.annotation, field) for name, field in answer.model_fields.items()}
        if fields.keys() & {"due_h", "raised_h"}:
            fields["age_h"] = (float, ...)
        model = create_model(answer.__name__, __base__=Answer, __doc__=answer.__doc__, **fields)
        return cast(type[A], model)

    return derive


class AsOf(Answer):
    """Freshness of an answer, on the test clock and on the wall clock."""

    clock: Literal["simulated", "wall"] = Field(description="Which clock the experiment runs on")
    now_utc: str = Field(description="Now on the experiment's clock; simulated: time of the last event")
    now_h: float = Field(description="Hours since the experiment began")
    last_write_wall_utc: str | None = Field(description="Wall time of the recorder's last committed event")
    wall_age_s: float | None = Field(description="Wall seconds since then")
    recorder: Literal["running", "finished", "stopped", "not_responding", "not_started"]


@_of_row(rows.SetRow)
class SetRow(Answer):
    """One set of one position."""


@_of_row(rows.ShotRow)
class ShotRow(Answer):
    """One stored shot."""


@_of_row(rows.FeatureRow)
class FeatureRow(Answer):
    """Features of a shot, or of a set (shot_index null): mean of its valid shots."""


@_of_row(rows.ThicknessRow)
class ThicknessRow(Answer):
    """Pulse-echo result of a set."""


@_of_row(rows.AssessmentRow)
class AssessmentRow(Answer):
    """Result of the novelty detection of a set."""

    quality: Quality | None = Field(description="Quality of the set's feature that was judged")


@_of_row(rows.BaselineRow)
class BaselineRow(Answer):
    """Baseline; the first, still collecting one of a position has its future id."""

    n_sets: int = Field(description="Usable sets in it; of one that collects those so far")
    from_h: float = Field(description="When its first set was due, or will be")
    from_utc: str = Field(description="The same as RFC 3339 UTC")
    to_h: float = Field(description="The same of its last set: with it one that collects is complete")
    to_utc: str = Field(description="The same as RFC 3339 UTC")
    temperature_c: list[float] | None = Field(
        description="Least and greatest temperature around its sets; null: none was measured"
    )


class AlarmRule(Answer):
    """Rule of an alarm: `k` of `n` sets for a wall change, shots of consecutive sets for no reflection."""

    false_alarms_per_sensor_year: float | None = Field(default=None, description="Budget of the chart")
    k: int | None = Field(default=None, description="So many of the last `n` judged sets")
    n: int | None = Field(default=None, description="Judged sets that are looked at")
    shots: int | None = Field(default=None, description="Shots of a set without a reflected wave")
    consecutive_sets: int | None = Field(default=None, description="Such sets running")


class ConfirmationSet(Answer):
    """Result of an unscheduled confirmation set."""

    set_index: int = Field(description="Scheduled set that it follows")
    unscheduled_index: int
    utc_ns: int = Field(description="When it was asked for, in ns of UTC on the test's clock")
    due_h: float = Field(description="The same in hours of the test")
    confirms: bool | None = Field(description="It lies where the planned sets before it do; null: unknown")
    distance_squared: float | None = Field(description="Its squared distance; null: not judged")
    limit: float | None = Field(description="Limit beyond which a set is an outlier")
    reason: str | None = Field(description="Why it cannot tell; null: it can")


class AlarmEvidence(BaseModel):
    """Evidence of an alarm: fields by kind; for the supply, the columns of environment."""

    model_config = ConfigDict(extra="allow")

    formula: str | None = Field(default=None, description="Formula of the value that decides")
    rule: AlarmRule | None = Field(default=None, description="How much it takes")
    set_index: int | None = Field(default=None, description="Set that decided")
    unscheduled_index: int | None = None
    distance_squared: float | None = Field(default=None, description="Squared distance of that set")
    limit_name: str | None = Field(default=None, description="The limit that decides")
    raised_by: str | None = Field(
        default=None, description="Where the chart decides: `chart`, or `diagnosis`, a wall that is named"
    )
    mewma_statistic: float | None = Field(
        default=None, description="Statistic of the chart, where it decides"
    )
    limit: float | None = Field(default=None, description="That limit")
    rate_verified: bool | None = Field(default=None, description="The chart keeps to its budget")
    rate_not_verified_reason: str | None = Field(default=None, description="Why it may not; null: it does")
    baseline_id: int | None = Field(default=None, description="Baseline that it was judged against")
    contributions: dict[str, float | None] | None = Field(
        default=None, description="Part of the squared distance, or of the chart's statistic, by feature"
    )
    confirmation: ConfirmationSet | None = Field(
        default=None, description="What the confirmation set says; null: none was struck"
    )
    thickness_m: float | None = Field(default=None, description="Thickness that was read")
    interval_m: list[float] | None = Field(default=None, description="Its 95 % interval: low, high")
    roughness_rms_m: float | None = Field(default=None, description="Roughness of the far wall, RMS")
    limit_m: float | None = Field(default=None, description="Thickness below which the probe alarms")
    travel_time_s: float | None = Field(default=None, description="Time of the echo")
    reference_travel_time_s: float | None = Field(default=None, description="The same when the test began")
    delay_s: float | None = Field(default=None, description="Delay of the probe that was taken off")
    consecutive_poor_sets: int | None = Field(
        default=None, description="Sets running with too few valid shots"
    )
    minimum_valid_shots: int | None = Field(default=None, description="So many valid shots a set needs")
    shots_without_psw: int | None = Field(default=None, description="Shots without a reflected wave")
    error: str | None = Field(default=None, description="What the instrument's driver raised")
    command_id: int | None = Field(default=None, description="The order that raised it")
    set_aside: list[str] | None = Field(default=None, description="Damaged files without rows")
    damaged: dict[str, str] | None = Field(default=None, description="Damaged files, and what ails each")
    extractor_version: str | None = Field(default=None, description="Version of the code that computed it")


@_of_row(rows.AlarmRow)
class AlarmRow(Answer):
    """Alarm with its evidence."""

    evidence: AlarmEvidence = Field(description="What it rests on")
    evidence_sentences: list[str] = Field(
        description="The same for an operator: what was measured, by how much it passes which limit, the "
        "features that contribute most, the rule, and when; the first one says most"
    )


@_of_row(rows.CommandRow)
class CommandRow(Answer):
    """Command of an operator and its result."""

    expires_in_s: float | None = Field(description="Then nobody will carry it out; null: it is not pending")


class Page(Answer):
    """Frame of every listing."""

    as_of: AsOf
    next_cursor: str | None = Field(description="Pass it as `cursor` for the next page; null: the last page")


class SetPage(Page):
    """Sets in order."""

    items: list[SetRow]


class ShotPage(Page):
    """Shots in order."""

    items: list[ShotRow]


class FeaturePage(Page):
    """Features in order."""

    items: list[FeatureRow]


class ThicknessPage(Page):
    """Pulse-echo results in order."""

    items: list[ThicknessRow]


class AssessmentPage(Page):
    """Assessments in order."""

    items: list[AssessmentRow]


class AlarmPage(Page):
    """Alarms in order."""

    items: list[AlarmRow]


class AlarmTransition(Answer):
    """Transition of an alarm at a moment."""

    event_id: int
    kind: str = Field(description="`alarm_raised`, `alarm_acknowledged`, `alarm_shelved`, ...")
    utc: str
    wall_utc: str = Field(description="When it was stored")
    state: rows.AlarmState = Field(description="From then on")
    priority: Priority
    suppressed: rows.Suppression | None
    who: str | None = Field(description="null: nobody, the measurement or the time")
    why: str | None
    shelved_until_utc: str | None


class AlarmHistory(Answer):
    """Every transition of an alarm, the oldest first."""

    as_of: AsOf
    items: list[AlarmTransition]


class Guidance(Answer):
    """Guidance for a kind of alarm."""

    kind: str
    meaning: str = Field(description="What has been found")
    limitations: str = Field(description="What that does not prove")
    checks: list[str] = Field(description="Likely causes, in the order in which to look")
    short: str = Field(description="The same in a sentence or two")
    contact: str = Field(description="Who decides")


class GuidanceList(Answer):
    """Guidance for every kind of alarm."""

    items: list[Guidance]


@_of_row(rows.AnnotationRow)
class AnnotationRow(Answer):
    """Annotation of an hour of the test, or of a range."""

    from_utc: str
    to_utc: str


class AnnotationPage(Page):
    """Annotations in order."""

    items: list[AnnotationRow]


@_of_row(rows.EnvironmentRow)
class EnvironmentRow(Answer):
    """Supply and climate around a set; null where there was no reading."""


class EnvironmentPage(Page):
    """Supply and climate in order."""

    items: list[EnvironmentRow]


class SupplyNow(Answer):
    """Present status of the supply, from the supply process, also without a recorder."""

    state: SupplyState = Field(description="`unknown` where the newest reading says nothing of now")
    quality: ReadingQuality
    last: SupplyState = Field(description="What the newest reading said")
    age_s: float | None = Field(description="Of the newest reading; null: there was none")
    tripped: str | None = Field(description="Why the interlock has tripped; null: it has not")
    unwatched: bool = Field(description="It was switched off because no recorder watched")
    switch_off_pending: bool = Field(description="It must be off and was not read as off yet: it may be ON")
    written_age_s: float = Field(description="Age of the state that its process wrote last")
    process: bool | None = Field(description="Somebody owns the supply's port; null: that cannot be told")


class EnvironmentNow(Answer):
    """Supply and climate around the newest set, and the supply now."""

    as_of: AsOf
    latest: EnvironmentRow | None
    supply_now: SupplyNow | None = Field(description="null: this folder's test has had no supply")


class TableColumn(Answer):
    """A column of an exported table."""

    name: str
    form: Literal["number", "integer", "truth", "time", "text", "nested"] = Field(
        description="`time`: RFC 3339; `nested`: JSON text"
    )
    unit: str = Field(description="As UDUNITS writes it; empty: it has none")


class TableInfo(Answer):
    """A table that can be exported."""

    table: str
    description: str
    columns: list[TableColumn]


class TableList(Answer):
    """Tables, and the formats that this installation writes."""

    formats: list[str]
    items: list[TableInfo]


class BaselineList(Answer):
    """Every baseline, retired and collecting ones too, oldest first."""

    as_of: AsOf
    items: list[BaselineRow]


class PositionStanding(Answer):
    """Status of a monitored position."""

    position: str
    label: str
    method: Method
    state: PositionStatus = Field(
        description="`not_assessed`: see `last_assessment.reason`. `shelved`, `out_of_service`: an "
        "alarm is active, but suppressed"
    )
    stale: bool = Field(description="The newest data are older than this test's cadence explains")
    data_h: float | None = Field(description="Hour of the newest set that was measured")
    age_h: float | None = Field(description="Age of that set on the experiment's clock")


class PositionState(PositionStanding):
    """Present state of a monitored position."""

    serial_number: str
    data_utc: str | None
    last_set: SetRow | None
    last_feature: FeatureRow | None
    last_thickness: ThicknessRow | None
    last_assessment: AssessmentRow | None
    disabled_reason: str | None = Field(
        description="Why the transducer strikes no more until it is reinstated; null: it strikes"
    )
    active_alarms: int = Field(description="Those that are told of")
    suppressed_alarms: int = Field(description="Active ones that are shelved or out of service")
    shelved_until_utc: str | None = Field(description="When the first of them is told of again")
    highest_priority: Priority | None


class PositionList(Answer):
    """All monitored positions."""

    as_of: AsOf
    items: list[PositionState]


class ClockInfo(Answer):
    """Clock of the test."""

    kind: Literal["simulated", "wall"]
    epoch_utc: str
    pace_h_per_s: float | None
    system_ahead_s: float | None = Field(
        description="This computer's UTC less the experiment's time, s: what steps have put between them; "
        "null: a simulated clock, or no recorder has told since this computer started"
    )
    can_finish_now: bool = Field(description="True while a paced simulated test runs")


class ScheduleInfo(Answer):
    """Schedule of the test."""

    n_sets: int
    end_h: float
    baseline_h: float
    shots_per_set: int


class PositionInfo(Answer):
    """Configuration of a position."""

    position: str
    label: str
    method: Method
    serial_number: str


class NamedLimitInfo(Answer):
    """Limit of a statistic; baselines and assessments hold its value by this name."""

    name: str
    description: str = Field(description="What it means, in a sentence")
    of: str = Field(description="Statistic that it bounds")
    unit: str = Field(description="Of both; `1`: a pure number")


class LimitInfo(Answer):
    """The limits and the alarm rule."""

    deciding: str
    decides_by: Literal["chart", "k_of_n"] = Field(description="What raises the alarm of the wall")
    false_alarms_per_sensor_year: float = Field(description="Budget of the chart")
    named: list[NamedLimitInfo] = Field(description="Every limit that there is")
    false_alarm_rate: float
    k: int
    n: int
    thickness_loss_fraction: float = Field(
        description="Loss that raises the probe's alarm, of the initial wall"
    )


class InstrumentInfo(Answer):
    """One instrument of a mixed rig."""

    name: str
    kind: str
    serves: dict[str, list[str]] = Field(description="Positions by role")


class AskedInfo(Answer):
    """Request to a person to do something now."""

    text: str
    position: str | None = None
    set_index: int | None = None
    unscheduled_index: int | None = None
    shot_index: int | None = None
    attempt: int | None = None
    within_s: float
    left_s: float = Field(description="Until the recorder waits no longer, at the moment of this answer")


class SupplyInfo(Answer):
    """Limits of commands to the supply, and conditions that switch it off."""

    voltage_v: float = Field(description="Configured: an order without a voltage sets it")
    current_limit_a: float = Field(description="Configured, likewise")
    voltage_cap_v: float = Field(description="No order beyond it is carried out")
    current_cap_a: float = Field(description="Likewise, of the limit")
    interlock_current_a: float = Field(description="Measured current at which it is switched off")
    off_at_end: bool = Field(description="Whether the end of the test, and a stop, switch it off")
    unwatched_s: float = Field(description="Without a recorder for so long it is switched off")


class Info(Answer):
    """Identity and configuration of the test."""

    name: str
    uuid: str = Field(description="Of the test: a backup has the same, a copy that continues another one")
    site: str | None = Field(description="Where the test runs; null: not given")
    version: str
    configuration_hash: str
    rig: str
    rig_label: str
    rig_identity: dict[str, str] = Field(description="Serial numbers and versions, as stored with each set")
    instruments: list[InstrumentInfo] = Field(description="Of a mixed rig; empty for others")
    clock: ClockInfo
    schedule: ScheduleInfo
    limits: LimitInfo
    initial_thickness_m: float
    supply: SupplyInfo | None = Field(description="null: this test has no corrosion drive")
    positions: list[PositionInfo]
    held: str | None = Field(description="Who holds the test and why: nothing strikes; null: nobody does")
    asked: AskedInfo | None = Field(description="What a person shall do now; null: nothing")
    dry_run: bool | None = Field(
        description="True: a rehearsal, no coil is ever energised; null: recorded by an older version"
    )
    last_event_id: int
    as_of: AsOf


class Liveness(Answer):
    """The web process answers."""

    status: Literal["ok"]
    data: bool = Field(description="Something is stored: the other answers are no longer 503")


class RecorderHealth(Answer):
    """Status and heartbeat of the recorder."""

    state: Literal["running", "finished", "stopped", "not_responding", "not_started"]
    description: str
    doing: str | None
    beat_age_s: float | None
    deadline_s: float | None


class DiskOutlook(Answer):
    """Forecast of the disk space; null: unknown before the first set file."""

    free_bytes: int
    total_bytes: int
    level: Literal["ample", "warn", "alarm", "stop"]
    needed_bytes: int | None
    full_at_h: float | None


class ServiceHealth(Answer):
    """Health of recorder, storage and service."""

    as_of: AsOf
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
    count: dict[str, list[int]] = Field(description="Sets that have the value")
    last_h: list[float]
    last_set_index: list[int]
    n_sets: list[int] = Field(description="Sets that were measured")
    n_missed: list[int]
    n_outliers: list[int]
    n_outliers_mean_3sd: list[int]
    first_outlier_set_index: list[int | None]
    n_alarms: list[int] = Field(description="Alarms of the position that were raised in these sets")
    first_alarm_set_index: list[int | None]


TREND_ASSESSMENTS = (
    *(
        "distance_squared",
        "limit_f_predictive",
        "limit_mean_3sd",
        "outlier",
        "outlier_mean_3sd",
        "in_baseline",
    ),
    *("mewma_statistic", "reason"),
)
"""Columns of a trend from the assessment."""
MEASURED_FIELDS = tuple(
    dict.fromkeys(name for kind in rows.MEASURED_BY.values() for name in rows.measured(kind))
)
TREND_FIELDS = (*MEASURED_FIELDS, *TREND_ASSESSMENTS)


def _trend_columns() -> type[Answer]:
    of_assessment = {column.name: column for column in rows.columns_of(rows.AssessmentRow)}
    kinds: dict[str, Any] = dict.fromkeys(TREND_FIELDS, float | None)
    kinds |= {name: of_assessment[name].type for name in TREND_ASSESSMENTS}
    kinds |= {"set_index": int, "due_h": float, "due_utc": str, "age_h": float, "quality": Quality | None}
    fields: dict[str, Any] = {
        name: (list[kind | None], Field(default_factory=list))  # type: ignore[valid-type] # a value here
        for name, kind in kinds.items()
    }
    description = "The columns that were asked for, and hour, age and quality; one entry a set or bin."
    return create_model("TrendColumns", __base__=Answer, __doc__=description, **fields)


class Trend(Answer):
    """Columns of equal length, one entry per set, or per bin where there are more sets than points."""

    position: str
    method: Method
    as_of: AsOf
    units: dict[str, str]
    bin_sets: int = Field(description="Planned sets that an entry stands for; 1: each set is an entry")
    columns: _trend_columns()  # type: ignore[valid-type] # made of the rows
    bins: TrendBins | None = Field(description="null where each set is an entry")


class Fit(Answer):
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
    reason: str | None = Field(description="Why there is no fit")
    as_of: AsOf


class WaveformAnswer(Answer):
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
    downsampled: bool = Field(description="True: least and greatest sample of each bin, in order of time")
    time_s: list[float]
    voltage_v: list[float]
    as_of: AsOf
    age_h: float


class Waterfall(Answer):
    """All waveforms of a position over the test, as cells of extremes; also the header of the binary form."""

    position: str
    method: Method
    align: Literal["trigger", "isw", "first_echo"]
    shown: Literal["volts", "normalised", "difference"] = Field(description="What `as` asked for")
    unit: Literal["V", "1"]
    rows: int
    columns: int
    row_sets: int = Field(description="Planned sets of a row; a row begins at a multiple of it")
    cell_s: float = Field(description="Time of a column; a whole number of samples")
    first_s: float = Field(description="Begin of the first column, in seconds after the anchor")
    whole_s: list[float] = Field(min_length=2, max_length=2, description="Times that there are, from and to")
    sample_rate_hz: float
    delay_s: float | None = Field(description="Of the probe; thickness = (time - delay_s) velocity / 2")
    velocity_m_per_s: float | None
    baseline_sets: int | None = Field(description="Sets whose mean the difference is from")
    first_set: list[int]
    last_set: list[int]
    n_sets: list[int] = Field(description="Sets of each row whose records are in it")
    first_h: list[float]
    last_h: list[float]
    until_h: list[float] = Field(description="Where the row ends: when the set after it is due")
    pending_sets: int = Field(description="Sets that are not in the picture yet: ask again")
    unreadable_sets: list[int]
    minimum: list[list[float | None]]
    maximum: list[list[float | None]]


class Session(Answer):
    """Person of a request, and their permissions."""

    token_needed: bool = Field(description="False: on loopback, before the first token was made")
    name: str | None = Field(description="Of the token; null: nobody has logged in, or no token is needed")
    role: Literal["viewer", "operator", "engineer", "admin", "claimed"] | None = Field(
        description="`claimed`: everybody may do everything, under a name that nobody checks"
    )
    may: list[str] = Field(description="Operations and kinds of orders that this person may ask for")


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

    token: str = Field(description="What opens; told once")


class TokenList(Answer):
    """All tokens."""

    items: list[TokenEntry]


class AuditEntry(Answer):
    """Entry of the audit log."""

    id: int = Field(description="Running number; one that is missing was damaged or taken away")
    utc: str = Field(description="By the computer's clock")
    who: str = Field(description="Name of the token, or the one that was claimed; empty: nobody knows")
    role: str = Field(description="Of the token; `claimed` where none was asked for; empty: a stranger")
    source: str = Field(description="Network address, or `terminal`")
    what: str = Field(description="Kind of order, or operation; `enter`: a wrong token, or none")
    arguments: dict[str, Any]
    result: Result
    why: str
    command_id: int | None
    left_out: int = Field(description="Refusals before this line that were too many to be told")
    outcome: str | None = Field(description="What the recorder made of an order that was accepted")


class AuditPage(Answer):
    """The newest first."""

    next_cursor: str | None = Field(description="Pass it as `cursor` for what was before; null: nothing was")
    items: list[AuditEntry]


class HeartbeatState(Answer):
    """Heartbeat messages to a receiver."""

    every_s: float
    state: Literal["off", "ok", "failing", "withheld"] = Field(
        description="`withheld`: no recorder answers, so none is sent; `off`: none was due yet"
    )
    result: str = Field(description="What became of the last one")
    last_utc: str | None = Field(description="Of the last one that was taken")
    next_utc: str | None


class ReceiverState(Answer):
    """State of a receiver of notifications; counts are since the start of the service."""

    name: str
    kind: Literal["webhook", "apprise"]
    address: str = Field(description="Its host, or where its address is read: it may be secret")
    rules: list[int] = Field(description="Numbers of the rules that concern it, from 1")
    state: Literal["idle", "waiting", "failing", "dead"] = Field(
        description="`dead`: it has taken nothing for ten minutes, though it was tried"
    )
    began: str = Field(description="From which event on it is told, and why")
    sent: int = Field(description="Messages that it took")
    failed: int = Field(description="Attempts that failed")
    gave_up: int = Field(description="Messages that were given up")
    waiting: int = Field(description="Changes that wait for their delay, their group or the receiver")
    last_sent_utc: str | None
    last_sent_age_s: float | None
    last_failure_utc: str | None
    last_failure: str
    failing_since_utc: str | None
    next_attempt_utc: str | None
    heartbeat: HeartbeatState | None = Field(description="null: none is asked for")


class NotificationsState(Answer):
    """State of the notifications; times are of the computer's clock."""

    sending: bool = Field(description="True: this service tells the receivers")
    not_sending_reason: str = Field(description="Why it does not")
    receivers: list[ReceiverState]


class TrialResult(Answer):
    """Result of a test message."""

    receiver: str
    ok: bool
    status: int | None = Field(description="Of HTTP; null: none came, or the receiver is no webhook")
    result: str
    took_s: float


class DeliveryEntry(Answer):
    """Line of the delivery log."""

    id: int = Field(description="Running number; one that is missing was damaged or taken away")
    utc: str
    receiver: str
    what: DeliveryKind = Field(
        description="`sending` without `sent` behind it: it is under way, or a crash came in between"
    )
    result: str
    event_ids: list[int]
    key: str = Field(description="The message's Idempotency-Key; the same again is the same message")
    attempts: int


class DeliveryPage(Answer):
    """The newest first."""

    next_cursor: str | None = Field(description="Pass it as `cursor` for what was before; null: nothing was")
    items: list[DeliveryEntry]
