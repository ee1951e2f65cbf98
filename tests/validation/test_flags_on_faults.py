"""What the shot flags find of the twin's seeded faults, judged by the stored truth.

The rates were counted on 2,000 other shots each (seed 901). Here 200 shots are drawn, and the count must
lie in the interval that holds all but 1e-4 of the binomial counts of that rate; where all or none were
found, all or none must be. The mesh is coarse: pulses' shapes matter here, not the plate's stiffness.
"""

import numpy as np
import pytest
from scipy import stats

from analysis.features import extract_features
from hardware_drivers.measurement import ShotKey
from simulator.coupled_model import ShotModel
from simulator.fault_parameters import (
    BeadWearFault,
    ClippingFault,
    DoubleStrikeFault,
    FaultParameters,
    LooseContactFault,
    MainsHumFault,
    MissedStrikeFault,
    PztAgeingFault,
    SpikesFault,
    TemperatureFault,
    TiltFault,
)
from simulator.parameters import ChainParameters, CorrosionParameters, PlateParameters
from simulator.scenario import ThinningParameters, TwinParameters
from simulator.specimen import Transducer, build_specimen

N_SHOTS = 200
HOUR_H = 8_766.0
"""Every gradual fault has its full size, ageing is a year old."""
CLEAN_RATE = 15 / 2_000
"""Part of sound records flagged `baseline`, the only flag that they get."""


