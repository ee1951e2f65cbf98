"""Format the status of a test for a terminal: every number with its quality and age."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any

from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from analysis.diagnosis.hypotheses import OK, WALL
from daq_service.alarms.evidence import describe_confirmation
from daq_service.alarms.guidance import GUIDANCE, join_numbered_steps
from daq_service.assessment.diagnosis_texts import format_diagnosis
from daq_service.cli.terminal import format_duration
from daq_service.clock import format_utc
from daq_service.processes.disk_policy import LEVELS
from daq_service.settings.foreign_text import escape_all_to_one_line, escape_to_one_line

Facts = Mapping[str, Any]
"""Part of the status as JSON (`facts.describe_status`)."""
STYLES = {
    word: style
    for style, words in (
        ("green", ("normal", "running", "finished")),
        ("cyan", ("collecting_baseline",)),
        ("yellow", ("outlier", "shelved", "out_of_service", "not_assessed", "stopped", "not_started")),
        ("yellow", ("returned_unacknowledged", "acknowledged", "suspect")),
        ("bold red", ("alarm", "disabled", "not_responding", "unacknowledged", "bad")),
    )
    for word in words
}
"""Colours never stand alone: each has its word."""
DISK_STYLES = dict(zip(LEVELS, ("", "yellow", "bold red", "bold red"), strict=True))
LARGEST_IN_FULL = 1e4
"""Larger distances are shown in powers of ten."""


def compose_status(facts: Facts, folder: str) -> RenderableType:
    """Compose the status from `facts.describe_status` for rich: head lines, positions, alarms, checks.

    Control characters are escaped.
    """
    facts, folder = escape_all_to_one_line(facts), escape_to_one_line(folder)
    head = Table.grid(padding=(0, 2, 0, 0))
    for name, text, style in _yield_head_lines(facts, folder):
        head.add_row(f"{name:<8}", Text(text, style=style))
    parts: list[RenderableType] = [head]
    if facts["positions"]:
        parts.append(_make_position_table(facts["positions"]))
    if facts["alarms"]:
        parts.append(_make_alarm_table(facts["alarms"]))
        parts += _yield_alarm_checks(facts["alarms"])
    return Group(*parts)


def _yield_head_lines(facts: Facts, folder: str) -> Iterator[tuple[str, str, str]]:
    """Yield the name, text and style of each line above the tables; lines without content are left out."""
    yield "data", folder, ""
    yield "recorder", facts["recorder"], STYLES[facts["recorder_state"]]
    if facts["now_h"] is not None:
        written = facts["wall_age_s"]
        ago = "" if written is None else f", last written {format_duration(written)} ago"
        yield "now", f"hour {facts['now_h']:.2f} of the test{ago}", ""
    ahead_s = facts["system_ahead_s"]
    if ahead_s is not None and abs(ahead_s) > 1.0:
        side = "ahead of" if ahead_s > 0.0 else "behind"
        yield "clock", f"this computer's is {abs(ahead_s):.0f} s {side} the test's time", "yellow"
    if facts["supply"] is not None:
        good = facts["supply"]["quality"] == "good" and facts["supply"]["tripped"] is None
        yield "supply", facts["supply"]["description"], "" if good else "bold red"
    if facts["climate"] is not None:
        quality, air = facts["climate"]["climate_quality"], facts["climate"]
        read = "never read"
        if air["temperature_c"] is not None:
            read = f"{air['temperature_c']:.1f} °C, {100.0 * air['relative_humidity']:.0f} %"
        yield "climate", f"{read} ({quality})", "" if quality == "good" else "yellow"
    if facts["paused"]:
        reason = facts["paused"].removeprefix("paused ")
        yield "paused", f"{reason}; nothing strikes until it is resumed", "yellow"
    for order in facts["orders"]:
        wanted = f"{order['kind']} by {order['author']}"
        remaining = (
            f", expires in {format_duration(order['expires_in_s'])}" if order["state"] == "pending" else ""
        )
        yield "waiting", f"for the recorder's answer to {wanted} ({order['state']}{remaining})", "yellow"
    counts = facts["counts"]
    if counts is None:
        yield "", "no data yet", ""
        return
    if facts["next_due_h"] is not None:
        wait_s = 3600.0 * (facts["next_due_h"] - facts["now_h"])
        when = f"in {format_duration(wait_s)}" if wait_s >= 0.0 else f"{format_duration(-wait_s)} ago"
        number = counts["sets"] + counts["missed_sets"]
        yield "next", f"set {number}, due at hour {facts['next_due_h']:g}, {when}", ""
    missed = counts["missed_sets"]
    partial = f", {counts['partial_sets']} partial (shots missing)" if counts["partial_sets"] else ""
    yield "sets", f"{counts['sets']}, {missed} missed{partial}", ""
    yield "confirm", _format_confirmations(facts["confirmations"]), ""
    for text in _yield_gap_lines(facts["gaps"]):
        yield "gap", text, "yellow"
    for file, problem in facts["lost"].items():
        remedy = "" if "solimon" in problem else "; solimon repair --from BACKUP brings it back"
        yield "MISSING", f"{file} {problem}{remedy}", "bold red"
    yield from (("baseline", text, "") for text in _yield_baseline_lines(facts["positions"]))
    yield from (("result", *text) for text in _yield_diagnosis_lines(facts["positions"]))
    if any(row["chart"] for row in facts["positions"].values()):
        yield "rule", "control chart or diagnosis WALL; D² above its limit is an outlier, not an alarm", ""
    yield "disk", describe_disk_space(facts["disk"]), DISK_STYLES[facts["disk"]["level"]]
    apart = sum(row["suppressed"] is not None for row in facts["alarms"])
    suppressed = f", {apart} shelved or out of service" if apart else ""
    yield "alarms", f"{len(facts['alarms']) - apart or 'none'}{suppressed}", ""


def _yield_baseline_lines(positions: Mapping[str, Facts]) -> Iterator[str]:
    """Yield baseline quality and design false-alarm rates, equal texts of several positions in one line."""
    alike: dict[str, list[str]] = {}
    for name, row in positions.items():
        baseline = row["baseline"]
        if baseline is not None and baseline["state"] == "proposed" and baseline["limit_reason"]:
            alike.setdefault(f"NOT ASSESSED: {baseline['limit_reason']}", []).append(name)
        if baseline is None or baseline["rate_verified"] is None:
            continue
        why = baseline["rate_not_verified_reason"]
        verified = f"not verified: {why}" if why else "verified"
        if baseline["doubts"]:
            alike.setdefault(f"QUESTIONABLE: {'; '.join(baseline['doubts'])}", []).append(name)
        budget = baseline["false_alarms_per_sensor_year"]
        alike.setdefault(f"{budget:g} false alarms per transducer-year, {verified}", []).append(name)
    yield from (f"{', '.join(names)}: {text}" for text, names in alike.items())


def _yield_diagnosis_lines(positions: Mapping[str, Facts]) -> Iterator[tuple[str, str]]:
    """Yield text and style for each position whose newest set has a diagnosis other than OK."""
    for name, row in positions.items():
        assessment = row["last_assessment"]
        if not _is_of_same_set(row["last_feature"], assessment) or assessment["diagnosis"] in (None, OK):
            continue
        style = "bold red" if assessment["diagnosis"] == WALL else "yellow"
        sentence = format_diagnosis(
            assessment["diagnosis"], assessment["diagnosis_probability"], assessment["diagnosis_details"]
        )
        yield f"{name}, set {assessment['set_index']}: {sentence}", style


def _format_confirmations(facts: Facts) -> str:
    """Format the number of confirmation sets, how many are left today, and the newest result."""
    remaining = ", ".join(f"{name} {number}" for name, number in facts["left_today"].items())
    last = facts["last"]
    last_text = "" if last is None else f". The last was at {last['position']}. {describe_confirmation(last)}"
    return f"{facts['sets'] or 'no'} confirmation sets; left today: {remaining}{last_text}"


def _yield_gap_lines(gaps: Sequence[Facts]) -> Iterator[str]:
    """Yield one line per run of adjacent gaps with equal state, reason and positions."""
    for (state, reason, where), group in groupby(
        gaps, key=lambda gap: (gap["state"], gap["reason"], ", ".join(gap["positions"]))
    ):
        alike = list(group)
        first, last = alike[0], alike[-1]
        names = (
            f"set {first['set_index']}"
            if first is last
            else f"{len(alike)} sets, {first['set_index']} to {last['set_index']},"
        )
        yield f"{names} {state} at {where}, hour {last['due_h']:g}: {reason}"


def describe_disk_space(disk: Facts) -> str:
    """Describe the free space, the needed space (GB), and the hour at which the disk will be full."""
    level = {"ample": "", "stop": "; nothing more is stored until some is freed"}.get(disk["level"], "; low")
    needed = disk["needed_bytes"]
    rest = "" if needed is None else f", about {needed / 1e9:.2f} GB still to come"
    full = "" if disk["full_at_h"] is None else f": full at hour {disk['full_at_h']:g}"
    return f"{disk['free_bytes'] / 1e9:.2f} GB free{level}{rest}{full}"


def _create_table(*columns: str) -> Table:
    """Create an empty table with these column titles in the style of the status."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True, header_style="bold")
    for column in columns:
        table.add_column(column)
    return table


