import json

import pytest
from pydantic import ValidationError

from daq_service.errors import UsageError
from daq_service.settings.file import find_config_file, load_settings, validate_settings
from daq_service.settings.schema import build_settings_schema
from daq_service.settings.stored import list_settings_differences
from daq_service.settings.tree import Settings


def write(folder, text, name="test.toml"):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_the_shipped_file_spells_out_the_defaults():
    assert load_settings(find_config_file("simulated.toml")) == Settings()


def test_the_shipped_schema_is_current():
    shipped = json.loads(find_config_file("settings.schema.json").read_text(encoding="utf-8"))
    assert shipped == build_settings_schema(), "renew it by json.dumps(build_settings_schema(), indent=1)"


def test_every_key_is_described():
    schema = build_settings_schema()
    bare = [
        f"{section}.{key}"
        for section, table in schema["$defs"].items()
        for key, value in table.get("properties", {}).items()
        if "description" not in value
    ]
    assert bare == []


def test_a_position_inherits_the_common_tables_and_may_differ(tmp_path):
    path = write(
        tmp_path,
        """
        [chain]
        drop_height_m = 4e-3
        [positions.X]
        method = "solitary_wave"
        chain = { spheres_below = 6 }
        """,
    )
    chain = load_settings(path).positions["X"].chain
    assert (chain.drop_height_m, chain.spheres_below, chain.spheres_above) == (4e-3, 6, 4)


def test_spheres_that_differ_are_an_array_of_tables(tmp_path):
    path = write(
        tmp_path, "[[chain.spheres]]\nbody = 2\nlast_body = 3\nradius_m = 7e-3\n[[chain.spheres]]\nbody = 8\n"
    )
    pair, last = load_settings(path).chain.spheres
    assert (list(pair.bodies), pair.radius_m, pair.mass_kg, list(last.bodies)) == ([2, 3], 7e-3, None, [8])


@pytest.mark.parametrize(
    ("text", "fragments"),
    [
        ("[[chain.spheres]]\nbody = 1\nradius_m = 0.0", ["chain.spheres", "radius_m", "greater than 0"]),
        ("[[chain.spheres]]\nbody = 9", ["chain", "body 9", "bodies 0 to 8"]),
        ("[corrosion]\nsize_mm = 25.4", ["corrosion.size_mm", "unknown key", "size_m"]),
        ("[chain]\nmass_kg = -0.0282", ["chain.mass_kg", "-0.0282", "greater than 0"]),
        ("[chain]\nmass_kg = 28.2", ["chain", "density", "units"]),
        ('[chain]\ndrop_height_m = "5 mm"', ["chain.drop_height_m", "5 mm", "number"]),
        ("[chain]\ndrop_height_m = 5", ["chain.drop_height_m", "5", "less than or equal to 1"]),
        ("[plate]\nyoungs_modulus_pa = 200", ["plate.youngs_modulus_pa", "200", "100000"]),
        ("[corrosion]\ndepth_fraction = 0.96", ["corrosion.depth_fraction", "0.96", "0.95"]),
        ("[plate]\nelements_per_edge = 97", ["plate", "97", "even"]),
        ('[web]\nhost = "0.0.0.0"', ["web.host", "0.0.0.0"]),
        ("[web]\nport = 70000", ["web.port", "70000", "65535"]),
        ('[web]\nhost = "lab"', ["web.host", "'lab'", "give an IP address", "web.host_names"]),
        ('[web]\nhost = ""', ["web.host", "for example 127.0.0.1"]),
        ('[web]\nproxy = "proxy.example"', ["web.proxy", "'proxy.example'", "give an IP address"]),
        ('[web]\nhost_names = ["Lab!"]', ["web.host_names", "Lab!", "pattern"]),
        ('[web]\ntls_key = "k.pem"', ["web", "web.tls_certificate and web.tls_key belong together"]),
        ('[web]\nhost_names = ["lab.org"]', ['web.host_names is ["lab.org"]', "Set web.tls_certificate"]),
        (
            '[web]\nhost = "0.0.0.0"\nproxy = "10.0.0.2"',
            ["web", "web.host_names names no host"],
        ),
        ("[alarms]\nk = 6", ["alarms", "k is 6", "n = 5"]),
        ("[baseline]\nminimum_valid_shots = 11", ["minimum_valid_shots is 11", "shots_per_set = 10"]),
        ('[clock]\nepoch = "2024-01-01T00:00:00"', ["clock.epoch", "UTC offset"]),
        ('[positions."B/../x"]\nmethod = "solitary_wave"', ["positions", "letters and digits"]),
        ("[schedule]\nphases = [{until_h=5, interval_h=1}, {until_h=5, interval_h=1}]", ["until_h is 5"]),
        ("[chain", ["not valid toml"]),
    ],
)
def test_a_refusal_names_file_key_value_and_remedy(tmp_path, text, fragments):
    path = write(tmp_path, text)
    with pytest.raises(UsageError) as refusal:
        load_settings(path)
    for fragment in [str(path), *fragments]:
        assert fragment in str(refusal.value)
    assert refusal.value.exit_code == 2


