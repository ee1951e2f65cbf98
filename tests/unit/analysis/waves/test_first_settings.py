"""First settings proposed from strikes of known waves, noise and spikes."""

import numpy as np
import pytest
from support.synthetic_records import cos4, waveform_of

from analysis.waves.coil_spike import HOLDOFF_PART
from analysis.waves.features import extract_features
from analysis.waves.first_settings import HEADROOM, StruckTransducer, cut_triggered_record, propose_settings

RATE_HZ = 2e6
PULSE_S, FALL_S, PRETRIGGER_S = 20e-3, 31.9e-3, 0.1e-3
T = np.arange(round((PULSE_S + FALL_S + 10e-3) * RATE_HZ)) / RATE_HZ
WAVE_S = PULSE_S + 32.5e-3
RANGES_V = (1.0, 2.0, 5.0, 10.0)


def struck(wave_v=2.5, *, noise_v=0.01, offset_v=0.0, off_v=0.0, decay_s=0.2e-3, seed=0):
    """Return waves of a transducer, after the crosstalk of its coil."""
    random = np.random.default_rng(seed)
    volts = wave_v * (cos4(T, WAVE_S) + 0.5 * cos4(T, WAVE_S + 0.33e-3))
    volts += (T >= PULSE_S) * off_v * np.exp(-np.maximum(T - PULSE_S, 0.0) / decay_s)
    strike = waveform_of(volts + offset_v + noise_v * random.standard_normal(T.size), RATE_HZ, 0)
    noise = waveform_of(offset_v + noise_v * random.standard_normal(20_000), RATE_HZ, 0)
    return StruckTransducer(noise=noise, strike=strike, ranges_v=RANGES_V)


def proposed(**transducers):
    return propose_settings(transducers, pulse_s=PULSE_S, fall_s=FALL_S)


def test_a_clean_strike_gives_the_papers_own_settings():
    found = proposed(B=struck())
    assert found.troubles == {}
    assert found.rising
    assert found.trigger_level_v == pytest.approx(0.25, rel=0.05)
    assert found.pretrigger_s == PRETRIGGER_S
    assert found.range_v == {"B": 5.0}
    assert found.holdoff_s == pytest.approx((FALL_S - PRETRIGGER_S) * HOLDOFF_PART, abs=0.05e-3)
    assert found.ringing_s == 0.0


@pytest.mark.parametrize(
    ("wave_v", "range_v"), [(0.3, 1.0), (0.64, 1.0), (0.7, 2.0), (1.3, 2.0), (1.4, 5.0), (6.0, 10.0)]
)
def test_the_range_is_the_smallest_one_with_headroom(wave_v, range_v):
    assert proposed(B=struck(wave_v)).range_v == {"B": range_v}
    assert range_v >= HEADROOM * wave_v


def test_noise_raises_the_level_above_its_crests():
    found = proposed(B=struck(1.0, noise_v=0.03))
    assert found.troubles == {}
    assert found.trigger_level_v == pytest.approx(0.24, abs=0.01), "eight times the noise"


def test_the_level_stands_on_the_inputs_offset():
    assert proposed(B=struck(offset_v=-0.1)).trigger_level_v == pytest.approx(0.15, abs=0.01)


def test_a_falling_wave_triggers_downwards_and_reversed_leads_are_reported():
    found = proposed(B=struck(-2.5))
    assert found.troubles == {"B": "inverted"}, "its shots would be flagged so"
    assert not found.rising
    assert found.trigger_level_v == pytest.approx(-0.25, rel=0.05)
    assert found.surveys["B"].wave_v == pytest.approx(-2.5, abs=0.1)


def test_reversed_leads_of_one_transducer_are_reported():
    found = proposed(B=struck(), C=struck(-4.0), D=struck())
    assert (found.rising, found.troubles) == (True, {"C": "inverted"})


def test_the_longest_ringing_sets_the_holdoff_of_all():
    found = proposed(B=struck(), C=struck(off_v=5.0, decay_s=2e-3))
    # Down to half of the level of 0.25 V, within five SD of the noise of 10 mV, rounded up.
    least_s, most_s = (2e-3 * np.log(5.0 / (0.125 + way * 0.05)) for way in (1.0, -1.0))
    assert least_s <= found.ringing_s <= most_s + 0.1e-3
    assert found.surveys["C"].takes_the_trigger
    room_s = FALL_S - PRETRIGGER_S - found.ringing_s
    assert found.holdoff_s == pytest.approx(found.ringing_s + HOLDOFF_PART * room_s, abs=0.06e-3)
    assert found.range_v["C"] == 5.0, "what rings before the holdoff needs no range"


def test_ringing_without_room_names_its_coil_and_proposes_none():
    found = proposed(B=struck(), C=struck(off_v=5.0, decay_s=9e-3))
    assert (found.holdoff_s, found.ringing_s) == (None, 0.0)
    assert found.troubles["C"] == "ringing"


@pytest.mark.parametrize(("wave_v", "trouble"), [(0.0, "no_wave"), (0.12, "noise")])
def test_a_wave_that_is_lost_in_noise_gives_no_level(wave_v, trouble):
    found = proposed(B=struck(wave_v))
    assert found.trigger_level_v is None
    assert found.troubles == {"B": trouble}


def test_one_level_cannot_serve_waves_of_very_different_heights():
    quiet = {"noise_v": 1e-3}
    assert proposed(B=struck(6.0, **quiet), C=struck(1.5, **quiet)).troubles == {}
    assert proposed(B=struck(9.0, **quiet), C=struck(0.15, **quiet)).troubles == {"B": "level"}


def test_a_clipped_record_asks_for_the_next_range_and_another_strike():
    one = struck(12.0)
    found = proposed(B=StruckTransducer(noise=one.noise, strike=one.strike, ranges_v=(1.0, 10.0, 42.0)))
    assert (found.range_v, found.again, found.troubles) == ({"B": 42.0}, ("B",), {})
    found = proposed(B=one)
    assert (found.range_v, found.again, found.troubles) == ({"B": 10.0}, (), {"B": "range"})


def test_the_shot_that_would_have_been_recorded_has_its_features():
    one = struck(off_v=3.0, decay_s=0.3e-3)
    found = proposed(B=one)
    samples = {"pretrigger_samples": round(found.pretrigger_s * RATE_HZ), "samples": 2720}
    shot = cut_triggered_record(
        one.strike, after_s=PULSE_S + found.holdoff_s, level_v=found.trigger_level_v, rising=True, **samples
    )
    features = extract_features(shot)
    assert "false_trigger" not in features.flags
    assert features.tof_pp_s == pytest.approx(0.33e-3, abs=0.5e-6)
    early = cut_triggered_record(
        one.strike, after_s=0.0, level_v=found.trigger_level_v, rising=True, **samples
    )
    assert "false_trigger" in extract_features(early).flags, "without the holdoff the spike takes it"
    assert cut_triggered_record(one.strike, after_s=0.0, level_v=9.0, rising=True, **samples) is None
