"""Evidence of an alarm as lines for operators, for page, API, report and notifications. Pure.

The evidence holds the values of the set with which the alarm was raised. That of an older folder may hold
fewer values; lines about missing values are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from types import MappingProxyType
from typing import Any

from daq_service.alarms.states import (
    RESPOND_WITHIN_H,
    TEXTS,
    Evidence,
    describe_alarm,
    fill_text,
    format_number,
    format_probability,
)
from daq_service.catalogue.rows import AlarmRow, BaselineRow
from daq_service.clock import format_utc
from hardware_drivers.measurement import SetKey

FEATURES: Mapping[str, str] = TEXTS["features"]
"""Names of the five features of the distance."""
INCIDENT: Mapping[str, str] = TEXTS["incident"]
"""Names of the two features that do not depend on the wall."""
MOST_FEATURES = 3


def build_evidence_sentences(
    row: AlarmRow, baselines: Mapping[int, BaselineRow] = MappingProxyType({})
) -> list[str]:
    """Return the evidence of an alarm as sentences: values, limits, contributions, baseline anomalies, time.

    The most important come first; the last sentence, always there, has the set (if any), the hour of the test
    and the extractor version (if known) with which the alarm was raised.

    Parameters
    ----------
    baselines
        Rows by their id. Without its row, a baseline is called "the baseline", and its anomalies are left
        out.
    """
    baseline = baselines.get(row.evidence.get("baseline_id", 0))
    name = None if baseline is None else baseline.name
    anomalies = [] if baseline is None else describe_baseline_anomalies(baseline.baseline_quality)
    with_set = "" if row.raised_set_key is None else f" with set {row.raised_set_key}"
    extractor = row.evidence.get("extractor_version")
    version = "" if extractor is None else f"; computed by extractor {extractor}"
    return [
        *describe_evidence(row.kind, {**row.evidence, "baseline": name}),
        *([f"Questionable baseline {name}: {'; '.join(anomalies)}."] if anomalies else []),
        f"Raised{with_set} at hour {row.raised_h:.2f}{version}.",
    ]


def build_alarm_columns(
    row: AlarmRow, baselines: Mapping[int, BaselineRow] = MappingProxyType({})
) -> dict[str, object]:
    """Return what API and exports add to an alarm's row: headline, action, time to respond, evidence."""
    texts = describe_alarm(row)
    return {
        "headline": texts.headline,
        "action": texts.action,
        "response_time_s": 3600.0 * RESPOND_WITHIN_H[row.priority],
        "evidence_sentences": build_evidence_sentences(row, baselines),
    }


def describe_evidence(kind: str, evidence: Evidence) -> list[str]:
    """Return the evidence of an alarm of a kind as sentences without the time, the most important first.

    A sentence with an unknown value is left out; the list may be empty. A kind without texts of its own is
    described by the supply values in the evidence.
    """
    return list(_OF_KIND.get(kind, _describe_supply)(evidence))


def describe_baseline_anomalies(baseline_quality: Evidence | None) -> list[str]:
    """Describe each anomaly of a baseline (group, outlier or trend of its sets) as a clause.

    The list is empty without anomalies, or if the quality (column ``baseline_quality``) is None. An unknown
    kind of anomaly is described by its name.
    """
    return [
        {
            "group": f"sets {', '.join(map(str, anomaly['set_indices']))} form a group apart from the others",
            "outlier": f"set {anomaly['set_indices'][0]} is an outlier",
            "trend": "a trend over the complete baseline",
        }.get(anomaly["kind"], anomaly["kind"])
        for anomaly in (baseline_quality or {}).get("named", ())
    ]


def _fill_sentences(part: str, evidence: Evidence) -> Iterator[str]:
    """Yield the sentences of a section of the text table `texts.toml`, filled with evidence values.

    A sentence whose value is missing or None is left out. Raise KeyError for an unknown section.
    """
    for sentence in TEXTS["evidence"][part]:
        if text := fill_text(sentence, evidence):
            yield text


def _describe_signal_change(evidence: Evidence) -> Iterator[str]:
    """Yield the sentences of a signal change: its size, its diagnosis, and the result of a confirmation set.

    The size is that of the MEWMA chart if the evidence has its statistic, otherwise the squared distance.
    """
    statistic = evidence.get("mewma_statistic")
    part = "diagnosis" if evidence.get("raised_by") == "diagnosis" else "chart"
    limit_words = None
    if statistic is None:
        from analysis.statistics.named_limits import LIMITS  # with SciPy, which is slow to import

        part, statistic = "distance", evidence.get("distance_squared")
        named = LIMITS.get(evidence.get("limit_name", ""))
        limit_words = None if named is None else named.words
    details, limit = evidence.get("diagnosis_details") or {}, evidence.get("limit")
    names = {**FEATURES, **INCIDENT}
    changes = [
        f"{names.get(name, name)} {100.0 * change:+.1f} %"
        for name, change in (details.get("changes") or {}).items()
    ]
    probabilities = [
        f"{cause.upper()} {format_probability(value)}"
        for cause, value in (details.get("probabilities") or {}).items()
    ]
    rule_is_verified, reason = evidence.get("rate_verified"), evidence.get("rate_not_verified_reason")
    known = {
        **evidence,
        "baseline": evidence.get("baseline") or "the baseline",
        "probabilities": ", ".join(probabilities) or None,
        "rate_verified": "verified" if rule_is_verified else f"not verified: {reason or 'reason unknown'}",
        "times_limit": None if statistic is None or limit is None else statistic / limit,
        "shares": _format_largest_contributions(evidence.get("contributions") or {}) or None,
        "limit_words": limit_words,
        "changes": ", ".join(changes) if "changes" in details else None,
    }
    yield from _fill_sentences(part, known)
    yield from _fill_sentences("cause", known)
    if confirmation := evidence.get("confirmation"):
        yield describe_confirmation(confirmation)
        if confirmation["confirms"] is False and evidence.get("diagnosis") == "wall":
            yield "The diagnosis remains WALL: its probability counts that set and the scheduled ones since."


