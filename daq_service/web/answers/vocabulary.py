"""Vocabulary of the names in answers and requests: one description per name.

A property with a more specific meaning is described where it is declared
(`Field(description=...)`, or the text beside a column's type in `catalogue.rows`).
"""

from __future__ import annotations

from collections.abc import Mapping

from daq_service.catalogue.rows import columns_of
from daq_service.catalogue.tables import KINDS

MEANINGS: Mapping[str, str] = {
    # Names of columns mean the same elsewhere: those of sets first.
    **{
        column.published_name: column.description
        for kind in reversed(KINDS)
        for column in columns_of(kind)
        if column.description is not None
    },
    # Where and when.
    "id": "Number of the row; `cursor` and events go by it",
    "due_utc": "The same as RFC 3339 UTC on the test's clock",
    "age_h": "Age on the test's clock",
    "as_of": "How fresh the answer is",
    "utc": "When it was taken, RFC 3339 UTC on the test's clock",
    "data_utc": "The same as RFC 3339 UTC; null: nothing was measured yet",
    "ClockInfo.kind": "Which clock the test runs on",
    "epoch_utc": "Hour 0 of the test, RFC 3339 UTC",
    "from_h": "First hour of the range; null: from the begin",
    "to_h": "Hour behind the range; null: to the end",
    "items": "The rows, in order",
    # What was measured.
    "n_sets": "How many sets",
    "sample_rate_hz": "Samples a second",
    "pretrigger_samples": "Samples before the trigger",
    "n_samples": "Samples of the stored record",
    "time_s": "Time of each sample from the trigger",
    "WaveformAnswer.voltage_v": "Voltage of each sample",
    "WaveformAnswer.shot_index": "Running number of the shot in its set, from 0",
    # Verdicts, baselines, alarms.
    "active_alarms": "Alarms that are not over",
    "highest_priority": "The gravest of its alarms; null: it has none",
    # Supply and climate.
    "SupplyNow.quality": "How fresh the reading is",
    "voltage_v": "Voltage of the supply",
    "current_limit_a": "Limit of the supply's current",
    "latest": "Around the newest set; null: there is no row",
    # The test and its service.
    "name": "Its name",
    "label": "What a person calls it",
    "serial_number": "Of the transducer",
    "version": "Of the installed solimon",
    "configuration_hash": "Of what the test measures: the same hash, the same measurement",
    "rig": "Kind of the rig",
    "rig_label": "The same for a person; a twin is a simulation",
    "initial_thickness_m": "Thickness of the wall when the test began",
    "last_event_id": "Newest event; a stream begun behind it misses nothing",
    "Info.clock": "The clock that the test runs on",
    "Info.schedule": "What is planned",
    "Info.limits": "Limits and the rule of the alarms",
    "Info.positions": "The monitored places",
    "pace_h_per_s": "Hours of the test in a second of real time; null: the clock is not paced",
    "end_h": "Hour of the last planned set",
    "baseline_h": "Length of the baseline",
    "shots_per_set": "Shots of a set at each position",
    "deciding": "The limit beyond which a set is an outlier",
    "false_alarm_rate": "Chance of an outlier where nothing has changed",
    "k": "Outliers of the last `n` judged sets that raise the alarm",
    "LimitInfo.n": "Judged sets among which `k` outliers raise the alarm",
    "InstrumentInfo.kind": "Kind of instrument, as an installed package offers it",
    "InstrumentInfo.name": "Its name in the configuration",
    "text": "The sentence for the person",
    "within_s": "How long the recorder waits, from when it asked",
    "PositionState.state": "How the place stands, the gravest first",
    "last_set": "Newest set; null: there is none",
    "last_feature": "Newest features; null: there are none",
    "last_thickness": "Newest thickness; null: there is none",
    "last_assessment": "Newest verdict; null: there is none",
    "recorder": "How the recorder is",
    "RecorderHealth.state": "How the recorder is",
    "RecorderHealth.description": "The same in words, with what helps",
    "doing": "What it was doing at its last sign of life; null: there was none",
    "beat_age_s": "Age of its last sign of life; null: there was none in this boot",
    "deadline_s": "How long it may give none; null: there was none",
    "counts": "How much is stored, by name",
    "stream_clients": "Open streams of events",
    "waveform_clients": "Open streams of live waveforms",
    "disk_free_bytes": "Free on the volume of the data folder",
    "disk": "What is free, and what the rest of the test takes",
    "free_bytes": "Free on the volume of the data folder",
    "total_bytes": "Size of that volume",
    "needed_bytes": "What the rest of the test takes; null: not known yet",
    "full_at_h": "Hour of the test at which the volume is full; null: it suffices, or is not known",
    "level": "How full the volume is",
    "status": "`ok`: the process answers",
    # Trends and fits.
    "columns": "Values by column, all of the same length",
    "units": "Unit of each column; `1`: a pure number",
    "unit": "Unit of the field; `1`: a pure number",
    "field": "Column that was fitted",
    "Fit.n": "Sets that have a value",
    "coefficients": "c0, c1, c2, in the field's unit over h^0, h^1, h^2; null: no fit",
    "r_squared": "Coefficient of determination; null: no fit",
    "residual_sd": "Standard deviation of the residuals, in the field's unit; null: no fit",
    "minimum": "Least value of each bin by column, in the column's unit",
    "maximum": "Greatest value of each bin by column, in the column's unit",
    "last_h": "Hour of the last set of each bin",
    "TrendBins.last_set_index": "Last planned set of each bin",
    "n_missed": "Sets of each bin without a record",
    "n_outliers": "Outliers of each bin",
    "n_outliers_mean_3sd": "Outliers of each bin by the paper's limit",
    "first_outlier_set_index": "First outlier of each bin; null: it has none",
    "first_alarm_set_index": "First set of each bin with an alarm; null: it has none",
    # Orders, tokens, audit.
    "kind": "What is ordered",
    "arguments": "What the order is about",
    "AuditEntry.arguments": "What was asked for, without what opens",
    "author": "Who gives the order; with a token its name, whatever is said here",
    "note": "Why",
    "alarm_id": "Number of the alarm",
    "command_id": "Number of the order; null: it was none",
    "wall_utc": "When it was given, RFC 3339 UTC by the computer's clock",
    "role": "What its owner may do; each role may do what those before it may",
    "TokenEntry.state": "Whether it opens",
    "NewToken.state": "Whether it opens",
    "created_utc": "When it was made, RFC 3339 UTC",
    "expires_utc": "When it opens no more, RFC 3339 UTC; null: never",
    "revoked_utc": "When it was revoked, RFC 3339 UTC; null: it was not",
    "token": "What opens",
    "why": "Why it was refused or failed; empty: it was not",
    # Tables.
    "formats": "Formats that this installation writes",
    "table": "Name of the table",
    "description": "What the table holds",
    "TableInfo.columns": "Its columns in their order",
    # Errors.
    "type": "`urn:solimon:problem:` and the name of the problem, which does not change",
    "title": "What is wrong in general",
    "detail": "What is wrong here, with value and limit",
    "hint": "What helps",
    "instance": "Path that was asked for",
    "request_id": "Name of the request, also in the header X-Request-ID and in the log",
    "errors": "Parts of the request that were refused; null: not a matter of parts",
    "ProblemDetails.status": "Status of HTTP",
    # Parameters alone.
    "list_sets.state": "Only sets that became this",
    "revoke_token.name": "Whose token",
    # Suppressed alarms, and notes.
    "AlarmTransition.event_id": "Number of the event that told it",
    "AlarmTransition.suppressed": "Whether it was shelved or out of service then; null: neither",
    "AnnotationRow.from_utc": "When it begins, RFC 3339 UTC on the test's clock",
    "AnnotationRow.to_utc": "When it ends, likewise; the same: an instant",
    "annotation_id": "Number of the annotation",
    "Guidance.kind": "Kind of the alarm",
    # The waterfall.
    "get_waterfall.format": "Binary, or JSON",
    "get_waterfall.columns": "Most columns of the picture; a column's unit is that of time",
    "Waterfall.align": "What time 0 is",
    "Waterfall.columns": "Columns of the picture, a number without unit",
    "Waterfall.rows": "Rows of the picture",
    "Waterfall.first_h": "When the first set of each row was due",
    "Waterfall.first_set": "First planned set of each row",
    "Waterfall.unreadable_sets": "Sets whose records cannot be read",
    "velocity_m_per_s": "Speed of sound in the wall; null: no pulse echo",
    "Waterfall.minimum": "Least sample of each cell by row, in `unit`; null where there is none",
    "Waterfall.maximum": "Greatest sample of each cell by row, in `unit`; null where there is none",
    # Notifications.
    "receiver": "Name of the receiver, as the configuration has it",
    "receivers": "Who is told, in the configuration's order",
    "event_ids": "Numbers of the events that the message tells",
    "attempts": "How often it was tried until then",
    "HeartbeatState.every_s": "How long from one to the next",
    "HeartbeatState.next_utc": "When the next one is due, RFC 3339 UTC; null: none is",
    "ReceiverState.kind": "A signed webhook, or e-mail and chat by the extra `notify`",
    "last_sent_utc": "When it last took a message, RFC 3339 UTC; null: it has taken none",
    "last_sent_age_s": "How long ago that was; null: it has taken none",
    "last_failure_utc": "When an attempt last failed, RFC 3339 UTC; null: none has",
    "last_failure": "Why that failed; empty: none has",
    "failing_since_utc": "Since when no attempt has got through, RFC 3339 UTC; null: the last one has",
    "next_attempt_utc": "When it is tried again, RFC 3339 UTC; null: nothing waits",
    "TrialResult.ok": "It was taken",
    "took_s": "How long the answer was waited for",
}
"""Description by name, or by `Schema.name` or `operation.name` where it has a special meaning there."""