def test_an_inherited_error_is_reported_once(tmp_path):
    with pytest.raises(UsageError) as refusal:
        load_settings(write(tmp_path, "[chain]\nmass_kg = -1"))
    assert str(refusal.value).count("mass_kg") == 1


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(UsageError, match=r"absent\.toml"):
        load_settings(tmp_path / "absent.toml")


def test_bytes_that_are_no_text_are_refused(tmp_path):
    path = tmp_path / "test.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(UsageError, match="UTF-8"):
        load_settings(path)


def test_the_environment_overrides_the_file(tmp_path, monkeypatch):
    monkeypatch.setenv("SOLIMON_TWIN__SEED", "42")
    settings = load_settings(write(tmp_path, "[twin]\nseed = 3\n[twin.scatter]\nscale = 2.0"))
    assert (settings.twin.seed, settings.twin.scatter.scale) == (42, 2.0)


def test_a_misspelt_variable_is_refused(monkeypatch):
    monkeypatch.setenv("SOLIMON_CHIAN__MASS_KG", "1")
    with pytest.raises(UsageError, match=r"SOLIMON_CHIAN__MASS_KG.*did you mean SOLIMON_CHAIN\?"):
        load_settings(None)


def test_a_written_configuration_is_read_back_as_the_same(tmp_path):
    settings = load_settings(None, overrides={"twin": {"seed": 9}, "schedule": {"end_h": 30.0}})
    path = write(tmp_path, settings.model_dump_json(), "configuration.json")
    assert load_settings(path) == settings


def test_the_hash_depends_only_on_settings_that_affect_the_data():
    same = load_settings(
        None,
        overrides={
            "web": {"port": 1},
            "clock": {"pace_h_per_s": 3.0},
            "schedule": {"end_h": 9.0},
            "storage": {"folder": "elsewhere"},
        },
    )
    assert same.configuration_hash() == Settings().configuration_hash()
    other = load_settings(None, overrides={"chain": {"drop_height_m": 5.1e-3}})
    assert other.configuration_hash() != Settings().configuration_hash()


def test_a_holdoff_is_part_of_the_hash_and_its_ringing_is_not():
    boards = {"transducers": {"B": {"board_serial": "01A2B3C4"}}}

    def settings_with(**changes):
        rig = {"kind": "daqmx", "daqmx": {**boards, **changes}}
        return Settings(rig=rig, positions={"B": {"method": "solitary_wave"}}, clock={"kind": "wall"})

    without, with_holdoff, with_ringing = (
        settings_with(**changes).configuration_hash()
        for changes in ({}, {"holdoff_s": 10e-3}, {"holdoff_s": 10e-3, "ringing_s": 5e-3})
    )
    assert without != with_holdoff == with_ringing


@pytest.mark.parametrize("position", ["Z", "A"])
def test_a_fault_of_a_position_that_strikes_nothing_is_refused(position):
    with pytest.raises(ValueError, match=rf"twin\.faults\.{position}.*no solitary_wave position"):
        Settings(twin={"faults": {position: {"missed": {"probability": 0.5}}}})


