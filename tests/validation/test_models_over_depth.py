"""The committed table of every model over depth is what the models give.

`benchmarks/models_over_depth.py --write` renews it, and shows next to each number what a finer mesh and step
change. A number may differ by one in its last printed digit: rounding of another machine, not physics.
"""

import csv
from pathlib import Path

import pytest
from support.benchmark_modules import benchmark_module

from simulator.parameters.chain import ChainParameters

ROOT = Path(__file__).parents[2]
TABLE = ROOT / "docs" / "reference" / "models-over-depth.csv"
LAST_DIGIT_US, LAST_DIGIT_RATIO = 1.5e-3, 1.5e-5


@pytest.fixture(scope="module")
def benchmark():
    return benchmark_module("models_over_depth")


def committed(model):
    with TABLE.open(encoding="utf-8", newline="") as file:
        return [row for row in csv.DictReader(file) if row["model"] == model]


def assert_given_by(benchmark, rows):
    for row in rows:
        model = benchmark.MODELS[row["model"]]
        size_m = benchmark.PATCHES_M.get(row["patch"])
        chain = ChainParameters(sensor=row["sensor"])
        depth = float(row["depth_fraction"])
        found = benchmark.tof_and_ratio_function(chain, model.plate, size_m, benchmark.STEP_S)(depth)
        names = "tof_us", "amplitude_ratio", "dynamic_amplitude_ratio"
        expected = [float(row[name]) for name in names]
        assert found[0] == pytest.approx(expected[0], abs=LAST_DIGIT_US, nan_ok=True), row
        assert found[1:] == pytest.approx(expected[1:], abs=LAST_DIGIT_RATIO, nan_ok=True), row


def test_the_table_has_every_model_patch_sensor_and_depth(benchmark):
    for name, model in benchmark.MODELS.items():
        patches = list(benchmark.PATCHES_M) if model.has_patch else ["whole plate"]
        depths = benchmark.DEPTHS[:1] if name == "rigid_wall" else benchmark.DEPTHS
        wanted = {(p, s, f"{d:.1f}") for p in patches for s in benchmark.SENSORS for d in depths}
        assert {(row["patch"], row["sensor"], row["depth_fraction"]) for row in committed(name)} == wanted
    assert len(committed(benchmark.ZENER)) == len(benchmark.DEPTHS)


@pytest.mark.parametrize("model", ["mindlin", "mindlin, patch contact", "infinite_kirchhoff", "rigid_wall"])
def test_the_numbers_are_the_models(benchmark, model):
    assert_given_by(benchmark, committed(model))


def test_zeners_numbers_are_the_models(benchmark):
    found = {f"{row.depth_fraction:.1f}": row for row in benchmark.zener_rows()}
    for row in committed(benchmark.ZENER):
        its = found[row["depth_fraction"]]
        assert its.tof_us == pytest.approx(float(row["tof_us"]), abs=LAST_DIGIT_US)
        assert its.amplitude_ratio == pytest.approx(float(row["amplitude_ratio"]), abs=LAST_DIGIT_RATIO)


def test_the_solids_numbers_are_the_models(benchmark):
    """A second a depth: three of its 36 rows."""
    assert_given_by(benchmark, committed("solid")[::14])


@pytest.mark.slow
def test_all_of_the_solids_numbers_are_the_models(benchmark):
    assert_given_by(benchmark, committed("solid"))


def test_refinement_changes_little(benchmark):
    """The mesh of the paper's model is its definition; the solid's is ours, and its edge is singular."""
    for model, limit_us in (("mindlin", 0.7), ("mindlin, patch contact", 0.7), ("solid", 0.3)):
        changes = [abs(float(row["tof_change_us"])) for row in committed(model)]
        assert max(changes) <= limit_us
        pristine = [abs(float(r["tof_change_us"])) for r in committed(model) if r["depth_fraction"] == "0.0"]
        assert max(pristine) <= 0.1
