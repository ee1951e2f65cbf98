"""Every measuring method has an entry that the recording line and its views can use."""

from typing import get_args

import pytest

from daq_service.assessment.methods import METHODS
from daq_service.catalogue.rows import list_columns
from daq_service.settings.tree import ScheduleSettings
from hardware_drivers.measurement import PulseEchoRecord, Shot
from hardware_drivers.methods import Method


def test_each_method_has_an_entry_and_each_record_its_method():
    assert set(METHODS) == set(get_args(Method)) == {Shot.method, PulseEchoRecord.method}


@pytest.mark.parametrize("name", METHODS)
def test_every_row_has_the_fields_that_views_use(name):
    columns = [column.name for column in list_columns(METHODS[name].row)]
    assert {"set_index", "position", "sequence", "due_h", "quality", "extractor_version"} <= set(columns)
    assert METHODS[name].value_names
    assert set(METHODS[name].value_names) <= set(columns)


def test_a_set_has_one_echo_and_the_configured_number_of_strikes():
    schedule = ScheduleSettings(shots_per_set=7)
    assert {name: method.records_planned(schedule) for name, method in METHODS.items()} == {
        "solitary_wave": 7,
        "pulse_echo": 1,
    }
