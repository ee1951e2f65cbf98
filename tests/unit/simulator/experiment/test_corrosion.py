"""Depth over time: slow, monotone, uneven by the seed, and the hole when it is due."""

from dataclasses import replace

import numpy as np
import pytest

from simulator.errors import SpecimenError
from simulator.experiment.corrosion import divide_into_pits, draw_wall_history, make_patch, round_down_hour_h
from simulator.parameters.chain import ChainParameters
from simulator.parameters.experiment import PAPER_THINNING, ThinningParameters, TwinParameters
from simulator.parameters.plate import DEEPEST_PATCH_FRACTION, CorrosionParameters, PlateParameters
from simulator.shot.model import ShotModel

HOURS = np.arange(0.0, 350.0, 0.5)
NS_PER_S = 1_000_000_000


def depths(thinning, seed=1, position="B", hours=HOURS):
    history = draw_wall_history(thinning, seed=seed, position=position)
    return np.array([history.at(float(hour)).depth_fraction for hour in hours])


@pytest.mark.parametrize("position", ["A", "B", "C", "D"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_wall_never_grows_back_and_keeps_to_its_plan(position, seed):
    thinning = PAPER_THINNING[position]
    depth = depths(thinning, seed, position)
    assert np.all(np.diff(depth) >= 0.0)
    assert np.all(depth[thinning.onset_h >= HOURS] == 0.0)
    history = draw_wall_history(thinning, seed=seed, position=position)
    # Rounding: the wobble's terms cancel at the reference hour but for a few ulp.
    assert history.at(thinning.reference_h).depth_fraction == pytest.approx(
        thinning.depth_fraction, rel=1e-12
    )


def test_position_a_follows_figure_15():
    history = draw_wall_history(PAPER_THINNING["A"], seed=1, position="A")
    # The core taken at the end; the probe reads more.
    assert 6.35e-3 * (1.0 - history.at(350.0).depth_fraction) == pytest.approx(3.8e-3, rel=1e-12)
    assert history.at(175.0).depth_fraction == pytest.approx(
        0.5 * history.at(350.0).depth_fraction, rel=1e-12
    )


def test_unevenness_is_seeded_per_position_and_bounded():
    thinning = PAPER_THINNING["B"]
    even = depths(replace(thinning, unevenness=0.0))
    uneven = depths(thinning)
    assert np.array_equal(uneven, depths(thinning))
    assert np.max(np.abs(uneven - depths(thinning, seed=2))) > 1e-3
    assert np.max(np.abs(uneven - depths(thinning, position="C"))) > 1e-3
    assert np.max(np.abs(uneven - even)) > 1e-3
    after = HOURS[:-1] > thinning.onset_h
    rate = np.diff(uneven)[after] / np.diff(even)[after]
    # The rate itself keeps within 1 +- unevenness; 1e-9 is the rounding of two nearly equal depths.
    assert rate.min() >= 1.0 - thinning.unevenness - 1e-9
    assert rate.max() <= 1.0 + thinning.unevenness + 1e-9


@pytest.mark.parametrize(("position", "hole_h"), [("B", 270.0), ("C", 347.0)])
@pytest.mark.parametrize("seed", range(1, 12))
def test_the_hole_comes_when_it_is_due_and_not_an_interval_earlier(position, hole_h, seed):
    history = draw_wall_history(PAPER_THINNING[position], seed=seed, position=position)
    pits = np.array([history.at(float(hour)).pit_depth_fraction for hour in HOURS])
    assert np.all(np.diff(pits) >= 0.0)
    assert np.all(pits >= depths(PAPER_THINNING[position], seed, position))
    assert not history.at(hole_h - 1.0 / 6.0).is_hole
    assert history.at(hole_h).is_hole
    assert history.at(hole_h).depth_fraction < 0.6 < history.at(hole_h).pit_depth_fraction


def test_a_position_without_hole_hour_ends_at_the_deepest_patch():
    history = draw_wall_history(
        ThinningParameters(reference_h=100.0, depth_fraction=0.9), seed=1, position="B"
    )
    assert history.at(1e5).depth_fraction == DEEPEST_PATCH_FRACTION
    assert history.at(90.0).pit_depth_fraction == history.at(90.0).depth_fraction


def test_a_table_of_depths_replaces_the_law():
    thinning = ThinningParameters(history=((10.0, 0.1), (20.0, 0.1), (40.0, 0.5), (41.0, 0.95)))
    hours = (-5.0, 0.0, 10.0, 15.0, 20.0, 30.0, 40.5, 41.0, 1e4)
    expected = [0.1, 0.1, 0.1, 0.1, 0.1, 0.3, 0.725, 0.95, 0.95]
    np.testing.assert_allclose(depths(thinning, hours=hours), expected, rtol=1e-14)  # rounding
    # For any seed and position: nothing is drawn.
    assert np.array_equal(depths(thinning, seed=7, position="C"), depths(thinning))
    history = draw_wall_history(thinning, seed=1, position="B")
    assert not history.at(40.9).is_hole
    assert history.at(41.0).is_hole


def test_a_pit_grows_in_addition_to_a_table_of_depths():
    thinning = ThinningParameters(history=((0.0, 0.0), (100.0, 0.2)), hole_h=90.0)
    history = draw_wall_history(thinning, seed=1, position="B")
    assert history.at(45.0).pit_depth_fraction == pytest.approx(0.475, rel=1e-12)
    assert history.at(90.0).is_hole
    assert history.at(90.0).depth_fraction == pytest.approx(0.18, rel=1e-12)


@pytest.mark.parametrize(
    ("elapsed_s", "hour_h"),
    [(0.0, 0.0), (599.9, 0.0), (600.0, 1 / 6), (1800.0, 0.5), (1920.0, 0.5), (-1.0, -1 / 6)],
)
def test_a_set_has_one_hour(elapsed_s, hour_h):
    # A few ulp: seconds become hours by one division.
    assert round_down_hour_h(round(elapsed_s * NS_PER_S), 600.0) == pytest.approx(hour_h, rel=1e-15)


# ---- pits

PITTED = replace(PAPER_THINNING["B"], pits_per_edge=5)


def test_pits_have_a_spectrum_and_the_deepest_under_the_chain_goes_through_in_time():
    for seed in range(1, 6):
        history = draw_wall_history(PITTED, seed=seed, position="B")
        flat = draw_wall_history(PAPER_THINNING["B"], seed=seed, position="B")
        assert history.pits.shape == (5, 5)
        assert history.pits[2, 2] == history.pits.max() == 1.0
        assert np.unique(history.pits).size > 15
        walls = [history.at(hour) for hour in (0.0, 100.0, 200.0, 269.99, 270.0)]
        assert [wall.depth_fraction for wall in walls] == [
            flat.at(hour).depth_fraction for hour in (0.0, 100.0, 200.0, 269.99, 270.0)
        ]
        for wall in walls[1:4]:
            # The mean over the pits is that of the law; brentq finds the spectrum to 2e-12.
            mean = wall.patch_depth_fraction * history.pits.mean()
            assert mean == pytest.approx(wall.depth_fraction, rel=1e-9)
        assert [wall.is_hole for wall in walls] == [False] * 4 + [True]
    assert not np.array_equal(history.pits, draw_wall_history(PITTED, seed=1, position="B").pits)
    assert not np.array_equal(history.pits, draw_wall_history(PITTED, seed=5, position="C").pits)


def test_without_an_hour_of_the_hole_the_deepest_pit_sets_it():
    thinning = ThinningParameters(depth_fraction=0.6, reference_h=100.0, pits_per_edge=3)
    history = draw_wall_history(thinning, seed=1, position="B")
    through_h = 100.0 * DEEPEST_PATCH_FRACTION * history.pits.mean() / 0.6
    assert not history.at(0.999 * through_h).is_hole
    assert history.at(1.001 * through_h).is_hole


def test_a_mosaic_is_the_patch_divided_and_rougher_the_deeper():
    history = draw_wall_history(PITTED, seed=1, position="B")
    whole = CorrosionParameters(size_m=25.4e-3, offset_x_m=1e-3)
    mosaic = divide_into_pits(whole, history)
    assert len(mosaic.patches) == 25
    assert sum(patch.size_m**2 for patch in mosaic.patches) == pytest.approx(whole.size_m**2, rel=1e-12)
    left = min(patch.offset_x_m - 0.5 * patch.size_m for patch in mosaic.patches)
    assert left == pytest.approx(1e-3 - 0.5 * whole.size_m, rel=1e-12)
    assert sorted(patch.depth_factor for patch in mosaic.patches) == sorted(history.pits.ravel().tolist())
    assert divide_into_pits(whole, draw_wall_history(PAPER_THINNING["B"], seed=1, position="B")) is whole


def test_one_reduction_serves_a_pitted_wall_s_life_and_reflects_as_one_reduced_at_its_depth():
    plate = PlateParameters(elements_per_edge=24, contact_element_m=1e-3)
    history = draw_wall_history(replace(PITTED, pits_per_edge=3), seed=1, position="B")
    mosaic = divide_into_pits(CorrosionParameters(), history)
    model = ShotModel(ChainParameters(), plate, mosaic, cache_folder=None)
    depth = history.at(150.0).patch_depth_fraction
    own = [replace(patch, depth_factor=depth * patch.depth_factor / 0.9) for patch in mosaic.patches]
    alone = replace(mosaic, depth_factor=own[0].depth_factor, further=tuple(own[1:]), depth_fraction=0.9)
    expected = ShotModel(ChainParameters(), plate, alone, cache_folder=None).shot().force_n
    found = model.shot(depth_fraction=depth).force_n
    # Both bases keep the waveform to 2e-5 of its norm (`reduced_against_unreduced`).
    assert np.linalg.norm(found - expected) < 1e-4 * np.linalg.norm(expected)
    flat = ShotModel(ChainParameters(), plate, CorrosionParameters(), cache_folder=None)
    smooth = flat.shot(depth_fraction=history.at(150.0).depth_fraction).force_n
    assert np.linalg.norm(found - smooth) > 3e-3 * np.linalg.norm(smooth)


@pytest.mark.parametrize(
    ("thinning", "corrosion", "message"),
    [
        (PITTED, CorrosionParameters(shape="round"), "pits_per_edge divides one flat square patch"),
        (PITTED, CorrosionParameters(profile="bowl"), "set shape = 'square'"),
        (
            replace(PITTED, depth_fraction=0.01),
            CorrosionParameters(),
            "the mean depth at B is 0.01 of the wall",
        ),
    ],
)
def test_a_patch_that_has_no_pits_is_refused(thinning, corrosion, message):
    with pytest.raises(SpecimenError, match=message):
        make_patch(TwinParameters(thinning={"B": thinning}), "B", corrosion)