RATIOS = ("_ratio", "_coefficient", "_fraction", "_probability", "_squared")
"""Suffixes of numbers without a unit; an integer has none: it is a count or an index."""
PURE = frozenset(
    {
        "averages",
        "mewma_statistic",
        "contributions",
        "false_alarm_rate",
        "false_alarms_per_sensor_year",
        "limit",
        "limit_f_predictive",
        "limit_mean_3sd",
        "limits",
        "relative_humidity",
        "statistics",
    }
)
"""Further ones: rates, statistics in units of the scatter."""
OWN_UNIT = frozenset({"coefficients", "residual_sd", "mean", "covariance", "minimum", "maximum", "columns"})
"""Numbers with a unit per field or column, stated in the description."""
OTHER_UNITS: Mapping[str, str] = {"days": "d"} | dict.fromkeys(
    ("free_bytes", "total_bytes", "needed_bytes", "disk_free_bytes"), "B"
)

TAGS: Mapping[str, str] = {
    "info": "Which experiment this is, on which rig and clock, and what is planned.",
    "health": "Signs of life for machines and people, and metrics for Prometheus.",
    "transducers": "The last word on each position.",
    "sets": "Planned sets, what became of them, their shots and records.",
    "features": "Features of the solitary waves, of sets or of single shots.",
    "thickness": "What pulse echo says of the wall.",
    "assessments": "Distances, limits, outliers, and the baselines that they are judged against.",
    "trends": "Columns over hours for charts, and polynomials through them.",
    "waveforms": "Stored records in volts, and the newest one live.",
    "environment": "Supply and climate around the sets.",
    "alarms": "Alarms after ISA-18.2 with their proofs.",
    "commands": "Orders to the recorder, and what became of them.",
    "stream": "Events as they are committed.",
    "session": "The page's way in: a token for a cookie.",
    "tokens": "Access tokens.",
    "audit": "Who asked for what, and what came of it.",
    "tables": "Whole tables in formats of other programs.",
    "files": "Finished files of sets.",
    "tests": "The tests of a service that has several.",
    "notifications": "Who is told of alarms elsewhere, and what became of each message.",
    "annotations": "What people noted of hours of the test.",
    "waterfall": "All records of a position as one picture.",
    "report": "A test, or some hours of it, as one page that prints.",
}

EXAMPLES: Mapping[str, object] = {
    "position": "B",
    "set_index": 0,
    "shot_index": 0,
    "alarm_id": 1,
    "command_id": 1,
    "table": "features",
    "field": "tof_pp_s",
    "get_file.name": "set_000000.h5",
    "revoke_token.name": "bob",
    "receiver": "control_room",
    "annotation_id": 1,
    "get_waterfall.format": "json",
    "get_waterfall.rows": 2,
    "get_waterfall.columns": 4,
}
"""Examples of required parameters, by name or `operation.name`, used for the example answers."""
