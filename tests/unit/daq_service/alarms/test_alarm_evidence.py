"""Evidence sentences of an alarm: units, limit and ratio to the limit; absent values are left out."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.filled_folder import frozen_baseline
from support.invented_rows import alarm_row

from analysis.waves.features import FEATURE_NAMES
from daq_service.alarms.evidence import FEATURES, build_evidence_sentences, describe_evidence
from daq_service.alarms.guidance import GUIDANCE

PROOFS: dict[str, dict[str, Any]] = {
    "wall_change": {
        "formula": "D = (x - mean)^T K^-1 (x - mean), equation 16",
        "rule": {"k": 3, "n": 5},
        "set_index": 49,
        "distance_squared": 48.6,
        "limit_name": "f_predictive",
        "limit": 24.3,
        "baseline_id": 2,
        "contributions": {"tof_pp_s": 24.3, "amplitude_ratio": 38.88, "tof_ac_s": -14.58, "other": None},
        "extractor_version": "3",
    },
    "thickness_low": {
        "rule": {"k": 3, "n": 5},
        "set_index": 40,
        "thickness_m": 5.6e-3,
        "interval_m": [5.5e-3, 5.7e-3],
        "roughness_rms_m": 21e-6,
        "limit_m": 5.715e-3,
        "travel_time_s": 9.9e-6,
        "reference_travel_time_s": 10.15e-6,
        "delay_s": 8e-6,
        "extractor_version": "1",
    },
    "no_reflection": {"rule": {"shots": 7, "consecutive_sets": 2}, "set_index": 12, "shots_without_psw": 9},
    "few_valid_shots": {"set_index": 8, "consecutive_poor_sets": 2, "minimum_valid_shots": 7},
    "transducer_disabled": {"command_id": 5},
    "instruments_unavailable": {"set_index": 3, "error": "ConnectionLostError"},
    "data_corrupt": {"set_aside": ["a.h5", "b.h5"], "damaged": {"c.h5": "is gone"}},
    "supply_current_limit": {
        "supply_state": "on",
        "supply_quality": "good",
        "supply_age_s": 0.4,
        "voltage_v": 9.5,
        "voltage_min_v": 9.0,
        "voltage_max_v": 10.0,
        "current_a": 0.2,
        "current_min_a": 0.19,
        "current_max_a": 0.21,
        "charge_coulomb": 120.0,
    },
}
"""As the conditions of each kind fill them."""


CHART: dict[str, Any] = {
    "set_index": 60,
    "mewma_statistic": 118.0,
    "limit": 59.0,
    "limit_name": "mewma",
    "distance_squared": 30.0,
    "rule": {"false_alarms_per_sensor_year": 0.2},
    "contributions": {"amplitude_ratio": 59.0, "tof_pp_s": 59.0},
    "rate_verified": False,
    "rate_not_verified_reason": "48 sets cannot show slow memory",
}


def test_the_evidence_of_a_chart_has_the_duration_and_the_design_rate():
    assert describe_evidence("wall_change", CHART) == [
        (
            "With set 60 the chart stands at 118, 2 times its limit of 59; it averages over sets, so the "
            "change has lasted."
        ),
        "What contributes most to the chart: amplitude ratio 50 %, time of flight between the peaks 50 %.",
        "The limit is made for 0.2 false alarms of a healthy sensor a year.",
        "That rate is not promised here: 48 sets cannot show slow memory.",
        "The set alone has a squared distance of 30 from the baseline (equation 16).",
    ]
    promised = {**CHART, "rate_not_verified_reason": None, "rate_verified": True}
    assert not any("not promised" in sentence for sentence in describe_evidence("wall_change", promised))


MOST_LISTED: dict[str, str] = {
    "wall_change": """
        Set 49 lies at a squared distance of 48.6 from the baseline, 2 times the limit of 24.3.
        What contributes most to the distance: amplitude ratio 80 %, time of flight between the peaks 50 %.
        The distance counts how far the five features lie from the baseline's mean, in units of their own
        scatter there (equation 16); the limit is the predictive F limit for a new set of a healthy wall.
        The alarm takes 3 of the last 5 judged sets beyond the limit.""",
    "thickness_low": """
        Set 40 reads a wall of 5.600 mm, 0.115 mm (2.0 %) below the limit of 5.715 mm.
        With 95 % confidence the mean under the beam is 5.500 mm to 5.700 mm thick, its roughness is about
        21 µm RMS.
        The echo took 9.900 µs, at the beginning 10.150 µs; less the probe's delay of 8.000 µs of both, the
        wall has thinned in this proportion (equation 17).
        The alarm takes 3 of the last 5 readings beyond the limit.""",
    "no_reflection": """
        Set 12 has 9 shots without a reflected wave.
        The alarm takes 7 such shots in a set, 2 sets running.""",
    "few_valid_shots": "2 sets running, the last one set 8, have fewer than 7 valid shots.",
    "transducer_disabled": "A person commanded it (command 5); the message states who and why.",
    "instruments_unavailable": "In set 3 the instruments' driver raised ConnectionLostError.",
    "data_corrupt": "c.h5: is gone. Set aside, damaged and without rows: a.h5, b.h5.",
    "supply_current_limit": """
        The supply's newest reading (good, 0 s old) tells its output as on.
        Since the set before, its voltage was 9.50 V in the mean (9.00 to 10.00 V).
        Since the set before, its current was 200.00 mA in the mean (190.00 to 210.00 mA).
        120.0 C have flowed since hour 0.""",
    "disk_space": "",
}


@pytest.mark.parametrize("kind", MOST_LISTED)
def test_each_kind_states_its_evidence(kind):
    assert " ".join(describe_evidence(kind, PROOFS.get(kind, {}))) == " ".join(MOST_LISTED[kind].split())


def alarm(kind, set_index=49):
    return alarm_row(None, kind, raised_h=24.5, raised_set_index=set_index, evidence=PROOFS.get(kind, {}))


def test_the_last_sentence_has_time_and_version_and_the_baseline_its_name():
    when = "Raised with set 49 at hour 24.50 of the test; computed by extractor 3."
    assert build_evidence_sentences(alarm("wall_change"))[-1] == when
    of_c, of_d = frozen_baseline("C"), frozen_baseline("D")
    first, *others = build_evidence_sentences(alarm("wall_change"), {2: of_c, 3: of_d})
    assert first.startswith("Set 49 lies at a squared distance of 48.6 from C-baseline-1, 2 times")
    assert others == build_evidence_sentences(alarm("wall_change"))[1:]
    assert build_evidence_sentences(alarm("disk_space", None)) == ["Raised at hour 24.50 of the test."]


def test_the_evidence_names_a_questionable_baseline_and_its_anomalies():
    named = [{"kind": "group", "set_indices": [3, 4]}, {"kind": "trend", "set_indices": [0, 1, 2, 3, 4]}]
    doubtful = frozen_baseline("C", baseline_quality={"named": named})
    assert build_evidence_sentences(alarm("wall_change"), {2: doubtful})[-2] == (
        "C-baseline-1, which the set is compared with, is doubtful: sets 3, 4 lie together, away from the "
        "others; a trend over the whole of it."
    )


@pytest.mark.parametrize(("cause", "counts"), [("wall", True), ("coupling", False)])
def test_a_wall_diagnosis_against_its_confirmation_set_mentions_that_set(cause, counts):
    confirmation = {"utc_ns": 0, "due_h": 25.5, "confirms": False, "reason": None}
    last = describe_evidence("wall_change", {"diagnosis": cause, "confirmation": confirmation})[-1]
    assert ("counts that set" in last) is counts


@given(st.sampled_from(sorted(GUIDANCE)), st.data())
def test_evidence_without_a_value_has_no_sentence_about_it(kind, data):
    complete = PROOFS.get(kind, PROOFS["supply_current_limit"])
    kept = data.draw(st.sets(st.sampled_from(sorted(complete))))
    sentences = describe_evidence(kind, {name: complete[name] for name in kept})
    assert (
        describe_evidence(kind, {name: complete[name] if name in kept else None for name in complete})
        == sentences
    )
    assert len(sentences) <= len(describe_evidence(kind, complete))
    assert "None" not in "".join(sentences)


def test_the_features_of_the_distance_have_names():
    assert tuple(FEATURES) == FEATURE_NAMES
