"""Shots of the paper's chain on specimens with independently known answers."""

import math

import numpy as np
import pytest

from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.plate.mindlin.plate import build_plate
from simulator.plate.mindlin.reduction import reduce_plate
from simulator.shot.model import ENERGY_TOLERANCE, ShotModel
from simulator.shot.pulse_summary import summarise_pulses

PATCH = CorrosionParameters()
DEPTHS = (0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95)


@pytest.fixture(scope="module")
def paper(reduction_folder):
    return ShotModel(ChainParameters(), PlateParameters(), PATCH, cache_folder=reduction_folder)


@pytest.mark.parametrize(
    ("model", "sensor", "tof_us", "amplitude_ratio"),
    [
        ("rigid_wall", "sphere", 330.0, 0.909),
        ("rigid_wall", "disk", 316.9, 0.916),
        ("infinite_kirchhoff", "sphere", 348.7, 0.497),
        ("infinite_kirchhoff", "disk", 332.9, 0.505),
    ],
)
def test_rigid_wall_and_infinite_thin_plate(model, sensor, tof_us, amplitude_ratio):
    shot = ShotModel(ChainParameters(sensor=sensor), PlateParameters(model=model), PATCH).shot()
    found = summarise_pulses(shot)
    # Independent study, digits as given: half a unit of the last one.
    assert found.tof_us == pytest.approx(tof_us, abs=0.051)
    assert found.amplitude_ratio == pytest.approx(amplitude_ratio, abs=0.00051)


@pytest.mark.parametrize(("sensor", "peak_n", "time_us"), [("sphere", 133.6, 164.0), ("disk", 151.8, 159.5)])
@pytest.mark.parametrize("plate", ["rigid_wall", "infinite_kirchhoff", "mindlin"])
def test_isw_is_the_chains_own_on_any_plate(reduction_folder, plate, sensor, peak_n, time_us):
    model = ShotModel(
        ChainParameters(sensor=sensor), PlateParameters(model=plate), PATCH, cache_folder=reduction_folder
    )
    found = summarise_pulses(model.shot())
    assert found.isw_peak_n == pytest.approx(peak_n, abs=0.051)
    assert found.isw_time_us == pytest.approx(time_us, abs=0.051)


def test_tof_grows_and_amplitude_ratio_dips_with_depth(paper):
    found = [summarise_pulses(paper.shot(depth_fraction=d)) for d in (0.0, 0.2, 0.4, 0.6, 0.8)]
    tof = np.array([f.tof_us for f in found])
    assert np.all(np.diff(tof) > 0.0)
    assert np.all(np.diff(tof, 2) > 0.0)  # convex
    ratio = np.array([f.amplitude_ratio for f in found])
    assert 0 < np.argmin(ratio) < len(ratio) - 1  # the thinned patch rebounds: not monotonic


@pytest.mark.parametrize("depth", DEPTHS)
def test_energy_balances_at_every_depth(paper, depth):
    # A tenth of what is demanded: the paper's plate has no excuse.
    assert paper.shot(depth_fraction=depth).energy_residual <= 0.1 * ENERGY_TOLERANCE


def test_mesh_refined_twice_leaves_the_features(paper):
    """Same element at the contact (it defines the model), half the size everywhere else."""
    plate, depths = PlateParameters(elements_per_edge=192), (0.0, 0.6)
    reduced = reduce_plate(build_plate(plate, PATCH), basis=tuple((depth, 40) for depth in depths))
    fine = ShotModel(ChainParameters(), plate, PATCH, prepared_plate=reduced)
    for depth in depths:
        coarse_found, fine_found = (summarise_pulses(m.shot(depth_fraction=depth)) for m in (paper, fine))
        # Measured: below 0.1 us and 2e-3; a locking element would be off by whole microseconds.
        assert coarse_found.tof_us == pytest.approx(fine_found.tof_us, abs=0.2)
        assert coarse_found.amplitude_ratio == pytest.approx(fine_found.amplitude_ratio, rel=4e-3)


def test_tilt_scatters_the_amplitude_ratio_as_documented(paper):
    """1.0 +- 0.2 degrees: 2.5 % in the amplitude ratio, far less in the time of flight."""
    low, high = (summarise_pulses(paper.shot(tilt_rad=math.radians(t))) for t in (0.8, 1.2))
    scatter = (low.amplitude_ratio - high.amplitude_ratio) / (low.amplitude_ratio + high.amplitude_ratio)
    assert scatter == pytest.approx(0.025, abs=0.003)
    assert abs(high.tof_us - low.tof_us) / (high.tof_us + low.tof_us) < 0.001