def _make_position_table(positions: Mapping[str, Facts]) -> Table:
    """Build the table of positions: state, newest result, limit, chart, quality, age, last set."""
    table = _create_table("position", "state", "result", "limit", "chart", "quality", "age", "last set")
    for name, row in positions.items():
        result, limit, quality = _format_result(row)
        age = "-" if row["age_h"] is None else format_duration(3600.0 * row["age_h"])
        its_set = row["last_set"]
        table.add_row(
            name,
            Text(row["state"].replace("_", " "), style=STYLES.get(row["state"], "")),
            result,
            limit,
            _format_chart(row),
            Text(quality, style=STYLES.get(quality.partition(",")[0], "")),
            Text(f"{age} STALE" if row["stale"] else age, style="yellow" if row["stale"] else ""),
            f"{its_set['set_index']} {its_set['state']}",
        )
    return table


def _format_result(row: Facts) -> tuple[str, str, str]:
    """Format result, limit and quality of a position's newest data, by its method; "-" if missing.

    Results are D², ToF (us) and AR, or the thickness (mm) with its interval.
    """
    echo, feature, assessment = row["last_thickness"], row["last_feature"], row["last_assessment"]
    if echo is not None:
        wall_m, low_m, high_m = (echo[name] for name in ("thickness_m", "interval_low_m", "interval_high_m"))
        between = "" if low_m is None else f" ({1e3 * low_m:.2f} to {1e3 * high_m:.2f})"
        result = "no echo" if wall_m is None else f"{1e3 * wall_m:.2f} mm{between}"
        return result, f"{1e3 * row['limit']:.2f} mm", echo["quality"]
    if feature is None:
        return "-", "-", "-"
    distance = assessment["distance_squared"] if _is_of_same_set(feature, assessment) else None
    none = "none yet" if row["state"] == "collecting_baseline" else "none"
    limit = none if row["limit"] is None else f"{row['limit']:.1f}"
    texts = []
    if distance is not None:
        texts.append(f"D² {distance:.1f}" if distance < LARGEST_IN_FULL else f"D² {distance:.1e}")
    if feature["tof_pp_s"] is not None:
        texts.append(f"ToF {1e6 * feature['tof_pp_s']:.1f} us")
    if feature["amplitude_ratio"] is not None:
        texts.append(f"AR {feature['amplitude_ratio']:.3f}")
    if (wall := row["last_wall"]) is not None and wall["thickness_m"] is not None:
        mm = [1e3 * wall[name] for name in ("thickness_m", "interval_low_m", "interval_high_m")]
        texts.append("wall {:.2f} mm ({:.2f} to {:.2f})".format(*mm))
    return ", ".join(texts) or "-", limit, f"{feature['quality']}, n = {feature['n_valid']}"


