"""Evidence of an alarm as sentences for operators, for page, API, report and messages. Pure.

The evidence holds the values of the moment when the alarm was raised. That of an older folder may hold fewer
values; sentences about missing values are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Any

from daq_service.catalogue.rows import AlarmRow, BaselineRow
from daq_service.clock import format_utc
from hardware_drivers.measurement import SetKey

Evidence = Mapping[str, Any]

FEATURES: Mapping[str, str] = {
    "tof_pp_s": "time of flight between the peaks",
    "tof_ac_s": "time of flight by autocorrelation",
    "amplitude_ratio": "amplitude ratio",
    "autocorrelation_coefficient": "autocorrelation coefficient",
    "psw_area_v_s": "area of the reflected wave",
}
"""Names of the five features of the distance."""
INCIDENT: Mapping[str, str] = {
    "isw_amplitude_v": "height of the incident wave",
    "isw_fwhm_s": "width of the incident wave",
}
"""Names of the two features that do not depend on the wall."""
MOST_FEATURES = 3


def evidence_sentences(
    row: AlarmRow, baselines: Mapping[int, BaselineRow] = MappingProxyType({})
) -> list[str]:
    """Return the evidence of an alarm as sentences: values, limits, largest contributions, and time.

    Parameters
    ----------
    baselines
        Rows by their id. Without its row, a baseline is called "the baseline", without its quality.
    """
    baseline = baselines.get(row.evidence.get("baseline_id", 0))
    name = None if baseline is None else baseline.name
    doubts = [] if baseline is None else baseline_doubts(baseline.baseline_quality)
    with_set = "" if row.raised_set_key is None else f" with set {row.raised_set_key}"
    extractor = row.evidence.get("extractor_version")
    version = "" if extractor is None else f"; computed by extractor {extractor}"
    return [
        *describe_evidence(row.kind, {**row.evidence, "baseline": name}),
        *([f"{name}, which the set is compared with, is doubtful: {'; '.join(doubts)}."] if doubts else []),
        f"Raised{with_set} at hour {row.raised_h:.2f} of the test{version}.",
    ]


def describe_evidence(kind: str, evidence: Evidence) -> list[str]:
    """Return the sentences without the time, the most important first; empty without evidence."""
    return list(_OF_KIND.get(kind, _supply)(evidence))


def baseline_doubts(baseline_quality: Mapping[str, Any] | None) -> list[str]:
    """Describe the anomalies of a baseline (`assessment.baseline_quality`)."""
    return [
        {
            "group": f"sets {', '.join(map(str, anomaly['set_indices']))} lie together, away from the others",
            "outlier": f"set {anomaly['set_indices'][0]} lies alone, away from the others",
            "trend": "a trend over the whole of it",
        }.get(anomaly["kind"], anomaly["kind"])
        for anomaly in (baseline_quality or {}).get("named", ())
    ]


def _signal_change(evidence: Evidence) -> Iterator[str]:
    """Yield the sentences of a signal change: size, diagnosis and confirmation set."""
    yield from _distance_or_chart(evidence)
    if known := _values(evidence.get("diagnosis_details") or {}, "sentence", "action", "changes"):
        sentence, action, changes = known
        yield f"What it comes from: {sentence}. What to do: {action}."
        names = {**FEATURES, **INCIDENT}
        changes_text = [
            f"{names.get(name, name)} {100.0 * change:+.1f} %" for name, change in changes.items()
        ]
        yield f"Against the baseline, over some ten sets: {', '.join(changes_text)}."
    if confirmation := evidence.get("confirmation"):
        yield confirmation_sentence(confirmation)
        if confirmation["confirms"] is False and evidence.get("diagnosis") == "wall":
            yield "The wall is named all the same: its probability counts that set and those planned since."


def confirmation_sentence(confirmation: Evidence) -> str:
    """Describe the result of a confirmation set (`assessment.confirmation.ConfirmationResult`)."""
    at = f"{format_utc(confirmation['utc_ns'], 0)} (hour {confirmation['due_h']:.2f})"
    if confirmation["confirms"] is None:
        return (
            f"The confirmation set at {at} cannot tell: {confirmation['reason'] or 'a feature is missing'}."
        )
    if known := _values(confirmation, "distance_squared", "limit"):
        distance, limit = known
        relation = "beyond" if distance > limit else "within"
        at += f", squared distance {_number(distance)}, {relation} the limit of {_number(limit)},"
    if confirmation["confirms"]:
        return f"Confirmed: the set at {at} lies where the planned sets before it do."
    return f"Not confirmed: the set at {at} lies nearer to the baseline than to the planned sets before it."


def _distance_or_chart(evidence: Evidence) -> Iterator[str]:
    """Yield the sentences of the control chart if it decides, otherwise those of the squared distance."""
    if evidence.get("mewma_statistic") is not None:
        yield from _by_chart(evidence)
        return
    if known := _values(evidence, "set_index", "distance_squared", "limit"):
        set_index, distance, limit = known
        baseline = evidence.get("baseline") or "the baseline"
        yield (
            f"Set {set_index} lies at a squared distance of {_number(distance)} from {baseline}, "
            f"{_number(distance / limit)} times the limit of {_number(limit)}."
        )
    if known := _values(evidence, "contributions"):
        yield from _contributions(known[0])
    from analysis.statistics.named_limits import LIMITS  # with SciPy, which is slow to import

    if limit := LIMITS.get(evidence.get("limit_name", "")):
        yield (
            "The distance counts how far the five features lie from the baseline's mean, in units of "
            f"their own scatter there (equation 16); the limit is {limit.words}."
        )
    yield from _k_of_n(evidence, "judged sets")


def _by_chart(evidence: Evidence) -> Iterator[str]:
    """Yield the sentences of an alarm of the control chart or of a diagnosis."""
    by_cause = evidence.get("raised_by") == "diagnosis"
    if known := _values(evidence, "set_index", "mewma_statistic", "limit"):
        set_index, chart, limit = known
        remark = "" if by_cause else "; it averages over sets, so the change has lasted"
        yield (
            f"With set {set_index} the chart stands at {_number(chart)}, {_number(chart / limit)} times its "
            f"limit of {_number(limit)}{remark}."
        )
    if by_cause:
        yield (
            "It is not the chart that raised the alarm: two sets running, a confirmation counting as one, "
            "told the wall apart from every other cause. No rate of false alarms is promised for that; "
            "it was tried on the twin only."
        )
    if known := _values(evidence, "contributions"):
        yield from _contributions(known[0], to="the chart")
    if (known := _values(evidence.get("rule") or {}, "false_alarms_per_sensor_year")) and not by_cause:
        yield f"The limit is made for {known[0]:g} false alarms of a healthy sensor a year."
    if (known := _values(evidence, "rate_not_verified_reason")) and not by_cause:
        yield f"That rate is not promised here: {known[0]}."
    if known := _values(evidence, "distance_squared"):
        yield f"The set alone has a squared distance of {_number(known[0])} from the baseline (equation 16)."


def _contributions(contributions: Mapping[str, float | None], to: str = "the distance") -> Iterator[str]:
    """Yield the sentence with the features that contribute most."""
    known = {name: value for name, value in contributions.items() if value is not None}
    total = sum(known.values())
    largest = sorted(known, key=lambda name: -known[name])[:MOST_FEATURES]
    shares = [
        f"{FEATURES.get(name, name.replace('_', ' '))} {100.0 * known[name] / total:.0f} %"
        for name in largest
        if known[name] > 0.0 and total > 0.0
    ]
    if shares:
        yield f"What contributes most to {to}: {', '.join(shares)}."


def _thickness(evidence: Evidence) -> Iterator[str]:
    """Yield the sentences of a wall thickness and its limit."""
    if known := _values(evidence, "set_index", "thickness_m", "limit_m"):
        set_index, wall_m, limit_m = known
        difference_m = abs(limit_m - wall_m)
        percent, side = 100.0 * difference_m / limit_m, "below" if wall_m < limit_m else "above"
        yield (
            f"Set {set_index} reads a wall of {_mm(wall_m)}, {_mm(difference_m)} ({percent:.1f} %) {side} "
            f"the limit of {_mm(limit_m)}."
        )
    if known := _values(evidence, "interval_m"):
        low_m, high_m = known[0]
        roughness_values = _values(evidence, "roughness_rms_m")
        roughness = (
            f", its roughness is about {1e6 * roughness_values[0]:.0f} µm RMS" if roughness_values else ""
        )
        yield (
            f"With 95 % confidence the mean under the beam is {_mm(low_m)} to {_mm(high_m)} thick{roughness}."
        )
    if known := _values(evidence, "travel_time_s", "reference_travel_time_s", "delay_s"):
        now, first, delay = (f"{1e6 * value:.3f} µs" for value in known)
        yield (
            f"The echo took {now}, at the beginning {first}; less the probe's delay of {delay} of both, the "
            "wall has thinned in this proportion (equation 17)."
        )
    yield from _k_of_n(evidence, "readings")


def _k_of_n(evidence: Evidence, unit: str) -> Iterator[str]:
    if known := _values(evidence.get("rule") or {}, "k", "n"):
        yield f"The alarm takes {known[0]} of the last {known[1]} {unit} beyond the limit."


def _hole(evidence: Evidence) -> Iterator[str]:
    """Yield the sentences of shots without a reflected wave."""
    if known := _values(evidence, "set_index", "shots_without_psw"):
        yield f"Set {known[0]} has {known[1]} shots without a reflected wave."
    if known := _values(evidence.get("rule") or {}, "shots", "consecutive_sets"):
        yield f"The alarm takes {known[0]} such shots in a set, {known[1]} sets running."


def _poor_sets(evidence: Evidence) -> Iterator[str]:
    """Yield the sentences of sets with too few valid shots."""
    if known := _values(evidence, "consecutive_poor_sets", "set_index", "minimum_valid_shots"):
        n_sets, set_index, minimum = known
        yield f"{n_sets} sets running, the last one set {set_index}, have fewer than {minimum} valid shots."
    if known := _values(evidence, "command_id"):
        yield f"A person ordered it (order {known[0]}); the message says who and why."


def _rig(evidence: Evidence) -> Iterator[str]:
    """Yield the sentence of an instrument error."""
    if known := _values(evidence, "set_index", "error"):
        set_key = SetKey(known[0], evidence.get("unscheduled_index", 0))
        yield f"In set {set_key} the instruments' driver raised {known[1]}."
    elif known := _values(evidence, "error"):
        yield f"When the rig was to be opened, the instruments' driver raised {known[0]}."


def _data(evidence: Evidence) -> Iterator[str]:
    """Yield the sentences of corrupt files."""
    for file, fault in (evidence.get("damaged") or {}).items():
        yield f"{file}: {fault}."
    if quarantined := evidence.get("set_aside"):
        yield f"Set aside, damaged and without rows: {', '.join(quarantined)}."


def _supply(evidence: Evidence) -> Iterator[str]:
    """Yield the sentences of the supply's newest reading."""
    if known := _values(evidence, "supply_state", "supply_quality"):
        age = _values(evidence, "supply_age_s")
        age_text = f", {age[0]:.0f} s old" if age else ""
        yield f"The supply's newest reading ({known[1]}{age_text}) tells its output as {known[0]}."
    for name, scale, unit in (("voltage", 1.0, "V"), ("current", 1e3, "mA")):
        suffix = unit[-1].lower()
        if known := _values(evidence, f"{name}_{suffix}", f"{name}_min_{suffix}", f"{name}_max_{suffix}"):
            mean, low, high = (f"{scale * value:.2f}" for value in known)
            yield f"Since the set before, its {name} was {mean} {unit} in the mean ({low} to {high} {unit})."
    if known := _values(evidence, "charge_coulomb"):
        yield f"{known[0]:.1f} C have flowed since hour 0."


_OF_KIND: Mapping[str, Callable[[Evidence], Iterator[str]]] = {
    "wall_change": _signal_change,
    "transducer_change": _signal_change,
    "thickness_low": _thickness,
    "no_reflection": _hole,
    "few_valid_shots": _poor_sets,
    "transducer_disabled": _poor_sets,
    "instruments_unavailable": _rig,
    "data_corrupt": _data,
}
"""Functions by kind of alarm; all other kinds have the evidence of the supply, or none."""


def _values(evidence: Evidence, *names: str) -> list[Any]:
    """Return the values of these keys; an empty list if one is missing."""
    values = [evidence.get(name) for name in names]
    return [] if None in values else values


def _number(value: float) -> str:
    return f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.0f}"


def _mm(value_m: float) -> str:
    return f"{1e3 * value_m:.3f} mm"
