"""Warnings about a shot name value, limit and remedy; `--strict` makes them errors."""

import json
import re
from dataclasses import replace

import pytest
from support.command_line import solimon_here

from daq_service.cli.sweep.shot import RESULTS, compute_rows
from daq_service.cli.sweep.shot_warnings import find_shot_warnings, summarise_warnings
from daq_service.settings.file import find_config_file
from daq_service.settings.tree import PositionSettings
from simulator.chain.contact_pressure import peak_pressures_pa, yield_pressures_pa
from simulator.parameters.chain import ChainParameters, SphereParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.shot.model import ShotModel

CHAIN = ChainParameters()
SOUND = {
    "amplitude_ratio": 0.5,
    "dynamic_amplitude_ratio": 0.49,
    "plate_pressure_pa": 1.87e9,
    "plate_yield_ratio": 0.99,
    "sphere_pressure_pa": 2.84e9,
    "sphere_yield_ratio": 0.99,
}
LONG_S = 1.2e-3
ANALYTIC = ("SOLIMON_PLATE__MODEL", "infinite_kirchhoff")
STRONG = ("SOLIMON_PLATE__YIELD_STRENGTH_PA", "2e9")


def simulate(*arguments, env=(ANALYTIC,)):
    return solimon_here("simulate", *arguments, env=dict(env))


@pytest.mark.parametrize(
    ("chain", "changes", "after_trigger_s", "words"),
    [
        (
            CHAIN,
            {"plate_yield_ratio": 4.67},
            LONG_S,
            "at the plate is 1.87 GPa, 4.67 times that of first yield",
        ),
        (
            CHAIN,
            {"sphere_yield_ratio": 1.01},
            LONG_S,
            "in the chain is 2.84 GPa, 1.01 times that of first yield",
        ),
        (CHAIN, {}, 300e-6, "the record lasts 300 us after its trigger, below 509 us"),
        (CHAIN, {"dynamic_amplitude_ratio": 0.19}, LONG_S, "the amplitude ratio is 0.19, below 0.2"),
        (replace(CHAIN, spheres_below=1), {}, LONG_S, "after 1.6 of its widths, below 2.5: they overlap"),
        (replace(CHAIN, spheres_below=0, sensor="sphere"), {}, LONG_S, "after 0.5 of its widths"),
    ],
)
def test_each_obstacle_is_one_warning_with_its_numbers(chain, changes, after_trigger_s, words):
    (text,) = find_shot_warnings(chain, SOUND | changes, after_trigger_s)
    assert words in text


@pytest.mark.parametrize("missing", [None, float("nan")])
def test_a_sound_shot_and_one_without_reflection_have_no_warning(missing):
    assert find_shot_warnings(CHAIN, SOUND, LONG_S) == []
    no_wave = SOUND | {"amplitude_ratio": missing, "dynamic_amplitude_ratio": missing}
    assert find_shot_warnings(CHAIN, no_wave, LONG_S) == []


def test_keys_of_the_position_count_for_its_own_chain():
    place = PositionSettings(method="solitary_wave", waves={"isw_fwhm_s": 129.4e-6})
    (text,) = find_shot_warnings(CHAIN, SOUND, 900e-6, place)
    assert "below 1019 us" in text
    assert find_shot_warnings(replace(CHAIN, drop_height_m=6e-3), SOUND, 900e-6, place) == []


@pytest.mark.parametrize(
    ("arguments", "count"), [((), ""), (("--sweep", "chain.drop_height_m=0.005,0.006"), "1 of 2 shots; ")]
)
def test_keys_of_the_position_count_in_simulated_shots(arguments, count, tmp_path):
    config = tmp_path / "wide.toml"
    wide = "[positions.B.waves]\nisw_fwhm_s = 2e-4\n"
    config.write_text(find_config_file("simulated.toml").read_text(encoding="utf-8") + wide, encoding="utf-8")
    shown = simulate(str(config), "--position", "B", *arguments).stderr
    assert re.search(f"WARNING: {count}.*the record lasts .* below 1575 us", shown)


def test_warnings_of_many_shots_are_counted_by_kind():
    assert summarise_warnings([["a is 3.1", "b is 2"]]) == ["a is 3.1", "b is 2"]
    counted = summarise_warnings([["a is 3.1"], ["a is 44.5", "b is 2"], []])
    assert counted == ["2 of 3 shots; in the first, a is 3.1", "1 of 3 shots; in the first, b is 2"]


def test_a_row_holds_the_pressures_and_both_ratios_of_its_shot():
    soft = SphereParameters(body=6, radius_m=6e-3, youngs_modulus_pa=110e9, yield_strength_pa=8e8)
    specimen = (replace(CHAIN, spheres=(soft,)), PlateParameters(elements_per_edge=16), CorrosionParameters())
    (outcome,) = compute_rows("coupled", [(0, specimen)])
    row = dict(zip(RESULTS["coupled"], outcome.numbers, strict=True))
    force = ShotModel(*specimen).shot(contact_forces=True)
    pressures_pa = peak_pressures_pa(*specimen[:2], force.contact_force_n)
    ratios = pressures_pa / yield_pressures_pa(*specimen[:2])
    assert row["plate_pressure_pa"] == pressures_pa[8]
    assert row["sphere_pressure_pa"] == max(pressures_pa[:8]) == pressures_pa[0], "the striker's is largest"
    assert row["plate_yield_ratio"] == ratios[8]
    assert row["sphere_yield_ratio"] == max(ratios[:8]) == max(ratios[5:7]), "the soft sphere yields first"
    dynamic = (row["psw_peak_n"] - row["preload_n"]) / (row["isw_peak_n"] - row["preload_n"])
    assert row["dynamic_amplitude_ratio"] == pytest.approx(dynamic, rel=1e-12)
    assert row["dynamic_amplitude_ratio"] < row["amplitude_ratio"]


@pytest.mark.parametrize(
    "arguments", [(), ("--json",), ("--depths", "0:0:2"), ("--sweep", "chain.tilt_rad=0,0.01")]
)
def test_strict_prints_the_results_and_then_fails(arguments):
    lenient, strict = simulate(*arguments), simulate(*arguments, "--strict")
    assert (lenient.returncode, strict.returncode) == (0, 2)
    assert strict.stdout == lenient.stdout != ""
    assert "GPa" in strict.stderr
    assert ("WARNING" in lenient.stderr) == ("--json" not in arguments)
    sound = simulate(*arguments, "--strict", env=(ANALYTIC, STRONG))
    assert sound.returncode == 0
    assert "WARNING" not in sound.stderr


def test_the_json_of_shots_and_sweeps_holds_the_warnings():
    alone = json.loads(simulate("--json").stdout)
    assert len(alone["warnings"]) == 1
    table = json.loads(simulate("--json", "--depths", "0:0:2").stdout)
    assert [shot["warnings"] for shot in table["shots"]] == [alone["warnings"]] * 2
    swept = json.loads(simulate("--json", "--sweep", "chain.drop_height_m=0.005,0.02").stdout)
    plate, spheres = swept["warnings"]
    assert plate == f"2 of 2 shots; in the first, {alone['warnings'][0]}"
    assert spheres.startswith("1 of 2 shots; in the first, the peak pressure in the chain is 3.7")


def test_a_short_record_of_the_twin_is_a_warning():
    short = (ANALYTIC, STRONG, ("SOLIMON_TWIN__ADC__RECORD_SAMPLES", "1300"))
    assert "the record lasts 30 us after its trigger" in simulate(env=short).stderr
