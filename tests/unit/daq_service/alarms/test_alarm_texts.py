"""Headline, message and action of each kind of alarm: lengths, order, missing values."""

from typing import Any

import pytest
from support.invented_rows import alarm_row

from daq_service.alarms.states import (
    LONGEST_HEADLINE,
    LONGEST_MESSAGE,
    TEXTS,
    build_alarm_texts,
    describe_alarm,
    format_number,
    format_probability,
)

VALUES: dict[str, Any] = {
    "mewma_statistic": 72.04,
    "limit": 61.0,
    "diagnosis_probability": 0.978,
    "thickness_m": 4.57e-3,
    "limit_m": 5.715e-3,
    "interval_m": [3.84e-3, 5.30e-3],
    "shots_without_psw": 9,
    "shots": 10,
    "rule": {"consecutive_sets": 2},
    "consecutive_poor_sets": 2,
    "reason": "the coil is hot",
    "author": "ann",
    "note": "coil is hot",
    "error_message": "no such channel",
    "error": "disk quota exceeded",
    "waits_in": "journal",
    "damaged": {"set_000049.h5": "checksum differs"},
    "free_percent": 8.02,
    "stop_percent": 5.0,
    "free_gb": 7.99,
    "silent_s": 61.2,
    "read_error": "no answer within 5 s",
    "tripped_by": "protection tripped: OVP",
    "measured": "3.2 V, 0.00 A",
    "setpoint": "10 V",
    "least_a": 0.01,
    "limit_a": 1.0,
    "trip_reason": "hole at B",
}
VARIANTS = [
    (kind, name) for kind, texts in TEXTS["kinds"].items() for name in ("", *texts.get("variants", ()))
]


def evidence_of(variant: str) -> dict[str, Any]:
    """Return evidence that selects a variant."""
    if variant in ("stopped", "unverified"):
        return {variant: True}
    details = {"abrupt": 0.9 if variant == "abrupt" else 0.1}
    return {
        "diagnosis": "undetermined" if variant in ("", "abrupt") else variant,
        "diagnosis_details": details,
    }


@pytest.mark.parametrize(("kind", "variant"), VARIANTS)
def test_a_message_is_headline_value_hour_and_action(kind, variant):
    texts = build_alarm_texts(kind, "B", VALUES | evidence_of(variant), 55.5)
    table = TEXTS["kinds"][kind]
    own = table["variants"][variant] if variant else table
    assert texts.headline.startswith(own["headline"].partition("{")[0].replace("{position}", "B"))
    assert len(texts.headline) <= LONGEST_HEADLINE
    assert texts.headline.isascii(), "it fits an SMS"
    assert texts.message.startswith(texts.headline)
    assert texts.message.endswith(f" (hour 55.5). {texts.action}")
    assert len(texts.message) <= LONGEST_MESSAGE
    assert "{" not in texts.message


@pytest.mark.parametrize(("kind", "variant"), VARIANTS)
def test_a_long_value_is_cut_and_a_missing_one_is_a_dash(kind, variant):
    long = {name: value * 40 if isinstance(value, str) else value for name, value in VALUES.items()}
    texts = build_alarm_texts(kind, "B", long | evidence_of(variant), 349.5)
    assert len(texts.headline) <= LONGEST_HEADLINE
    assert len(texts.message) <= LONGEST_MESSAGE
    assert texts.message.endswith(texts.action)
    without = build_alarm_texts(kind, "B", evidence_of(variant), 349.5)
    assert "{" not in without.message
    assert "None" not in without.message


@pytest.mark.parametrize(
    ("kind", "evidence", "message"),
    [
        (
            "wall_change",
            {"diagnosis": "wall"},
            (
                "B: signal change, probable wall thinning (model: 97 %). Control chart 72.0, limit 61.0 "
                "(hour "
                "55.5). Inspect the wall at B."
            ),
        ),
        (
            "wall_change",
            {"mewma_statistic": None, "distance_squared": 61.9, "limit": 24.3},
            (
                "B: signal change, cause undetermined. Distance squared 61.9, limit 24.3 (hour 55.5). "
                "Compare "
                "with the control position, then inspect the wall."
            ),
        ),
        (
            "wall_change",
            {"diagnosis": "wall", "raised_by": "diagnosis", "mewma_statistic": 6.69},
            (
                "B: signal change, probable wall thinning (model: 97 %). In two consecutive sets; control "
                "chart 6.69, limit 61.0 (hour 55.5). Inspect the wall at B."
            ),
        ),
        (
            "thickness_low",
            {},
            (
                "B: wall thickness 4.57 mm, limit 5.71 mm. 95 % interval 3.84 to 5.30 mm (hour 55.5). "
                "Check the echo or the waveform, then inspect the wall at B."
            ),
        ),
        (
            "data_corrupt",
            {"damaged": {}, "set_aside": ["a", "b"]},
            (
                "2 data files corrupt or missing. First: a (hour 55.5). Run `solimon verify`, check the "
                "disk, "
                "restore from a backup."
            ),
        ),
        (
            "disk_space",
            {},
            (
                "Disk 8.02 % free, recording stops at 5.00 %. 7.99 GB free (hour 55.5). Free disk space; "
                "delete "
                "nothing in the data folder."
            ),
        ),
    ],
)
def test_messages(kind, evidence, message):
    assert build_alarm_texts(kind, "B", VALUES | evidence, 55.5).message == message


def test_a_stored_message_is_shown_and_an_unknown_kind_has_its_name():
    row = alarm_row("B", "some_new_kind", message="as stored")
    texts = describe_alarm(row)
    assert (texts.headline, texts.message, texts.action) == ("some new kind", "as stored", "")


@pytest.mark.parametrize(
    ("probability", "text"),
    [
        (0.978, "97 %"),
        (0.99, "99 %"),
        (0.9901, "> 99 %"),
        (1.0, "> 99 %"),
        (0.009, "< 1 %"),
    ],
)
def test_a_probability_is_rounded_down(probability, text):
    assert format_probability(probability) == text


@pytest.mark.parametrize(
    ("value", "text"), [(72.04, "72.0"), (118.2, "118"), (999.6, "1000"), (12345.0, "12345"), (0.0, "0.00")]
)
def test_a_number_has_three_significant_digits(value, text):
    assert format_number(value) == text
