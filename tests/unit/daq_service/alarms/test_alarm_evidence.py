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
    "no_reflection": {
        "rule": {"shots": 7, "consecutive_sets": 2},
        "set_index": 12,
        "shots_without_psw": 9,
        "shots": 10,
    },
    "few_valid_shots": {"set_index": 8, "consecutive_poor_sets": 2, "minimum_valid_shots": 7},
    "transducer_disabled": {"command_id": 5, "author": "ann", "note": "coil is hot"},
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
    "rate_not_verified_reason": "48 sets, 150 needed",
}


def test_the_evidence_of_a_chart_has_the_duration_and_the_design_rate():
    assert describe_evidence("wall_change", CHART) == [
        (
            "Control chart (MEWMA) of set 60: 118, limit 59.0 (2.0 × limit). It averages over sets: the "
            "change lasts."
        ),
        "Largest contributions: amplitude ratio 50 %, time of flight between the peaks 50 %.",
        "Design false-alarm rate: 0.2 per transducer-year, not verified: 48 sets, 150 needed.",
        "Distance squared of set 60 alone: 30.0 (equation 16).",
    ]
    verified = {**CHART, "rate_not_verified_reason": None, "rate_verified": True}
    assert "Design false-alarm rate: 0.2 per transducer-year, verified." in describe_evidence(
        "wall_change", verified
    )


MOST_LISTED: dict[str, str] = {
    "wall_change": """
        Distance squared of set 49 to the baseline: 48.6, limit 24.3 (2.0 × limit).
        Limit: the predictive F limit for a new set of a healthy wall.
        Largest contributions: amplitude ratio 80 %, time of flight between the peaks 50 %.
        Distance: five features against the baseline's mean, in units of the baseline's scatter (equation 16).
        Alarm rule: 3 of the last 5 assessed sets above the limit.""",
    "thickness_low": """
        Wall thickness of set 40: 5.60 mm, limit 5.71 mm (0.115 mm, 2.0 % below).
        95 % confidence interval of the mean under the beam: 5.50 to 5.70 mm, roughness about 21 µm RMS.
        Travel time 9.900 µs, reference 10.150 µs, delay of the probe 8.000 µs in both (equation 17).
        Alarm rule: 3 of the last 5 readings with their complete interval below the limit.""",
    "no_reflection": """
        Shots without a reflected wave in set 12: 9 of 10.
        Alarm rule: 7 such shots in each of 2 consecutive sets.""",
    "few_valid_shots": "Consecutive sets with fewer than 7 valid shots: 2, the last is set 8.",
    "transducer_disabled": "Commanded by ann (command 5).",
    "instruments_unavailable": "Error of the driver in set 3: ConnectionLostError.",
    "data_corrupt": "c.h5: is gone. In quarantine, corrupt and without rows: a.h5, b.h5.",
    "supply_current_limit": """
        Newest reading of the supply (good, 0 s old): output on.
        Voltage since the set before: mean 9.50 V, 9.00 to 10.00 V.
        Current since the set before: mean 200.00 mA, 190.00 to 210.00 mA.
        Charge since hour 0: 120.0 C.""",
    "disk_space": "",
}


@pytest.mark.parametrize("kind", MOST_LISTED)
def test_each_kind_states_its_evidence(kind):
    assert " ".join(describe_evidence(kind, PROOFS.get(kind, {}))) == " ".join(MOST_LISTED[kind].split())


def alarm(kind, set_index=49):
    return alarm_row(None, kind, raised_h=24.5, raised_set_index=set_index, evidence=PROOFS.get(kind, {}))


def test_the_last_sentence_has_time_and_version_and_the_baseline_its_name():
    when = "Raised with set 49 at hour 24.50; computed by extractor 3."
    assert build_evidence_sentences(alarm("wall_change"))[-1] == when
    of_c, of_d = frozen_baseline("C"), frozen_baseline("D")
    first, *others = build_evidence_sentences(alarm("wall_change"), {2: of_c, 3: of_d})
    assert first.startswith("Distance squared of set 49 to C-baseline-1: 48.6, limit 24.3 (2.0 × limit).")
    assert others == build_evidence_sentences(alarm("wall_change"))[1:]
    assert build_evidence_sentences(alarm("disk_space", None)) == ["Raised at hour 24.50."]


def test_the_evidence_names_a_questionable_baseline_and_its_anomalies():
    named = [{"kind": "group", "set_indices": [3, 4]}, {"kind": "trend", "set_indices": [0, 1, 2, 3, 4]}]
    doubtful = frozen_baseline("C", baseline_quality={"named": named})
    assert build_evidence_sentences(alarm("wall_change"), {2: doubtful})[-2] == (
        "Questionable baseline C-baseline-1: sets 3, 4 form a group apart from the others; a trend over the "
        "complete baseline."
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
