"""Rules that the configuration sets for the assessment of a transducer."""

import pytest

from daq_service.assessment.baseline_lifecycle import get_baseline_range
from daq_service.assessment.rules import build_rules
from daq_service.settings.tree import Settings

HOURLY = {"phases": [{"until_h": 350.0, "interval_h": 1.0}]}


def rules(**alarms):
    settings = Settings(schedule=HOURLY, alarms=alarms)
    return build_rules(settings, baseline=get_baseline_range("B", settings, None), position="B")


def test_a_total_budget_is_shared_by_solitary_wave_transducers_alone():
    alone, shared = rules(false_alarms_per_sensor_year=0.1), rules(false_alarms_per_year=0.3)
    assert shared.false_alarms_per_sensor_year == pytest.approx(0.1)  # B, C and D
    assert shared.run_length == pytest.approx(alone.run_length)
    assert alone.run_length == pytest.approx(24.0 * 365.25 / 0.1)


def test_a_configuration_without_a_total_budget_keeps_its_hash():
    assert "false_alarms_per_year" not in Settings().measured()["alarms"]
    assert (
        Settings(alarms={"false_alarms_per_year": 1.0}).measured()["alarms"]["false_alarms_per_year"] == 1.0
    )