@pytest.fixture(scope="module")
def shoot():
    chain = ChainParameters()
    model = ShotModel(
        chain,
        PlateParameters(elements_per_edge=32, contact_element_m=1e-3),
        CorrosionParameters(size_m=25.4e-3),
        cache_folder=None,
    )

    def shots(thinning=None, **faults):
        """Truth and features of every shot, both None for a strike without a record."""
        twin = TwinParameters(
            thinning={"B": thinning or ThinningParameters()}, faults={"B": FaultParameters(**faults)}
        )
        specimen = build_specimen(
            twin, transducers={"B": Transducer(chain=chain, model=model)}, probed_thickness_m={}
        )
        keys = (ShotKey(position="B", set_index=k // 10, shot_index=k % 10) for k in range(N_SHOTS))
        records = [specimen.solitary_wave(key, HOUR_H) for key in keys]
        return [
            (None, None) if record is None else (record.truth, extract_features(record.waveform))
            for record in records
        ]

    return shots


def assert_rate(found, rate):
    low, high = stats.binom.interval(1.0 - 1e-4, len(found), rate)
    assert low <= np.count_nonzero(found) <= high


def flagged(shots, flag):
    return [flag in features.flags for _, features in shots]


def mean(shots, name):
    return np.mean([getattr(features, name) for _, features in shots])


def test_sound_shots_are_valid_and_seldom_flagged(shoot):
    shots = shoot()
    assert all(features.valid for _, features in shots)
    assert {flag for _, features in shots for flag in features.flags} <= {"baseline"}
    assert_rate(flagged(shots, "baseline"), CLEAN_RATE)


def test_missed_strikes_give_no_record_and_the_others_stay_valid(shoot):
    shots = shoot(missed=MissedStrikeFault(probability=0.2))
    assert_rate([truth is None for truth, _ in shots], 0.2)
    assert all(features.valid for _, features in shots if features is not None)


def test_every_double_strike_is_found_and_no_single_one_called_double(shoot):
    shots = shoot(double=DoubleStrikeFault(probability=0.5))
    struck_twice = [not np.isnan(truth["fault_double_delay_s"]) for truth, _ in shots]
    assert_rate(struck_twice, 0.5)
    # Of 999 strikes with a second one of at least .3 of the height none was overlooked.
    assert flagged(shots, "double") == struck_twice


def test_every_clipped_wave_is_found(shoot):
    assert all(flagged(shoot(clipping=ClippingFault(gain_factor=3.0)), "clipped"))


def test_every_shot_at_a_through_hole_lacks_its_reflected_wave(shoot):
    shots = shoot(thinning=ThinningParameters(reference_h=100.0, depth_fraction=0.3, hole_h=200.0))
    assert all(truth["pit_depth_fraction"] >= 0.95 for truth, _ in shots)
    assert all(flagged(shots, "no_psw"))


@pytest.mark.parametrize(("frequency_hz", "rate"), [(50.0, 519 / 2_000), (60.0, 793 / 2_000)])
def test_hum_is_found_in_part_and_leaves_the_shot_valid(shoot, frequency_hz, rate):
    """At its crest hum hardly moves within a record, and nothing tells it from an offset."""
    shots = shoot(mains_hum=MainsHumFault(amplitude_v=0.2, frequency_hz=frequency_hz))
    assert_rate(flagged(shots, "baseline"), rate)
    assert all(features.valid for _, features in shots)
    # Found where it moves most: the slope of the hum at the strike goes with |cos phase|.
    steepness = np.array([abs(np.cos(truth["fault_mains_hum_phase_rad"])) for truth, _ in shots])
    hit = np.array(flagged(shots, "baseline"))
    assert stats.mannwhitneyu(steepness[hit], steepness[~hit], alternative="greater").pvalue < 1e-4


def test_small_spikes_pass_mostly_unseen_and_do_no_harm(shoot):
    shots = shoot(spikes=SpikesFault(rate_hz=2_000.0, height_v=1.0, armed_s=0.0))
    # A record holds 2.7 on average: 1 us wide, they drown in the means over 10 us.
    assert np.mean([truth["fault_spikes"] for truth, _ in shots]) > 2.0
    assert all(features.valid for _, features in shots)
    assert_rate(flagged(shots, "baseline"), 141 / 2_000)


def test_records_that_a_spike_triggered_are_not_valid(shoot):
    """They are called double, missed or inverted; two of 450 kept their wave within the record."""
    shots = shoot(spikes=SpikesFault(rate_hz=5.0, height_v=2.0, armed_s=0.1))
    falsely = [features for truth, features in shots if truth["fault_false_triggers"] > 0.0]
    rightly = [features for truth, features in shots if truth["fault_false_triggers"] == 0.0]
    assert_rate([len(falsely) > k for k in range(N_SHOTS)], 450 / 2_000)
    assert_rate([not features.valid for features in falsely], 449 / 450)
    assert all(features.valid for features in rightly)


# No flag is made for these: they move amplitude, width or shape of whole series, and every shot of them
# stays valid. What is flagged more often is the baseline, where the signal is smaller and its noise not.
@pytest.mark.parametrize(
    ("fault", "baseline_rate"),
    [
        ({"tilt": TiltFault(tilt_rad=0.05)}, 551 / 2_000),
        ({"pzt_ageing": PztAgeingFault(loss_fraction_per_year=0.5)}, 590 / 2_000),
        ({"loose_contact": LooseContactFault(probability=0.5)}, 185 / 2_000),
        ({"temperature": TemperatureFault(change_k=20.0)}, 7 / 2_000),
        ({"bead_wear": BeadWearFault(radius_growth_fraction=1.0)}, 2 / 2_000),
    ],
)
def test_slow_faults_have_no_flag_of_their_own(shoot, fault, baseline_rate):
    shots = shoot(**fault)
    assert all(features.valid for _, features in shots)
    assert {flag for _, features in shots for flag in features.flags} <= {"baseline"}
    assert_rate(flagged(shots, "baseline"), baseline_rate)


def test_features_move_as_the_slow_faults_physics_says(shoot):
    sound = shoot()
    aged = shoot(pzt_ageing=PztAgeingFault(loss_fraction_per_year=0.5))
    worn = shoot(bead_wear=BeadWearFault(radius_growth_fraction=1.0))
    # The same strikes at half the gain: amplitude halves to the noise of 200 means, 25 mV / 10 each at
    # most; width and times stay within theirs, well below a microsecond.
    assert mean(aged, "isw_amplitude_v") == pytest.approx(0.5 * mean(sound, "isw_amplitude_v"), abs=2.5e-3)
    assert mean(aged, "isw_fwhm_s") == pytest.approx(mean(sound, "isw_fwhm_s"), abs=0.2e-6)
    assert mean(aged, "tof_mf_s") == pytest.approx(mean(sound, "tof_mf_s"), abs=0.2e-6)
    # A grows by sqrt 2, a wave's width goes with A^-0.4: exact for a lone chain, here within 1 %.
    shorter = mean(worn, "isw_fwhm_s") / mean(sound, "isw_fwhm_s")
    assert shorter == pytest.approx(2.0**-0.2, rel=0.01)
