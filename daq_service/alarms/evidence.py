"""Evidence of an alarm as sentences for operators, for page, API, report and messages. Pure.

The evidence holds the values of the moment when the alarm was raised. That of an older folder may hold fewer
values; sentences about missing values are left out.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from string import Formatter
from types import MappingProxyType
from typing import Any

from daq_service.catalogue.rows import AlarmRow, BaselineRow
from daq_service.clock import format_utc
from hardware_drivers.measurement import SetKey

Evidence = Mapping[str, Any]

_TEXTS = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
FEATURES: Mapping[str, str] = _TEXTS["features"]
"""Names of the five features of the distance."""
INCIDENT: Mapping[str, str] = _TEXTS["incident"]
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
    doubts = [] if baseline is None else describe_baseline_anomalies(baseline.baseline_quality)
    with_set = "" if row.raised_set_key is None else f" with set {row.raised_set_key}"
    extractor = row.evidence.get("extractor_version")
    version = "" if extractor is None else f"; computed by extractor {extractor}"
    return [
        *describe_evidence(row.kind, {**row.evidence, "baseline": name}),
        *([f"{name}, which the set is compared with, is doubtful: {'; '.join(doubts)}."] if doubts else []),
        f"Raised{with_set} at hour {row.raised_h:.2f} of the test{version}.",
    ]


def describe_evidence(kind: str, evidence: Evidence) -> list[str]:
    """Return the evidence of an alarm of a kind as sentences without the time, the most important first.

    A sentence with an unknown value is left out; the list may be empty. A kind without texts of its own is
    described by the supply values in the evidence.
    """
    return list(_OF_KIND.get(kind, _describe_supply)(evidence))


def describe_baseline_anomalies(baseline_quality: Mapping[str, Any] | None) -> list[str]:
    """Describe each anomaly of a baseline (group, outlier or trend of its sets) as a clause.

    The list is empty without anomalies, or if the quality (column ``baseline_quality``) is None. An unknown
    kind of anomaly is described by its name.
    """
    return [
        {
            "group": f"sets {', '.join(map(str, anomaly['set_indices']))} lie together, away from the others",
            "outlier": f"set {anomaly['set_indices'][0]} lies alone, away from the others",
            "trend": "a trend over the whole of it",
        }.get(anomaly["kind"], anomaly["kind"])
        for anomaly in (baseline_quality or {}).get("named", ())
    ]


class _Sentences(Formatter):
    """Fills sentences in; an unknown value raises KeyError, and units are formats."""

    def get_field(self, field_name: str, args: Sequence[object], kwargs: Mapping[str, object]) -> object:
        """Return the value of a placeholder, with its key; raise KeyError if it is missing or None."""
        name, *_ = field_name.partition("[")
        if kwargs.get(name) is None or (found := super().get_field(field_name, args, kwargs))[0] is None:
            raise KeyError(field_name)
        return found

    def format_field(self, value: object, format_spec: str) -> str:
        """Format a number in the unit that the format spec names (`_UNITS`, from SI); else as Python does."""
        unit = _UNITS.get(format_spec)
        if unit is not None and isinstance(value, int | float):
            return unit(value)
        return str(super().format_field(value, format_spec))


def _fill_sentences(part: str, evidence: Evidence) -> Iterator[str]:
    """Yield the sentences of a section of the text table `evidence.toml`, filled with evidence values.

    A sentence whose value is missing or None is left out. Raise KeyError for an unknown section.
    """
    for sentence in _TEXTS["sentences"][part]:
        try:
            text = _Sentences().vformat(sentence, (), evidence)
        except KeyError:
            continue
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
    known = {
        **evidence,
        "baseline": evidence.get("baseline") or "the baseline",
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
            yield "The wall is named all the same: its probability counts that set and those planned since."


def describe_confirmation(confirmation: Evidence) -> str:
    """Describe the result of a confirmation set (`ConfirmationResult` as a mapping) in one sentence.

    It has UTC and hour of the set; for an undetermined result the reason; otherwise also the squared distance
    and its limit, if both are known.
    """
    at = f"{format_utc(confirmation['utc_ns'], 0)} (hour {confirmation['due_h']:.2f})"
    if confirmation["confirms"] is None:
        return (
            f"The confirmation set at {at} cannot tell: {confirmation['reason'] or 'a feature is missing'}."
        )
    if known := _get_known_values(confirmation, "distance_squared", "limit"):
        distance, limit = known
        relation = "beyond" if distance > limit else "within"
        at += f", squared distance {_format_value(distance)}, {relation} the limit of {_format_value(limit)},"
    if confirmation["confirms"]:
        return f"Confirmed: the set at {at} lies where the planned sets before it do."
    return f"Not confirmed: the set at {at} lies nearer to the baseline than to the planned sets before it."


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
    rms_m = evidence.get("roughness_rms_m")
    known["roughness"] = "" if rms_m is None else f", its roughness is about {1e6 * rms_m:.0f} µm RMS"
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
        yield f"Set aside, damaged and without rows: {', '.join(quarantined)}."


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


def _format_value(value: float) -> str:
    """Format a number with three significant digits; from 1000 on (absolute value) as an integer."""
    return f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.0f}"


_UNITS: Mapping[str, Callable[[float], str]] = {
    "number": _format_value,
    "mm": lambda value_m: f"{1e3 * value_m:.3f} mm",
    "us": lambda value_s: f"{1e6 * value_s:.3f} µs",
    "milli": lambda value: f"{1e3 * value:.2f}",
    "mA": lambda value_a: f"{1e3 * value_a:.2f} mA",
}