def _is_of_same_set(feature: Facts | None, assessment: Facts | None) -> bool:
    """Return whether both exist and the assessment belongs to the set of these features."""
    return feature is not None and assessment is not None and assessment["set_index"] == feature["set_index"]


def _format_chart(row: Facts) -> str:
    """Format statistic and limit of the control chart; "-" if the newest set has no chart or assessment."""
    chart = row["chart"]
    if chart is None or not _is_of_same_set(row["last_feature"], row["last_assessment"]):
        return "-"
    return f"{chart['statistic']:.1f} of {chart['limit']:.1f}"


def _yield_alarm_checks(alarms: Sequence[Facts]) -> Iterator[Text]:
    """Yield the numbered checks for each kind of active alarm that is not suppressed, once per kind.

    A kind without guidance is left out.
    """
    for kind in dict.fromkeys(row["kind"] for row in alarms if row["suppressed"] is None):
        if kind in GUIDANCE:
            yield Text(f"Checks, {kind.replace('_', ' ')}: {join_numbered_steps(GUIDANCE[kind].checks)}")


def _describe_alarm_state(row: Facts) -> str:
    """Describe the state of an alarm, with end, author and reason of a suppression."""
    state: str = row["state"].replace("_", " ")
    if row["suppressed"] is None:
        return state
    until = format_utc(row["shelved_until_utc_ns"], 0) if row["suppressed"] == "shelved" else ""
    text = f"shelved until {until}" if until else "out of service"
    return f"{state}, {text} by {row['suppressed_by']}: {row['suppressed_reason']}"


def _make_alarm_table(alarms: Sequence[Facts]) -> Table:
    """Build the table of alarms: id, priority, position, state, age, kind and message."""
    table = _create_table("alarm", "priority", "where", "state", "age", "what")
    for row in alarms:
        table.add_row(
            f"{row['id']}",
            row["priority"],
            row["position"] or "-",
            Text(_describe_alarm_state(row), style=STYLES.get(row["suppressed"] or row["state"], "")),
            format_duration(3600.0 * row["age_h"]),
            row["message"],
        )
    return table