def test_sets_that_overlap_are_refused_with_the_numbers(tmp_path):
    schedule = "[schedule]\nshots_per_set = 10\nshot_interval_s = {interval}\n[[schedule.phases]]\n"
    phase = "until_h = 10.0\ninterval_h = 0.05\n"
    # 3 transducers, 10 strikes of each: 29 intervals, and 180 s from set to set.
    fits, fills, too_long = (
        schedule.format(interval=interval) + phase for interval in (0.99 * 180.0 / 29.0, 180.0 / 29.0, 6.25)
    )
    assert load_settings(write(tmp_path, fits)).schedule.shots_per_set == 10
    with pytest.raises(UsageError, match=r"sets overlap: 3 .* take 181.25 s. .* one due every 180 s"):
        load_settings(write(tmp_path, too_long))
    with pytest.raises(UsageError, match=r"take 180 s. .* one due every 180 s, of which 1% is left"):
        load_settings(write(tmp_path, fills))


@pytest.mark.parametrize(
    ("kinds", "message"),
    [
        (
            {"no_reflection": {"on_delay_s": 60.0}},
            r"'no_reflection' has neither delays nor .*these have: wall_change",
        ),
        (
            {"supply_not_responding": {"on_delay_s": 60.0}},
            r"supply_not_responding.on_delay_s is 60 s; .*at most 10 s",
        ),
        ({"few_valid_shots": {"off_delay_s": 1e5}}, r"few_valid_shots.off_delay_s: .*equal to 86400.*100000"),
        (
            {"few_valid_shots": {"dead_band_fraction": 0.1}},
            r"is 0.1; only .*: wall_change, transducer_change, thickness",
        ),
        (
            {"thickness_low": {"dead_band_m": 1e-4}},
            r"thickness_low.dead_band_m: unknown key; did you mean dead",
        ),
    ],
)
def test_delays_that_an_alarm_may_not_have_are_refused_with_value_and_remedy(kinds, message, tmp_path):
    with pytest.raises(UsageError, match=message):
        validate_settings({"alarms": {"kinds": kinds}}, tmp_path / "test.toml")


def test_alarm_delays_do_not_change_the_configuration_hash():
    """They may be changed during a test, as the measurements stay the same."""
    kinds = {"thickness_low": {"on_delay_s": 7200.0, "dead_band_fraction": 0.2}}
    settings = load_settings(None, overrides={"alarms": {"kinds": kinds}})
    assert settings.configuration_hash() == Settings().configuration_hash()
    stored = Settings().model_dump(mode="json")
    assert (
        list_settings_differences(stored, settings)
        == list_settings_differences(settings.model_dump(mode="json"), Settings())
        == []
    )


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("test.toml", "[storage]\njournal = false\nmemory_mb = 77\n"),
        ("test.json", '{"storage": {"journal": false, "memory_mb": 77}}'),
    ],
)
def test_a_file_with_the_key_storage_journal_loads_with_a_warning(tmp_path, caplog, name, text):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    assert load_settings(path).storage.memory_mb == 77
    assert "storage.journal is ignored" in caplog.text
    caplog.clear()
    path.write_text(text.replace("false", "true"), encoding="utf-8")
    assert "journal" not in load_settings(path).storage.model_dump()
    assert caplog.text == "", "what every folder of today holds"


@pytest.mark.parametrize(
    ("position", "problem"),
    [
        ({"method": "pulse_echo", "minimum_wall_m": 7e-3}, "minimum_wall_m = 0.007 must be below"),
        ({"method": "solitary_wave", "minimum_wall_m": 6.35e-3}, "plate.thickness_m = 0.00635"),
        (
            {
                "method": "solitary_wave",
                "calibration": {"calibrated_on": "2026-01-02", "due_on": "2026-01-01"},
            },
            "due_on = 2026-01-01 precedes",
        ),
    ],
)
def test_contradicting_limits_and_dates_are_rejected(position, problem):
    with pytest.raises(ValidationError, match=problem):
        Settings(positions={"P": position})
