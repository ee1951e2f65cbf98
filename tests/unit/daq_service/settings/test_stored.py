"""A stored configuration has the meaning of the present one, or the different keys are named."""

import copy
import json

import pytest

from daq_service.settings import stored
from daq_service.settings.file import load_settings
from daq_service.settings.stored import SHOWN, list_settings_differences, rename_old_keys, restore_settings
from daq_service.settings.tree import NoveltySettings, Settings

NOW = Settings()


def stored_configuration():
    """Return what a folder of the present default test stores."""
    return NOW.model_dump(mode="json")


def test_a_stored_configuration_of_this_version_has_no_differences():
    assert list_settings_differences(stored_configuration(), NOW) == []


def test_a_key_that_came_later_counts_with_its_default():
    before = stored_configuration()
    del before["quality"], before["plate"]["contact"]
    for position in before["positions"].values():
        del position["plate"]["contact"]
    assert list_settings_differences(before, NOW) == []
    assert list_settings_differences(before, Settings(plate={"contact": "patch"})) == [
        'plate.contact started with "node", is "patch" now'
    ]


def test_a_key_that_came_later_with_a_new_way_counts_as_what_was_done_before():
    before = stored_configuration()
    del before["alarms"]["decides_by"]
    unchanged = copy.deepcopy(before)
    assert list_settings_differences(before, NOW) == [
        'alarms.decides_by started with "k_of_n", is "chart" now'
    ]
    by_sets = Settings(alarms={"decides_by": "k_of_n"})
    assert list_settings_differences(before, by_sets) == []
    assert restore_settings(before).configuration_hash() == by_sets.configuration_hash()
    assert "decides_by" not in by_sets.measured()["alarms"], "what was hashed before there was a choice"
    assert before == unchanged


def test_a_json_file_that_leaves_the_table_out_means_the_default(tmp_path):
    file = tmp_path / "mine.json"
    file.write_text(json.dumps({"schedule": {"shots_per_set": 9}}), encoding="utf-8")
    assert load_settings(file).alarms.decides_by == "chart"
    before = stored_configuration()
    del before["alarms"]["decides_by"]
    file.write_text(json.dumps(before), encoding="utf-8")
    assert load_settings(file).alarms.decides_by == "k_of_n"


def test_the_receivers_of_alarms_may_change_between_starts():
    duty = {"url": "http://127.0.0.1/", "secret_env": "DUTY_SECRET"}
    with_receivers = Settings(notifications={"receivers": {"duty": duty}, "rules": [{"receivers": ["duty"]}]})
    other = Settings(notifications={"receivers": {"night": duty}, "rules": [{"receivers": ["night"]}]})
    before = stored_configuration()
    del before["notifications"]
    for stored_, given in (
        (stored_configuration(), with_receivers),
        (before, with_receivers),
        (with_receivers.model_dump(mode="json"), other),
    ):
        assert list_settings_differences(stored_, given) == []
    assert list_settings_differences(with_receivers.model_dump(mode="json"), NOW) == []


def test_a_position_is_named_where_it_differs_from_the_table_above():
    given = Settings(positions={"B": {"method": "solitary_wave", "chain": {"drop_height_m": 5.1e-3}}})
    before = given.model_dump(mode="json")
    before["positions"]["B"]["chain"]["drop_height_m"] = 5e-3
    assert list_settings_differences(before, given) == [
        "positions.B.chain.drop_height_m started with 0.005, is 0.0051 now"
    ]


def test_a_changed_default_is_a_change_of_meaning():
    """The stored configuration has all values, so the default of its version is not lost."""
    before = stored_configuration()
    given = NOW.model_copy(update={"novelty": NoveltySettings(false_alarm_rate=0.01)})
    assert list_settings_differences(before, given) == [
        "novelty.false_alarm_rate started with 0.0027, is 0.01 now"
    ]


def test_the_environment_is_no_part_of_a_stored_configuration(monkeypatch):
    monkeypatch.setenv("SOLIMON_CHAIN__DROP_HEIGHT_M", "5.1e-3")
    assert list_settings_differences(stored_configuration(), NOW) == []
    assert list_settings_differences(stored_configuration(), Settings()) == [
        "chain.drop_height_m started with 0.005, is 0.0051 now"
    ]


def test_a_key_that_went_is_named_unless_nothing_measured_depended_on_it():
    before = stored_configuration()
    before["novelty"]["ghost"] = 3
    before["web"]["ghost"] = 4
    before["web"]["port"] = -1
    before["positions"]["B"]["plate"]["ghost"] = before["plate"]["ghost"] = [1, 2]
    assert list_settings_differences(before, NOW) == [
        "novelty.ghost started with 3; this version has no such key",
        "plate.ghost started with [1, 2]; this version has no such key",
    ]


def test_a_value_that_this_version_refuses_is_named():
    before = stored_configuration()
    before["alarms"]["k"] = 0
    (line,) = list_settings_differences(before, NOW)
    assert line.startswith("alarms.k Input should be greater than or equal to 1")


@pytest.mark.parametrize(("today", "measured"), [("positions.*.plate.contact", "node"), (None, None)])
def test_a_renamed_key_is_read_under_its_name_of_today(monkeypatch, today, measured):
    monkeypatch.setattr(stored, "RENAMED", {"positions.*.plate.touch": today})
    before = stored_configuration()
    for position in before["positions"].values():
        position["plate"]["touch"] = position["plate"].pop("contact")
    moved = rename_old_keys(before)
    assert all(position["plate"].get("contact") == measured for position in moved["positions"].values())
    assert list_settings_differences(before, NOW) == []


def test_the_timeout_of_the_supply_s_watchdog_is_read_under_its_earlier_name():
    before = {"rig": {"supply": {"unwatched_s": 60.0}, "drive": {"unwatched_s": 30.0}}}
    tables = rename_old_keys(before)["rig"]
    assert tables == {"supply": {"watchdog_timeout_s": 60.0}, "drive": {"watchdog_timeout_s": 30.0}}


def test_a_limit_is_read_under_its_earlier_name():
    assert restore_settings({"novelty": {"limit": "chart"}}).novelty.limit == "mewma"


def test_a_renamed_table_takes_its_keys_along(monkeypatch):
    monkeypatch.setattr(stored, "RENAMED", {"judgement": "novelty"})
    before = stored_configuration()
    before["judgement"] = {**before.pop("novelty"), "false_alarm_rate": 0.01}
    unchanged = copy.deepcopy(before)
    assert list_settings_differences(before, NOW) == [
        "novelty.false_alarm_rate started with 0.01, is 0.0027 now"
    ]
    assert before == unchanged


def test_a_long_list_of_differences_is_cut_with_its_length():
    *lines, last = list_settings_differences(
        stored_configuration(), Settings(positions={"Z": {"method": "pulse_echo"}})
    )
    assert len(lines) == SHOWN
    assert last.startswith("and ")
