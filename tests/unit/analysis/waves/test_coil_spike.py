"""What a strike's free record says of the coil: heights and times put in, and the holdoff they ask for."""

import numpy as np
import pytest
from support.synthetic_records import cos4, waveform_of

from analysis.errors import RecordError
from analysis.waves.coil_spike import HOLDOFF_PART, SMALLEST_ROOM, measure_coil_spike

RATE_HZ = 2e6
PULSE_S, FALL_S, PRETRIGGER_S, LEVEL_V = 20e-3, 31.9e-3, 0.1e-3, 0.25
NOISE_V = 0.025
T = np.arange(round((PULSE_S + FALL_S + 10e-3) * RATE_HZ)) / RATE_HZ
WAVE_V, WAVE_S = 2.5, PULSE_S + 32.5e-3
"""Peak of the incident wave: later than the fall, the chain's passage and friction included."""
WAVE = WAVE_V * cos4(T, WAVE_S) + 0.5 * WAVE_V * cos4(T, WAVE_S + 0.33e-3)


def noise(samples, seed=0, volts=NOISE_V):
    return volts * np.random.default_rng(seed).standard_normal(samples)


def spike(edge_s, height_v, decay_s, ringing_hz=0.0):
    since = np.maximum(T - edge_s, 0.0)
    return (edge_s <= T) * height_v * np.exp(-since / decay_s) * np.cos(2.0 * np.pi * ringing_hz * since)


def survey(volts, *, noise_v=NOISE_V, offset_v=0.03, **changes):
    values = {
        "pulse_s": PULSE_S, "fall_s": FALL_S, "pretrigger_s": PRETRIGGER_S, "trigger_level_v": LEVEL_V,
    } | changes  # fmt: skip
    return measure_coil_spike(
        waveform_of(volts + offset_v + noise(T.size, 1, noise_v), RATE_HZ, 0),
        waveform_of(offset_v + noise(10_000, 2, noise_v), RATE_HZ, 0),
        **values,
    )


def test_a_quiet_coil_has_no_spike_and_its_holdoff_is_a_third_of_the_fall():
    found = survey(WAVE)
    assert (found.on.height_v, found.off.height_v, found.off.ringing_s) == (0.0, 0.0, 0.0)
    assert not found.takes_the_trigger
    assert found.wave_v == pytest.approx(WAVE_V, abs=4 * NOISE_V)
    # The front begins 0.3 ms before the peak; a block of 10 us is what the peak is known to.
    assert found.wave_after_s == pytest.approx(WAVE_S - PULSE_S - 0.3e-3, abs=20e-6)
    assert found.latest_holdoff_s == pytest.approx(FALL_S - PRETRIGGER_S)
    assert found.holdoff_s == pytest.approx((FALL_S - PRETRIGGER_S) / 3.0, abs=0.05e-3)
    assert found.trigger_level_v is None, "a tenth of the wave already"


@pytest.mark.parametrize("edge", ["on", "off"])
@pytest.mark.parametrize("decay_s", [1e-6, 50e-6, 0.5e-3, 5e-3])
@pytest.mark.parametrize("height_v", [0.3, 1.0, -1.0, 5.0])
def test_height_duration_and_ringing_of_a_spike_are_those_put_in(edge, decay_s, height_v):
    at = {"on": 0.0, "off": PULSE_S}[edge]
    found = survey(WAVE + spike(at, height_v, decay_s))
    measured, other = (found.on, found.off) if edge == "on" else (found.off, found.on)
    assert measured.height_v == pytest.approx(height_v, abs=5 * NOISE_V)
    # Noise on a slow decay makes the last crossing late: by what five SD of it are worth in time.
    slack_s = 2.0 / RATE_HZ + decay_s * 5 * NOISE_V / (0.5 * abs(height_v))
    assert measured.duration_s == pytest.approx(decay_s * np.log(2.0), abs=slack_s)
    assert measured.triggers is (height_v > 0.0)
    least_s, most_s = (
        decay_s * np.log(abs(height_v) / (found.limit_v + way * 5.5 * NOISE_V)) for way in (1.0, -1.0)
    )
    assert least_s - 2.0 / RATE_HZ <= measured.ringing_s <= most_s + 2.0 / RATE_HZ
    if edge == "off" or decay_s < 1e-3:
        assert other.height_v == 0.0
    room_s = found.latest_holdoff_s - found.off.ringing_s
    assert room_s >= SMALLEST_ROOM * FALL_S
    assert found.holdoff_s == pytest.approx(found.off.ringing_s + HOLDOFF_PART * room_s, abs=0.05e-3)


