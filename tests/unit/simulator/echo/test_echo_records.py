"""Records of an ultrasonic receiver: couplant, bubbles, temperature, clipping before the mean."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from hardware_drivers.measurement import ShotKey
from simulator.echo.records import draw_disturbance
from simulator.parameters.echo import EchoParameters
from simulator.parameters.electronics import NoiseParameters
from simulator.parameters.experiment import DriftParameters, ThinningParameters, TwinParameters
from simulator.specimen import build_specimen

SMOOTH = EchoParameters(
    element_separation_m=0.0, roughness_fraction=0.0, velocity_per_k=0.0, bubble_probability=0.0
)
STILL = DriftParameters(enabled=False)


def key(index=0):
    return ShotKey(position="A", set_index=index, shot_index=0)


def specimen(echo=SMOOTH, **changes):
    twin = TwinParameters(echo=echo, drift=STILL, **changes)
    return build_specimen(twin, transducers={}, probed_thickness_m={"A": 6.35e-3})


def test_the_truth_is_the_wall_under_the_beam():
    truth = specimen(EchoParameters()).echo(key(), 350.0).truth
    assert truth["thickness_m"] == pytest.approx(3.8e-3, rel=1e-12)  # the paper's core
    assert 2.5e-3 < truth["thickness_least_m"] < truth["thickness_m"]
    # .2 of the 2.55 mm lost, less what does not vary within the spot.
    assert 0.1e-3 < truth["roughness_rms_m"] < 0.6e-3
    assert truth["bubbles"] in (0.0, 1.0)
    assert set(specimen().echo(key(), 350.0).truth) == {"thickness_m", "travel_time_s", "temperature_c"}


def test_bubbles_are_intermittent_and_keyed():
    echo = replace(SMOOTH, bubble_probability=0.3, bubbles_per_beam=60.0, bubble_radius_m=5e-3)
    bubbly, calm = specimen(echo), specimen()
    drawn = [draw_disturbance(echo, seed=1, key=key(k))[1]["bubbles"] for k in range(400)]
    low, high = stats.binom.interval(1.0 - 1e-4, 400, 0.3)
    assert low <= sum(drawn) <= high
    assert set(drawn[:6]) == {0.0, 1.0}
    for k in range(6):
        assert bubbly.echo(key(k), 0.0).truth["bubbles"] == drawn[k]
        moved = bubbly.echo(key(k), 0.0).waveform.volts() - calm.echo(key(k), 0.0).waveform.volts()
        assert np.any(moved) == bool(drawn[k])  # noise and wall are the same
        assert not np.any(moved[:950])  # nothing before the wall


@pytest.mark.parametrize("bubble_probability", [0.0, 1.0])
def test_the_couplant_changes_the_gain_of_a_whole_record(bubble_probability):
    echo = replace(SMOOTH, coupling_sd_db=3.0, bubble_probability=bubble_probability)
    found = [draw_disturbance(echo, seed=1, key=key(k)) for k in range(300)]
    levels_db = [20.0 * np.log10(truth["coupling_gain"]) for _, truth in found]
    assert stats.kstest(levels_db, "norm", args=(0.0, 3.0)).pvalue > 1e-4
    quiet = NoiseParameters(enabled=False)
    furthest = int(np.argmax(np.abs(levels_db[:20])))
    noisy = specimen(echo).echo(key(furthest), 0.0)
    plain = specimen(noise=quiet).echo(key(furthest), 0.0).waveform.volts()
    assert abs(noisy.truth["coupling_gain"] - 1.0) > 0.1
    # Noise of the mean, 2.5 mV, five times; bubbles stay below it.
    np.testing.assert_allclose(noisy.waveform.volts(), noisy.truth["coupling_gain"] * plain, atol=12.5e-3)


def test_a_record_far_from_the_ends_is_not_clipped():
    echo = specimen().echo(key(), 0.0)
    assert echo.settings["clipped_records"] == 0.0
    assert not echo.waveform.clipped


def test_every_record_of_an_echo_beyond_the_range_clips():
    loud = specimen(replace(SMOOTH, back_wall_v=3.0)).echo(key(), 0.0)
    assert loud.settings["clipped_records"] == 16.0
    assert loud.waveform.clipped


def test_noise_clips_single_records_although_their_mean_shows_nothing():
    """The crest is at the last code: half of the records clip there, and their mean stays below it."""
    # A wall whose echo's crest falls on a sample: 6.785 mm are 2,300 ns.
    edge = replace(SMOOTH, back_wall_v=1.0, attenuation_db_per_m=0.0, noise_rms_v=0.02, averages=1_000)
    whole = build_specimen(
        TwinParameters(echo=edge, drift=STILL), transducers={}, probed_thickness_m={"A": 6.785e-3}
    ).echo(key(), 0.0)
    assert not whole.waveform.clipped
    # The two neighbours, 5 % lower, are 2.5 SD away and add .6 % of the other half each.
    low, high = stats.binom.interval(1.0 - 1e-4, 1_000, 0.5 + 0.5 * 2.0 * stats.norm.sf(2.5))
    assert low <= whole.settings["clipped_records"] <= high
    # Of noise cut off at its mean, 1 / sqrt(2 pi) SD are lost on the average; 1,000 records know that to
    # .6 / sqrt(1000) SD: four of those and a code.
    lost_v = 1.0 - whole.waveform.volts().max()
    assert lost_v == pytest.approx(0.02 / np.sqrt(2.0 * np.pi), abs=4.0 * 0.012 / np.sqrt(1_000) + 2.0**-13)


def test_a_mean_drawn_once_has_the_scatter_of_a_mean_drawn_record_by_record():
    thinning = {"A": ThinningParameters()}
    near = replace(SMOOTH, back_wall_v=0.88, noise_rms_v=0.02)
    by_record = specimen(near, thinning=thinning).echo(key(), 0.0)
    at_once = specimen(replace(near, back_wall_v=0.5), thinning=thinning).echo(key(), 0.0)
    scatter = [echo.waveform.volts()[:700].std() for echo in (by_record, at_once)]
    # Before the front wall there is noise alone: .02 / sqrt(16) V, known to 2.7 %; four of those.
    assert scatter == pytest.approx([5e-3, 5e-3], rel=0.11)


def test_the_truth_of_a_warm_wall_is_its_travel_time():
    echo = replace(SMOOTH, velocity_per_k=-1.8e-4)
    twin = TwinParameters(echo=echo, drift=DriftParameters(wander_sd_k=0.0, diurnal_amplitude_k=10.0))
    made = build_specimen(twin, transducers={}, probed_thickness_m={"A": 6.35e-3})
    truth = made.echo(key(), 15.0).truth
    assert truth["temperature_c"] == pytest.approx(31.0, rel=1e-12)
    thickness_m = truth["thickness_m"]
    assert truth["travel_time_s"] == pytest.approx(8e-6 + 2.0 * thickness_m / (5900.0 * 0.9982), rel=1e-12)
