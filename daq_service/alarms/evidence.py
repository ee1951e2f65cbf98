"""What an alarm rests on, as sentences for an operator: for the page, the API, the report and messages. Pure.

A proof holds what was known when the alarm was raised; that of an older folder may hold less, and what it
does not hold is not said.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Any

from daq_service.catalogue.rows import AlarmRow, BaselineRow
from daq_service.clock import format_utc

Proof = Mapping[str, Any]

FEATURES: Mapping[str, str] = {
    "tof_pp_s": "time of flight between the peaks",
    "tof_ac_s": "time of flight by autocorrelation",
    "amplitude_ratio": "amplitude ratio",
    "autocorrelation_coefficient": "autocorrelation coefficient",
    "psw_area_v_s": "area of the reflected wave",
}
"""The five of the distance, in words."""
INCIDENT: Mapping[str, str] = {
    "isw_amplitude_v": "height of the incident wave",
    "isw_fwhm_s": "width of the incident wave",
}
"""The two that no wall changes."""
MOST_FEATURES = 3


def proof_sentences(row: AlarmRow, baselines: Mapping[int, BaselineRow] = MappingProxyType({})) -> list[str]:
    """Say what was measured, by how much it passes which limit, what contributes most, and when that was.

    Parameters
    ----------
    baselines
        By their id, which a proof holds; without its name it is "the baseline", and is not doubted.
    """
    baseline = baselines.get(row.proof.get("baseline_id", 0))
    name = None if baseline is None else baseline.name
    doubts = [] if baseline is None else baseline_doubts(baseline.readiness)
    with_set = "" if row.raised_set_index is None else f" with set {row.raised_set_index}"
    extractor = row.proof.get("extractor_version")
    by = "" if extractor is None else f"; computed by extractor {extractor}"
    return [
        *evidence(row.kind, {**row.proof, "baseline": name}),
        *([f"{name}, which the set is compared with, is doubtful: {'; '.join(doubts)}."] if doubts else []),
        f"Raised{with_set} at hour {row.raised_h:.2f} of the test{by}.",
    ]


def evidence(kind: str, proof: Proof) -> list[str]:
    """Say the same but for when; the first sentence says most, and there is none where there is no proof."""
    return list(_OF_KIND.get(kind, _supply)(proof))


def baseline_doubts(readiness: Mapping[str, Any] | None) -> list[str]:
    """Say what stands out of a baseline (`judgement.readiness`)."""
    return [
        {
            "group": f"sets {', '.join(map(str, one['set_indices']))} lie together, away from the others",
            "outlier": f"set {one['set_indices'][0]} lies alone, away from the others",
            "trend": "a trend over the whole of it",
        }.get(one["kind"], one["kind"])
        for one in (readiness or {}).get("named", ())
    ]


def _wall_change(proof: Proof) -> Iterator[str]:
    yield from _what_it_rests_on(proof)
    if told := _known(proof.get("cause_told") or {}, "sentence", "action", "changes"):
        sentence, action, changes = told
        yield f"What it comes from: {sentence}. What to do: {action}."
        words = {**FEATURES, **INCIDENT}
        moved = [f"{words.get(name, name)} {100.0 * change:+.1f} %" for name, change in changes.items()]
        yield f"Against the baseline, over some ten sets: {', '.join(moved)}."
    if said := proof.get("confirmation"):
        yield confirmation_sentence(said)
        if said["confirms"] is False and proof.get("cause") == "wall":
            yield "The wall is named all the same: its probability counts that set and those planned since."


def confirmation_sentence(said: Proof) -> str:
    """Tell what a confirmation set says (`judgement.confirmation.Confirmed`)."""
    at = f"{format_utc(said['utc_ns'], 0)} (hour {said['due_h']:.2f})"
    if said["confirms"] is None:
        return f"The confirmation set at {at} cannot tell: {said['why_not'] or 'a feature is missing'}."
    if told := _known(said, "distance_squared", "limit"):
        distance, limit = told
        beyond = "beyond" if distance > limit else "within"
        at += f", squared distance {_number(distance)}, {beyond} the limit of {_number(limit)},"
    if said["confirms"]:
        return f"Confirmed: the set at {at} lies where the planned sets before it do."
    return f"Not confirmed: the set at {at} lies nearer to the baseline than to the planned sets before it."


def _what_it_rests_on(proof: Proof) -> Iterator[str]:
    if proof.get("chart") is not None:
        yield from _by_chart(proof)
        return
    if told := _known(proof, "set_index", "distance_squared", "limit"):
        set_index, distance, limit = told
        its = proof.get("baseline") or "the baseline"
        yield (
            f"Set {set_index} lies at a squared distance of {_number(distance)} from {its}, "
            f"{_number(distance / limit)} times the limit of {_number(limit)}."
        )
    if told := _known(proof, "contributions"):
        yield from _contributions(told[0])
    from analysis.statistics.named_limits import LIMITS  # with SciPy, which is slow to import

    if limit := LIMITS.get(proof.get("limit_name", "")):
        yield (
            "The distance counts how far the five features lie from the baseline's mean, in units of "
            f"their own scatter there (equation 16); the limit is {limit.words}."
        )
    yield from _k_of_n(proof, "judged sets")


def _by_chart(proof: Proof) -> Iterator[str]:
    by_cause = proof.get("raised_by") == "cause"
    if told := _known(proof, "set_index", "chart", "limit"):
        set_index, chart, limit = told
        lasted = "" if by_cause else "; it averages over sets, so the change has lasted"
        yield (
            f"With set {set_index} the chart stands at {_number(chart)}, {_number(chart / limit)} times its "
            f"limit of {_number(limit)}{lasted}."
        )
    if by_cause:
        yield (
            "It is not the chart that raised the alarm: two sets running, a confirmation counting as one, "
            "told the wall apart from every other cause. No rate of false alarms is promised for that; "
            "it was tried on the twin only."
        )
    if told := _known(proof, "contributions"):
        yield from _contributions(told[0], to="the chart")
    if (told := _known(proof.get("rule") or {}, "false_alarms_per_sensor_year")) and not by_cause:
        yield f"The limit is made for {told[0]:g} false alarms of a healthy sensor a year."
    if (told := _known(proof, "why_not_guaranteed")) and not by_cause:
        yield f"That rate is not promised here: {told[0]}."
    if told := _known(proof, "distance_squared"):
        yield f"The set alone has a squared distance of {_number(told[0])} from the baseline (equation 16)."


def _contributions(parts: Mapping[str, float | None], to: str = "the distance") -> Iterator[str]:
    known = {name: part for name, part in parts.items() if part is not None}
    whole = sum(known.values())
    most = sorted(known, key=lambda name: -known[name])[:MOST_FEATURES]
    shares = [
        f"{FEATURES.get(name, name.replace('_', ' '))} {100.0 * known[name] / whole:.0f} %"
        for name in most
        if known[name] > 0.0 and whole > 0.0
    ]
    if shares:
        yield f"What contributes most to {to}: {', '.join(shares)}."


def _thickness(proof: Proof) -> Iterator[str]:
    if told := _known(proof, "set_index", "thickness_m", "limit_m"):
        set_index, wall_m, limit_m = told
        away_m = abs(limit_m - wall_m)
        part, side = 100.0 * away_m / limit_m, "below" if wall_m < limit_m else "above"
        yield (
            f"Set {set_index} reads a wall of {_mm(wall_m)}, {_mm(away_m)} ({part:.1f} %) {side} the "
            f"limit of {_mm(limit_m)}."
        )
    if told := _known(proof, "interval_m"):
        low_m, high_m = told[0]
        rough = _known(proof, "roughness_rms_m")
        roughness = f", its roughness is about {1e6 * rough[0]:.0f} µm RMS" if rough else ""
        yield (
            f"With 95 % confidence the mean under the beam is {_mm(low_m)} to {_mm(high_m)} thick{roughness}."
        )
    if told := _known(proof, "travel_time_s", "reference_travel_time_s", "delay_s"):
        now, first, delay = (f"{1e6 * value:.3f} µs" for value in told)
        yield (
            f"The echo took {now}, at the beginning {first}; less the probe's delay of {delay} of both, the "
            "wall has thinned in this proportion (equation 17)."
        )
    yield from _k_of_n(proof, "readings")


def _k_of_n(proof: Proof, what: str) -> Iterator[str]:
    if told := _known(proof.get("rule") or {}, "k", "n"):
        yield f"The alarm takes {told[0]} of the last {told[1]} {what} beyond the limit."


def _hole(proof: Proof) -> Iterator[str]:
    if told := _known(proof, "set_index", "shots_without_psw"):
        yield f"Set {told[0]} has {told[1]} shots without a reflected wave."
    if told := _known(proof.get("rule") or {}, "shots", "consecutive_sets"):
        yield f"The alarm takes {told[0]} such shots in a set, {told[1]} sets running."


def _poor_sets(proof: Proof) -> Iterator[str]:
    if told := _known(proof, "poor_sets_running", "set_index", "minimum_valid_shots"):
        running, set_index, minimum = told
        yield f"{running} sets running, the last one set {set_index}, have fewer than {minimum} valid shots."
    if told := _known(proof, "command_id"):
        yield f"A person ordered it (order {told[0]}); the message says who and why."


def _rig(proof: Proof) -> Iterator[str]:
    if told := _known(proof, "set_index", "error"):
        yield f"In set {told[0]} the instruments' driver raised {told[1]}."
    elif told := _known(proof, "error"):
        yield f"When the rig was to be opened, the instruments' driver raised {told[0]}."


def _data(proof: Proof) -> Iterator[str]:
    for file, what in (proof.get("damaged") or {}).items():
        yield f"{file}: {what}."
    if aside := proof.get("set_aside"):
        yield f"Set aside, damaged and without rows: {', '.join(aside)}."


def _supply(proof: Proof) -> Iterator[str]:
    if told := _known(proof, "supply_state", "supply_quality"):
        age = _known(proof, "supply_age_s")
        aged = f", {age[0]:.0f} s old" if age else ""
        yield f"The supply's newest reading ({told[1]}{aged}) tells its output as {told[0]}."
    for name, scale, unit in (("voltage", 1.0, "V"), ("current", 1e3, "mA")):
        end = unit[-1].lower()
        if told := _known(proof, f"{name}_{end}", f"{name}_min_{end}", f"{name}_max_{end}"):
            mean, low, high = (f"{scale * value:.2f}" for value in told)
            yield f"Since the set before, its {name} was {mean} {unit} in the mean ({low} to {high} {unit})."
    if told := _known(proof, "charge_coulomb"):
        yield f"{told[0]:.1f} C have flowed since hour 0."


_OF_KIND: Mapping[str, Callable[[Proof], Iterator[str]]] = {
    "wall_change": _wall_change,
    "transducer_change": _wall_change,
    "thickness": _thickness,
    "hole": _hole,
    "no_data": _poor_sets,
    "retired": _poor_sets,
    "rig_unavailable": _rig,
    "data_damaged": _data,
}
"""By kind whose proof has its own keys; the others have the supply's, or none."""


def _known(proof: Proof, *names: str) -> list[Any]:
    """Return these values; nothing where one of them is not known."""
    values = [proof.get(name) for name in names]
    return [] if None in values else values


def _number(value: float) -> str:
    return f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.0f}"


def _mm(value_m: float) -> str:
    return f"{1e3 * value_m:.3f} mm"