def test_flyback_is_the_departure_to_the_other_side():
    found = survey(WAVE + spike(PULSE_S, 2.0, 0.1e-3, 10e3))
    # A half period of 50 us later the decay has left exp(-1/2).
    assert found.off.flyback_v == pytest.approx(-2.0 * np.exp(-0.5), abs=5 * NOISE_V)
    assert found.on.flyback_v == 0.0


def test_a_small_spike_is_reported_and_has_no_ringing_time():
    found = survey(WAVE + spike(PULSE_S, 0.06, 2e-6), noise_v=2e-3)
    assert found.off.height_v == pytest.approx(0.06, abs=0.01)
    assert (found.off.ringing_s, found.takes_the_trigger) == (0.0, False)


def test_ringing_without_room_for_a_holdoff_is_reported_and_none_is_proposed():
    found = survey(WAVE + spike(PULSE_S, 5.0, 9e-3))
    assert (found.obstacle, found.holdoff_s) == ("ringing", None)
    assert found.off.ringing_s > found.latest_holdoff_s - SMALLEST_ROOM * FALL_S
    assert survey(WAVE + spike(PULSE_S, 5.0, 1.0, 1e3)).obstacle == "ringing"


def test_without_a_wave_nothing_is_proposed():
    found = survey(spike(PULSE_S, 1.0, 50e-6))
    assert (found.obstacle, found.holdoff_s, found.trigger_level_v) == ("no_wave", None, None)
    assert (found.wave_v, found.wave_after_s) == (None, None)
    assert found.off.height_v == pytest.approx(1.0, abs=5 * NOISE_V), "the spike is told all the same"


def test_noise_above_the_level_is_not_reported_as_a_spike():
    assert survey(WAVE, noise_v=0.05).obstacle == "noise"


def test_a_wave_that_comes_early_moves_the_latest_holdoff():
    early_s = 25e-3
    found = survey(WAVE_V * cos4(T, PULSE_S + early_s))
    assert found.latest_holdoff_s == pytest.approx(early_s - 0.3e-3 - PRETRIGGER_S, abs=20e-6)
    assert found.holdoff_s == pytest.approx(found.latest_holdoff_s / 3.0, abs=0.05e-3)


@pytest.mark.parametrize(("wave_v", "proposed_v"), [(2.5, None), (0.4, 0.15), (9.0, None)])
def test_a_level_is_proposed_where_the_present_one_does_not_fit_the_wave(wave_v, proposed_v):
    """A tenth of the wave, but not within six times the noise."""
    found = survey(wave_v / WAVE_V * WAVE)
    if proposed_v is None:
        assert found.trigger_level_v is None
    else:
        # Two digits of six times the noise as measured.
        assert found.trigger_level_v == pytest.approx(proposed_v, abs=0.011)


def test_a_level_far_below_the_wave_is_raised_to_a_tenth_of_it():
    found = survey(3.5 * WAVE, noise_v=1e-3, trigger_level_v=0.05)
    assert found.trigger_level_v == pytest.approx(0.1 * 3.5 * WAVE_V, rel=0.02)


def test_a_falling_slope_triggers_on_the_inverted_signal():
    volts = WAVE + spike(PULSE_S, 1.0, 50e-6)
    up = survey(volts, offset_v=0.0)
    down = survey(-volts, offset_v=0.0, trigger_level_v=-LEVEL_V, rising=False)
    assert down.takes_the_trigger
    assert down.off.height_v == pytest.approx(-up.off.height_v, abs=10 * NOISE_V)
    assert down.wave_v == pytest.approx(-up.wave_v, abs=4 * NOISE_V)
    assert down.holdoff_s == pytest.approx(up.holdoff_s, abs=0.11e-3)


def test_a_record_that_ends_before_the_wave_is_refused():
    with pytest.raises(RecordError, match="record longer"):
        survey(WAVE, fall_s=0.05)