def describe_confirmation(confirmation: Evidence) -> str:
    """Describe the result of a confirmation set (`ConfirmationResult` as a mapping) in one sentence.

    It has UTC and hour of the set; for an undetermined result the reason; otherwise also the squared distance
    and its limit, if both are known.
    """
    at = f"{format_utc(confirmation['utc_ns'], 0)} (hour {confirmation['due_h']:.2f})"
    if confirmation["confirms"] is None:
        reason = confirmation["reason"] or "a feature is missing"
        return f"Confirmation set of {at}: no result, {reason}."
    if known := _get_known_values(confirmation, "distance_squared", "limit"):
        distance, limit = known
        relation = "above" if distance > limit else "below"
        at += f", distance squared {format_number(distance)}, {relation} the limit of {format_number(limit)}"
    if confirmation["confirms"]:
        return f"Confirmed by the set of {at}: it agrees with the scheduled sets before it."
    return f"Not confirmed by the set of {at}: it is nearer to the baseline than to the sets before it."


def _format_largest_contributions(contributions: Mapping[str, float | None]) -> str:
    """Format the largest `MOST_FEATURES` contributions of features, descending, in percent of the sum.

    Contributions that are None or not positive are left out; empty if none remains.
    """
    known = {name: value for name, value in contributions.items() if value is not None}
    total = sum(known.values())
    largest = sorted(known, key=lambda name: -known[name])[:MOST_FEATURES]
    return ", ".join(
        f"{FEATURES.get(name, name.replace('_', ' '))} {100.0 * known[name] / total:.0f} %"
        for name in largest
        if known[name] > 0.0 and total > 0.0
    )


def _describe_thickness(evidence: Evidence) -> Iterator[str]:
    """Yield sentences about a wall thickness, its limit, their difference (if both are known), roughness."""
    known = dict(evidence)
    if values := _get_known_values(evidence, "thickness_m", "limit_m"):
        wall_m, limit_m = values
        known["difference_m"] = difference_m = abs(limit_m - wall_m)
        known |= {"percent": 100.0 * difference_m / limit_m, "side": "below" if wall_m < limit_m else "above"}
    low_m, high_m = evidence.get("interval_m") or (None, None)
    known |= {"low_mm": low_m and 1e3 * low_m, "high_mm": high_m and 1e3 * high_m}
    rms_m = evidence.get("roughness_rms_m")
    known["roughness"] = "" if rms_m is None else f", roughness about {1e6 * rms_m:.0f} µm RMS"
    if "below_minimum_probability" in evidence:  # of waves: their interval has a sentence of its own
        known["roughness"] = None
    yield from _fill_sentences("thickness_low", known)


def _describe_rig_error(evidence: Evidence) -> Iterator[str]:
    """Yield the sentences of an instrument error in a set; without a set index, of one at opening the rig."""
    if (set_index := evidence.get("set_index")) is None:
        yield from _fill_sentences("opening", evidence)
    else:
        set_key = SetKey(set_index, evidence.get("unscheduled_index", 0))
        yield from _fill_sentences("instruments", {**evidence, "set_key": set_key})


def _describe_corrupt_files(evidence: Evidence) -> Iterator[str]:
    """Yield a sentence for each damaged file with its fault, then one for all sets in quarantine (if any)."""
    for file, fault in (evidence.get("damaged") or {}).items():
        yield f"{file}: {fault}."
    if quarantined := evidence.get("set_aside"):
        yield f"In quarantine, corrupt and without rows: {', '.join(quarantined)}."


def _describe_supply(evidence: Evidence) -> Iterator[str]:
    """Yield the sentences of the supply's reading in the evidence with its age; none for unknown values."""
    age_s = evidence.get("supply_age_s")
    yield from _fill_sentences("supply", {**evidence, "age": "" if age_s is None else f", {age_s:.0f} s old"})


_OF_KIND: Mapping[str, Callable[[Evidence], Iterator[str]]] = {
    "wall_change": _describe_signal_change,
    "transducer_change": _describe_signal_change,
    "thickness_low": _describe_thickness,
    "no_reflection": partial(_fill_sentences, "no_reflection"),
    "few_valid_shots": partial(_fill_sentences, "poor_sets"),
    "transducer_disabled": partial(_fill_sentences, "poor_sets"),
    "instruments_unavailable": _describe_rig_error,
    "data_corrupt": _describe_corrupt_files,
}
"""Functions by kind of alarm; all other kinds have the evidence of the supply, or none."""


def _get_known_values(evidence: Evidence, *names: str) -> list[Any]:
    """Return the values of these keys in order; an empty list if one is missing or None."""
    values = [evidence.get(name) for name in names]
    return [] if None in values else values
