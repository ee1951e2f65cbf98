"""Wiring that cannot be meant is refused while the file is read."""

import dataclasses

import pytest
from pydantic import TypeAdapter, ValidationError

from hardware_drivers.niscope.parameters import NiscopeParameters, ProbeWiring

PROBE = ProbeWiring(resource="PXI1Slot4", serial_number="01A2B3C4")


def test_a_table_of_a_file_becomes_parameters():
    table = {"averages": 8, "probes": {"A": {"resource": "PXI1Slot4", "input_impedance_ohm": 1_000_000}}}
    parameters = TypeAdapter(NiscopeParameters).validate_python(table)
    assert parameters.probes["A"].input_impedance_ohm == 1_000_000
    assert (parameters.averages, parameters.sample_rate_hz) == (8, 100e6)


@pytest.mark.parametrize(
    ("table", "named"),
    [
        ({"probes": {}}, "probes is empty"),
        ({"probes": {"A": {"resource": " "}}}, "resource is empty"),
        ({"probes": {"A": {"resource": "Dev1", "channel": ""}}}, "channel is empty"),
        ({"probes": {"A": {"resource": "Dev1", "range_v": 0.0}}}, "range_v"),
        ({"probes": {"A": {"resource": "Dev1", "gain": 3.0}}}, "gain"),
        ({"probes": {"A": {"resource": "Dev1", "input_impedance_ohm": 75}}}, "input_impedance_ohm"),
        ({"probes": {"A": {"resource": "Dev1", "other_resources": ["Dev2"]}}}, "serial_number is empty"),
        ({"probes": {"A": {"resource": "Dev1"}}, "averages": 0}, "averages"),
        ({"probes": {"A": {"resource": "Dev1"}}, "averages": 32_769}, "averages"),
        ({"probes": {"A": {"resource": "Dev1"}}, "record_samples": 8}, "record_samples"),
    ],
)
def test_an_implausible_value_is_refused_by_name(table, named):
    with pytest.raises(ValidationError, match=named):
        TypeAdapter(NiscopeParameters).validate_python(table)


def test_two_probes_may_share_a_board_but_no_input():
    other = dataclasses.replace(PROBE, channel="1")
    assert len(NiscopeParameters(probes={"A": PROBE, "E": other}).probes) == 2
    with pytest.raises(ValueError, match="'A' and 'E' are both on channel 0"):
        NiscopeParameters(probes={"A": PROBE, "E": PROBE})


def test_two_probes_on_a_board_agree_on_its_serial_number():
    other = dataclasses.replace(PROBE, channel="1", serial_number="0BADCAFE")
    with pytest.raises(ValueError, match="the same serial_number"):
        NiscopeParameters(probes={"A": PROBE, "E": other})


def test_python_callers_meet_the_same_bounds():
    with pytest.raises(ValueError, match=r"firing_delay_s is -1\.0; it must be at least 0\.0"):
        dataclasses.replace(PROBE, firing_delay_s=-1.0)
