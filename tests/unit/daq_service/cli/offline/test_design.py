"""`solimon design`: candidates, information and simulated sets of arrays, limits, files, refusals."""

import json
import math
import re
from dataclasses import replace

import pytest
from click.testing import CliRunner

from daq_service.cli.main import cli
from daq_service.cli.offline.design import information
from daq_service.cli.offline.design.candidates import MATERIALS, USUAL_SWEEPS, list_chains, make_chain
from daq_service.cli.offline.design.command import compute_losses_m, load_site
from daq_service.cli.offline.design.information import confirm_design, predict_design, simulate_design
from daq_service.errors import UsageError
from daq_service.settings.file import load_settings
from simulator.errors import NoSolitaryWaveError
from simulator.parameters.chain import ChainParameters, SphereParameters

COARSE = """
[plate]
elements_per_edge = 32
contact_element_m = 1e-3
[positions.P]
method = "pulse_echo"
[positions.T]
method = "solitary_wave"
"""
BEST = make_chain(ChainParameters(precompression_n=50.0), material="steel", diameter_m=28.575e-3)
SWEEPS = (
    *("--sweep", "material=steel,tungsten carbide", "--sweep", "diameter_m=12.7e-3,28.575e-3"),
    *("--sweep", "precompression_n=0,50"),
)


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    path = tmp_path_factory.mktemp("design") / "coarse.toml"
    path.write_text(COARSE, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def site(config):
    return load_site(config, level="laboratory")


@pytest.fixture(scope="module")
def paper(site):
    return simulate_design(site, predict_design(site, "paper", ChainParameters()))


@pytest.fixture(scope="module")
def best(site):
    return simulate_design(site, predict_design(site, "best", BEST))


def design(*words):
    return CliRunner().invoke(cli, ["design", *map(str, words)])


def test_spheres_of_another_material_take_the_sensor_along():
    chain = make_chain(ChainParameters(), material="titanium", diameter_m=38.1e-3)
    density = MATERIALS["titanium"]["density_kg_per_m3"]
    assert chain.mass_kg == pytest.approx(density * math.pi / 6.0 * 38.1e-3**3, rel=1e-3)
    assert chain.sensor_mass_kg / chain.mass_kg == pytest.approx(26.9 / 28.2, rel=1e-3)
    assert chain.youngs_modulus_pa == 114e9
    assert make_chain(ChainParameters()) == ChainParameters()


def test_all_combinations_are_listed_by_what_differs():
    chains = list_chains(ChainParameters(), ["material=steel", "diameter_m=0.0254", "spheres_below=3,5"])
    assert list(chains) == ["steel 25.4 mm, spheres_below 3", "steel 25.4 mm, spheres_below 5"]
    assert [chain.spheres_below for chain in chains.values()] == [3, 5]
    usual = list_chains(ChainParameters(), [])
    assert len(usual) == math.prod(text.count(",") + 1 for text in USUAL_SWEEPS)
    assert len(set(usual.values())) == len(usual)


@pytest.mark.parametrize(
    ("sweep", "reason"),
    [
        ("material=gold", "no material 'gold'; there are steel"),
        ("drop_height_m=-1", "drop_height_m is -1; it must be"),
        ("colour=3", "--sweep colour is none of"),
        ("diameter_m", "KEY=value"),
    ],
)
def test_an_invalid_sweep_is_refused(sweep, reason):
    with pytest.raises(UsageError, match=reason):
        list_chains(ChainParameters(), [sweep])


def test_a_chain_of_different_spheres_is_refused():
    mixed = ChainParameters(spheres=(SphereParameters(body=1, radius_m=5e-3),))
    with pytest.raises(UsageError, match=r"chain\.spheres describes bodies that differ"):
        list_chains(mixed, [])


def test_pressed_spheres_of_4_plate_thicknesses_know_more_at_less_pressure(paper, best):
    assert paper.refused == best.refused == ()
    assert paper.inelasticity == pytest.approx(0.258, abs=0.001)
    assert best.pressure_pa < paper.pressure_pa
    assert best.distances[0] > 1.5 * paper.distances[0]
    for one in (paper, best):
        assert list(one.distances) == sorted(one.distances)


def test_simulated_sets_confirm_the_information(site, paper, best):
    first, second, pressed = (
        confirm_design(site, one, [seed]).confirmed for one, seed in ((paper, 31), (paper, 32), (best, 31))
    )
    for found, one in ((first, paper), (second, paper), (pressed, best)):
        assert found == pytest.approx(one.distances[:2], rel=0.4)  # linear, and 48 sets
    assert first != second
    assert pressed[0] > 1.2 * first[0]


def simulate_with(site, **changes):
    """Simulate the paper's array with other parameters of the twin; return d' at a loss of 5 %."""
    twin = replace(site.settings.twin, **changes)
    other = replace(site, settings=site.settings.model_copy(update={"twin": twin}))
    return simulate_design(other, predict_design(other, "", ChainParameters())).distances[0]


def test_each_scatter_and_electronic_noise_leave_less_information(site, paper):
    noise, scatter = site.settings.twin.noise, site.settings.twin.scatter
    noisy = simulate_with(site, noise=replace(noise, slow_rms_v=0.06))
    assert noisy < 0.9 * paper.distances[0]
    none = simulate_with(site, nuisance="none", scatter=replace(scatter, scale=0.0))
    only_drop = replace(scatter, set_tilt_sd_rad=0.0, shot_tilt_sd_rad=0.0)
    only_tilt = replace(scatter, set_drop_height_sd_fraction=0.0, shot_drop_height_sd_fraction=0.0)
    for one in (only_drop, only_tilt):
        assert simulate_with(site, nuisance="none", scatter=one) < 0.98 * none


def test_more_variability_and_no_shot_to_average_over_leave_less_information(config, site, paper):
    for level, is_less in (("none", False), ("plant", True)):
        other = load_site(config, "T", level=level)
        one = simulate_design(other, predict_design(other, "", ChainParameters()))
        assert (one.distances[0] < paper.distances[0]) is is_less
    schedule = site.settings.schedule.model_copy(update={"shots_per_set": 1})
    single = replace(site, settings=site.settings.model_copy(update={"schedule": schedule}))
    assert (
        simulate_design(single, predict_design(single, "", ChainParameters())).distances[0]
        < paper.distances[0]
    )


def test_simulated_sets_correct_the_losses(site, paper):
    sd_m, detectable_m = compute_losses_m(site, paper)
    halved = replace(paper, confirmed=tuple(0.5 * one for one in paper.distances[:2]))
    assert compute_losses_m(site, halved)[0] == pytest.approx(2.0 * sd_m)
    assert compute_losses_m(site, halved)[1] > 1.5 * detectable_m


def test_record_and_gain_fit_the_waves(paper, best):
    for one in (paper, best):
        isw_v = one.twin.sensor.sensitivity_v_per_n
        assert one.twin.adc.record_samples >= 13_600
        assert 0.0 < isw_v < 0.03
    assert paper.twin.sensor.sensitivity_v_per_n == pytest.approx(0.0197, rel=0.03)  # 2.5 V of 150 N
    assert best.twin.sensor.sensitivity_v_per_n < 0.5 * paper.twin.sensor.sensitivity_v_per_n
    assert best.twin.adc.pretrigger_samples == pytest.approx(
        1.5 * paper.twin.adc.pretrigger_samples, rel=0.05
    )


@pytest.mark.parametrize(
    ("keys", "reason"),
    [
        ({"diameter_m": 38.1e-3}, r"Zener's inelasticity is 1\.\d+, above 0\.7"),
        ({"material": "ptfe"}, r"\d+ of 175 simulated shots are not valid \(disturbed.*\), at most 2 %"),
        ({"precompression_n": 400.0}, r"precompression is 2\.\d times the incident wave's force, above 2"),
        ({"spheres_below": 1}, "overlap"),
    ],
)
def test_an_array_outside_the_limits_is_refused_with_the_number(site, keys, reason):
    chain = make_chain(ChainParameters(), **({"material": "steel"} | keys))
    refused = simulate_design(site, predict_design(site, "", chain)).refused
    assert any(re.search(reason, text) for text in refused), refused


def test_the_table_ranks_arrays_writes_the_best_and_lists_refusals(config, tmp_path):
    out, figure = tmp_path / "best.toml", tmp_path / "arrays.svg"
    files = ("--out", out, "--figure", figure)
    done = design(config, *SWEEPS, "--confirm", 1, "--seeds", 1, "--simulate", 7, *files)
    assert done.exit_code == 0, done.output
    head, estimand, columns, *lines = done.stdout.splitlines()
    assert "6.35 mm" in head
    assert "level laboratory" in head
    assert estimand.startswith("1 arrays of less change by the law are not simulated")
    assert columns.split()[:4] == ["array", "GPa", "yield", "lambda"]
    assert lines[0].startswith("configured")
    assert lines[1].startswith("steel 28.57 mm, precompression_n 50")
    # Behind numbers of the waves and the information: d' of simulated sets, and two losses in mm.
    assert [cell.count(".") for cell in lines[1].split()[-4:]] == [1, 1, 1, 1]
    assert "array 7 of 7" in done.stderr
    refused = [line for line in lines if ": refused, " in line]
    assert any(
        "tungsten carbide 12.7 mm" in line and "peak pressure at the plate 3" in line for line in refused
    )
    settings = load_settings(out)
    assert settings.positions["T"].chain == replace(BEST, radius_m=14.2875e-3)
    assert settings.positions["T"].plate.elements_per_edge == 32
    assert settings.twin.adc.pretrigger_samples > 1_000
    assert figure.read_bytes().startswith(b"<?xml")


def test_the_json_has_every_number_and_no_infinity(config):
    done = design(config, *SWEEPS, "--confirm", 0, "--json", "--max-pressure-pa", 1e9)
    answer = json.loads(done.stdout)
    assert answer["largest_pressure_pa"] == 1e9
    assert answer["not_simulated"] == []
    assert len(answer["designs"]) == 9
    first = answer["designs"][0]
    assert first["name"] == "configured"
    assert first["loss_sd_m"] == pytest.approx(answer_loss_m() / first["distances"][1])
    assert first["detectable_loss_m"] > first["loss_sd_m"]
    assert all(any("above 1 GPa" in text for text in one["refused"]) for one in answer["designs"][1:5])


def test_the_law_chooses_what_is_simulated_and_usable_arrays_come_first(config):
    bound = ("--max-pressure-pa", 1.75e9)  # below that of the pressed steel spheres
    done = design(config, *SWEEPS, "--confirm", 0, "--json", "--simulate", 3, *bound)
    answer = json.loads(done.stdout)
    _, usable, *refused = answer["designs"]
    assert usable["name"] == "steel 28.57 mm"
    assert usable["refused"] == []
    assert "steel 28.57 mm, precompression_n 50" in [one["name"] for one in refused]
    assert max(one["distances"][1] for one in refused) > usable["distances"][1]
    assert any(one["name"].startswith("tungsten carbide 12.7 mm") for one in refused)
    assert all(name.startswith("tungsten carbide 28.57 mm") for name in answer["not_simulated"][-2:])


def test_a_configured_array_without_a_wave_needs_a_bound(config, monkeypatch):
    def fail(force):
        raise NoSolitaryWaveError("no incident wave")

    monkeypatch.setattr(information, "summarise_pulses", fail)
    done = design(config, "--sweep", "material=steel")
    assert "configured array: no incident wave. Give --max-pressure-pa" in str(done.exception)


def answer_loss_m():
    """Return 10 % of the paper's wall: its patch covers the disc of the estimand."""
    return 0.1 * 6.35e-3


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("--position", "P"), "--position 'P' is none of the transducers T"),
        (("--figure", "x.pdf"), "ends in .svg or .png"),
        (("--thickness-m", "6.35"), "thickness_m"),
        (("--patch-m", "0.7"), "patch"),
        (
            (*SWEEPS[:2], "--max-pressure-pa", "1e8", "--confirm", "0", "--out", "x.toml"),
            "no array is within",
        ),
    ],
)
def test_invalid_options_are_refused(config, tmp_path, monkeypatch, words, reason):
    monkeypatch.chdir(tmp_path)
    done = design(config, *words)
    assert done.exit_code != 0
    assert re.search(reason, f"{done.exception}{done.output}"), done.output
    assert list(tmp_path.iterdir()) == []
