"""Seeded faults: what each changes, its truth, and that nothing changes without one."""

import math
import tomllib
import zlib
from dataclasses import asdict, fields, replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from hardware_drivers.measurement import ShotKey
from simulator.electronics.interference import Interference
from simulator.errors import SpecimenError
from simulator.experiment.faults import draw_faults_of_shot
from simulator.experiment.scatter import STEEPEST_TILT_RAD
from simulator.parameters.chain import ChainParameters
from simulator.parameters.echo import EchoParameters
from simulator.parameters.electronics import NoiseParameters
from simulator.parameters.experiment import (
    DriftParameters,
    ScatterParameters,
    ThinningParameters,
    TwinParameters,
)
from simulator.parameters.faults import (
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
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.shot.model import Impact, ShotModel
from simulator.shot.pulse_summary import summarise_pulses
from simulator.specimen import Transducer, build_specimen

CHAIN = ChainParameters()
# No plate to be solved: the same counts on every machine.
PLATE = PlateParameters(model="infinite_kirchhoff")
QUIET = TwinParameters(
    thinning={},
    noise=NoiseParameters(enabled=False),
    scatter=ScatterParameters(scale=0.0),
    drift=DriftParameters(enabled=False),
)
NOISY = TwinParameters(thinning={})
YEAR_H = 8_766.0
# Every fault at work, and the columns of its truth.
ACTIVE = {
    "missed": (MissedStrikeFault(probability=0.3), {"fault_missed"}),
    "double": (
        DoubleStrikeFault(probability=0.5),
        {"fault_double_delay_s", "fault_double_height_fraction"},
    ),
    "tilt": (TiltFault(tilt_rad=0.05), {"fault_tilt_rad"}),
    "bead_wear": (BeadWearFault(radius_growth_fraction=0.5), {"fault_bead_wear_radius_factor"}),
    "pzt_ageing": (PztAgeingFault(loss_fraction_per_year=0.2), {"fault_pzt_ageing_gain_factor"}),
    "loose_contact": (
        LooseContactFault(probability=0.5),
        {"fault_loose_contact_gain_factor", "fault_loose_contact_damping_factor"},
    ),
    "temperature": (TemperatureFault(change_k=10.0), {"fault_temperature_k"}),
    "clipping": (ClippingFault(gain_factor=3.0), {"fault_clipping_gain_factor"}),
    "spikes": (SpikesFault(rate_hz=3_000.0), {"fault_spikes", "fault_spike_v", "fault_false_triggers"}),
    "mains_hum": (MainsHumFault(amplitude_v=0.2), {"fault_mains_hum_v", "fault_mains_hum_phase_rad"}),
}


@pytest.fixture(scope="module")
def model():
    return ShotModel(CHAIN, PLATE, CorrosionParameters(), cache_folder=None)


@pytest.fixture
def specimen(model):
    def make(twin=QUIET, **faults):
        if faults:
            twin = replace(twin, faults={"B": FaultParameters(**faults)})
        transducers = {name: Transducer(chain=CHAIN, model=model) for name in ("B", "D")}
        return build_specimen(twin, transducers=transducers, probed_thickness_m={"A": 6.35e-3})

    return make


def key(shot_index=0, set_index=0, position="B", attempt=0):
    return ShotKey(position=position, set_index=set_index, shot_index=shot_index, attempt=attempt)


def drawn(faults, n=1_000, hour_h=1.0, seed=1):
    return [draw_faults_of_shot(faults, seed=seed, key=key(k % 10, k // 10), hour_h=hour_h) for k in range(n)]


def assert_rate(hits, probability):
    """Check that seeded draws are in the interval that holds all but 1e-4 of binomial counts."""
    low, high = stats.binom.interval(1.0 - 1e-4, len(hits), probability)
    assert low <= sum(hits) <= high


# ---- without a fault


@pytest.mark.parametrize(
    ("shot", "hour_h", "crc32"),
    # CRC-32 of the int16 counts, written down before the twin knew faults.
    [
        (key(position="D"), 0.5, 2826624841),
        (key(3, 7, "D", 1), 150.0, 1555400831),
        (key(9, 424, "D"), 350.0, 1886369639),
        (key(2, 400), 300.0, 3804638986),
    ],
)
def test_the_default_counts_are_those_from_before_faults(specimen, shot, hour_h, crc32):
    counts = specimen(TwinParameters()).simulate_wave(shot, hour_h).waveform.counts
    assert zlib.crc32(counts.astype("<i2").tobytes()) == crc32


def test_a_smooth_wall_s_echo_is_that_from_before_faults_and_rough_walls(specimen):
    smooth = EchoParameters(
        element_separation_m=0.0, roughness_fraction=0.0, velocity_per_k=0.0, bubble_probability=0.0
    )
    read = ThinningParameters(reference_h=300.0, depth_fraction=2.15 / 6.35)
    echo = specimen(TwinParameters(echo=smooth, thinning={"A": read})).echo(key(0, 9, "A"), 5.0)
    assert zlib.crc32(echo.waveform.counts.astype("<i2").tobytes()) == 3506962529


@pytest.mark.parametrize("name", ACTIVE)
def test_before_its_onset_a_fault_changes_no_bit_and_then_it_does(specimen, name):
    fault = ACTIVE[name][0]
    if hasattr(fault, "probability"):
        fault = replace(fault, probability=1.0)
    made = specimen(NOISY, **{name: replace(fault, onset_h=100.0)})
    plain = specimen(NOISY).simulate_wave(key(1, 4), 99.0)
    early, late = made.simulate_wave(key(1, 4), 99.0), made.simulate_wave(key(1, 4), 100.0 + YEAR_H)
    np.testing.assert_array_equal(early.waveform.counts, plain.waveform.counts)
    assert plain.truth["sensor_gain_v_per_n"] == early.truth["sensor_gain_v_per_n"]
    assert late is None or not np.array_equal(late.waveform.counts, plain.waveform.counts)


def test_the_faults_of_a_neighbour_have_no_effect(specimen):
    faults = {name: fault for name, (fault, _) in ACTIVE.items()}
    plain = specimen(TwinParameters()).simulate_wave(key(position="D"), YEAR_H)
    with_faults = specimen(TwinParameters(), **faults).simulate_wave(key(position="D"), YEAR_H)
    np.testing.assert_array_equal(with_faults.waveform.counts, plain.waveform.counts)


# ---- truth and determinism


def test_every_fault_of_the_double_is_tested():
    assert set(ACTIVE) == {field.name for field in fields(FaultParameters)}


@pytest.mark.parametrize("name", ACTIVE)
def test_a_fault_changes_the_record_and_leaves_its_own_truth_with_every_one(specimen, name):
    fault, columns = ACTIVE[name]
    plain, faulty = specimen(TwinParameters()), specimen(TwinParameters(), **{name: fault})
    changed = 0
    for k in range(8):
        sound, found = plain.simulate_wave(key(k), YEAR_H), faulty.simulate_wave(key(k), YEAR_H)
        if found is None:
            changed += 1
            continue
        assert set(found.truth) - set(sound.truth) == columns
        changed += not np.array_equal(found.waveform.counts, sound.waveform.counts)
    assert changed > 0


def test_strikes_computed_together_are_those_computed_alone_in_any_order(specimen):
    """With every fault at work some strikes miss, some bounce, some have a loose contact."""
    made = specimen(NOISY, **{name: fault for name, (fault, _) in ACTIVE.items()})
    strikes = [
        (key(k % 10, k // 10, position), 1.0 + 50.0 * (k // 10)) for position in ("B", "D") for k in range(20)
    ]
    alone = [made.simulate_wave(shot, hour_h) for shot, hour_h in reversed(strikes)][::-1]
    together = made.simulate_waves(strikes)
    assert [record is None for record in together] == [record is None for record in alone]
    found = [(one, other) for one, other in zip(together, alone, strict=True) if one and other]
    assert 20 < len(found) < 40
    for one, other in found:
        np.testing.assert_array_equal(one.waveform.counts, other.waveform.counts)
        assert list(one.truth) == list(other.truth)
        np.testing.assert_array_equal(list(one.truth.values()), list(other.truth.values()))


def test_a_shot_goes_on_to_draw_what_it_would_draw_without_its_faults(specimen):
    """Faults have random numbers of their own: heights and tilts of an experiment stay."""
    plain, faulty = specimen(TwinParameters()), specimen(TwinParameters(), clipping=ACTIVE["clipping"][0])
    for k in range(5):
        sound, gained = plain.strike(key(k), 1.0), faulty.strike(key(k), 1.0)
        assert (gained.drop_height_m, gained.tilt_rad) == (sound.drop_height_m, sound.tilt_rad)
        assert gained.sensor_gain_v_per_n == 3.0 * sound.sensor_gain_v_per_n


# ---- each fault's own physics


def test_missed_strikes_leave_no_record_and_repeat_with_the_seed(specimen):
    fault = ACTIVE["missed"][0]
    faulty = specimen(NOISY, missed=fault)
    missed = [shot.missed for shot in drawn(FaultParameters(missed=fault), 100)]
    none = [faulty.simulate_wave(key(k % 10, k // 10), 1.0) is None for k in range(100)]
    assert none == missed
    assert_rate([shot.missed for shot in drawn(FaultParameters(missed=fault))], 0.3)


def test_a_repeated_strike_draws_new_random_values():
    faults = FaultParameters(missed=MissedStrikeFault(probability=0.5))
    again = [draw_faults_of_shot(faults, seed=1, key=key(k, attempt=1), hour_h=1.0).missed for k in range(50)]
    assert again != [draw_faults_of_shot(faults, seed=1, key=key(k), hour_h=1.0).missed for k in range(50)]


def test_double_strikes_come_as_often_as_late_and_as_high_as_asked_for():
    fault = DoubleStrikeFault(
        probability=0.4, shortest_delay_s=1e-4, longest_delay_s=5e-4, lowest_height_fraction=0.2
    )
    shots = drawn(FaultParameters(double=fault))
    struck_twice = [shot for shot in shots if shot.double_delay_s is not None]
    assert_rate([shot.double_delay_s is not None for shot in shots], 0.4)
    # Even over both ranges: Kolmogorov-Smirnov, refused for less than one seed in 10,000.
    delays = [(shot.double_delay_s - 1e-4) / 4e-4 for shot in struck_twice]
    heights = [(shot.double_height_fraction - 0.2) / 0.8 for shot in struck_twice]
    assert stats.kstest(delays, "uniform").pvalue > 1e-4
    assert stats.kstest(heights, "uniform").pvalue > 1e-4


def test_a_double_strike_is_a_second_impact_on_the_chain_as_it_moves(specimen, model):
    fault = DoubleStrikeFault(
        probability=1.0, shortest_delay_s=2e-4, longest_delay_s=2e-4, lowest_height_fraction=0.5
    )
    acquired = specimen(double=fault).simulate_wave(key(), 1.0)
    truth, waveform = acquired.truth, acquired.waveform
    t = waveform.time_s() + truth["trigger_time_s"]
    impact = Impact(
        drop_height_m=truth["drop_height_m"],
        tilt_rad=truth["tilt_rad"],
        second_delay_s=truth["fault_double_delay_s"],
        second_drop_height_m=truth["fault_double_height_fraction"] * truth["drop_height_m"],
    )
    (twice,) = model.shots([impact])
    expected_n = np.interp(t, twice.time_s, twice.force_n - twice.preload_n, left=0.0)
    error_v = waveform.volts() - truth["sensor_gain_v_per_n"] * expected_n
    # Rounding is half a code, chords over 0.5 us cost some more; the second wave is 10,000 codes high.
    # Where a contact opens the force jumps between two points of the grid, in a few samples.
    assert np.mean(np.abs(error_v) > 2.0 * waveform.calibration.coefficients_v[1]) < 0.01
    assert truth["fault_double_delay_s"] == pytest.approx(2e-4, rel=1e-12)


def test_tilt_is_simulated_again_from_the_truth(specimen, model):
    tilt = TiltFault(onset_h=10.0, ramp_h=20.0, tilt_rad=0.04)
    truth = specimen(tilt=tilt).simulate_wave(key(), 15.0).truth
    assert truth["fault_tilt_rad"] == pytest.approx(0.01, rel=1e-12)  # a quarter of the ramp
    assert truth["tilt_rad"] == pytest.approx(QUIET.scatter.mean_tilt_rad + 0.01, rel=1e-12)
    force = model.shot(drop_height_m=truth["drop_height_m"], tilt_rad=truth["tilt_rad"])
    assert truth["amplitude_ratio"] == pytest.approx(summarise_pulses(force).amplitude_ratio, rel=1e-9)
    sensor = QUIET.sensor
    gain = sensor.sensitivity_v_per_n * math.exp(-sensor.tilt_loss_per_rad * truth["tilt_rad"])
    assert truth["sensor_gain_v_per_n"] == pytest.approx(gain, rel=1e-12)


def test_tilt_stops_where_the_disk_leaves_the_chain(specimen):
    truth = specimen(tilt=TiltFault(tilt_rad=0.2)).simulate_wave(key(), 0.0).truth
    assert truth["tilt_rad"] == STEEPEST_TILT_RAD


def test_wear_and_damping_are_those_of_a_chain_with_these_parameters(specimen):
    worn = specimen(
        bead_wear=BeadWearFault(radius_growth_fraction=0.8),
        loose_contact=LooseContactFault(probability=1.0, gain_factor=0.5, damping_factor=3.0),
    )
    truth = worn.simulate_wave(key(), 0.0).truth
    chain = replace(
        CHAIN,
        radius_m=1.8 * CHAIN.radius_m,
        contact_damping_n_s_per_m=3.0 * CHAIN.contact_damping_n_s_per_m,
    )
    fresh = ShotModel(chain, PLATE, CorrosionParameters(), cache_folder=None, step_s=5e-7)
    expected = summarise_pulses(fresh.shot(drop_height_m=truth["drop_height_m"], tilt_rad=truth["tilt_rad"]))
    assert truth["isw_peak_n"] == pytest.approx(expected.isw_peak_n, rel=1e-9)
    assert truth["tof_s"] == pytest.approx(1e-6 * expected.tof_us, rel=1e-9)
    assert truth["amplitude_ratio"] == pytest.approx(expected.amplitude_ratio, rel=1e-9)
    nominal = specimen().simulate_wave(key(), 0.0).truth
    assert truth["sensor_gain_v_per_n"] == pytest.approx(0.5 * nominal["sensor_gain_v_per_n"], rel=1e-12)


def test_only_a_shot_model_can_be_refitted():
    class Other:
        def shot(self, *, depth_fraction, drop_height_m, tilt_rad, through_hole):
            raise AssertionError("not reached")

    made = build_specimen(
        replace(QUIET, faults={"B": FaultParameters(bead_wear=ACTIVE["bead_wear"][0])}),
        transducers={"B": Transducer(chain=CHAIN, model=Other())},
        probed_thickness_m={},
    )
    with pytest.raises(SpecimenError, match="Other"):
        made.simulate_wave(key(), 0.0)


def test_pzt_loses_the_same_fraction_every_year(specimen):
    made = specimen(pzt_ageing=PztAgeingFault(onset_h=100.0, loss_fraction_per_year=0.2))
    gains = [
        made.strike(key(), hour).sensor_gain_v_per_n for hour in (0.0, 100.0, 100 + YEAR_H, 100 + 2 * YEAR_H)
    ]
    np.testing.assert_allclose(np.array(gains) / gains[0], [1.0, 1.0, 0.8, 0.64], rtol=1e-12)


def test_a_loose_contact_jumps_as_often_as_asked_for_after_its_onset():
    fault = LooseContactFault(onset_h=50.0, probability=0.3, gain_factor=0.4, damping_factor=2.0)
    after = drawn(FaultParameters(loose_contact=fault), hour_h=50.0)
    assert_rate([shot.gain_factor == 0.4 for shot in after], 0.3)
    assert {(shot.gain_factor, shot.contact_damping_factor) for shot in after} == {(1.0, 1.0), (0.4, 2.0)}
    assert {shot.gain_factor for shot in drawn(FaultParameters(loose_contact=fault), hour_h=49.9)} == {1.0}


def test_temperature_rises_with_the_ramp_of_its_fault(specimen):
    made = specimen(temperature=TemperatureFault(onset_h=10.0, ramp_h=10.0, change_k=20.0))
    truth = made.simulate_wave(key(), 15.0).truth
    assert truth["temperature_c"] == QUIET.drift.mean_temperature_c + 10.0


def test_a_gain_step_clips_at_the_last_code(specimen):
    waveform = (
        specimen(clipping=ClippingFault(onset_h=5.0, gain_factor=3.0)).simulate_wave(key(), 5.0).waveform
    )
    assert waveform.clipped
    assert waveform.counts.max() == waveform.calibration.full_scale_counts[1]
    assert (
        not specimen(clipping=ClippingFault(onset_h=5.0, gain_factor=3.0))
        .simulate_wave(key(), 4.9)
        .waveform.clipped
    )


# ---- hum and spikes


def interference(**changes):
    values = {
        "hum_v": 0.0,
        "hum_frequency_hz": 50.0,
        "hum_phase_rad": 0.0,
        "spike_time_s": np.empty(0),
        "spike_v": np.empty(0),
        "spike_fwhm_s": 1e-6,
    }
    return Interference(**(values | changes))


def test_hum_is_a_sinusoid_of_its_frequency_and_phase():
    volts = interference(hum_v=0.3, hum_frequency_hz=60.0, hum_phase_rad=1.0).volts(-0.01, 1e5, 2_000)
    t = -0.01 + np.arange(2_000) / 1e5
    np.testing.assert_allclose(volts, 0.3 * np.sin(2 * np.pi * 60.0 * t + 1.0), atol=1e-15)


def test_the_phase_of_the_hum_is_random_at_every_strike(specimen):
    made = specimen(mains_hum=MainsHumFault(amplitude_v=0.1))
    records = [made.simulate_wave(key(k % 10, k // 10), 0.0) for k in range(100)]
    turns = [record.truth["fault_mains_hum_phase_rad"] / (2.0 * np.pi) for record in records]
    # Kolmogorov-Smirnov, refused for less than one seed in 10,000.
    assert stats.kstest(turns, "uniform").pvalue > 1e-4


def test_a_spike_has_its_height_width_and_place():
    volts = interference(spike_time_s=np.array([1e-4]), spike_v=np.array([-2.0])).volts(0.0, 1e8, 20_000)
    assert np.argmin(volts) == 10_000
    assert volts.min() == pytest.approx(-2.0, rel=1e-12)
    # Samples every 10 ns: the width at half height is known to one of them.
    assert np.count_nonzero(volts <= -1.0) * 1e-8 == pytest.approx(1e-6, abs=1.01e-8)
    assert not np.any(volts[[9_600, 10_400]])


def test_a_spike_at_the_record_s_edge_is_drawn_as_far_as_it_reaches():
    spike = {"spike_time_s": np.array([-5e-7, 1e-4]), "spike_v": np.array([1.0, 1.0])}
    whole, part = interference(**spike).volts(-1e-5, 1e7, 1_200), interference(**spike).volts(0.0, 1e7, 1_001)
    # Where one ends a sample sooner than the other, 2e-11 of its height is left (`SPIKE_REACH_FWHM`).
    np.testing.assert_allclose(part, whole[100:1_101], rtol=1e-9, atol=2e-11)
    assert part[0] == pytest.approx(0.5, rel=1e-9)  # half a width from its peak


def test_spikes_come_at_their_rate_and_with_either_sign(specimen):
    made = specimen(spikes=SpikesFault(rate_hz=3_000.0, height_v=0.1, armed_s=0.0))
    counts = [made.simulate_wave(key(k % 10, k // 10), 0.0).truth["fault_spikes"] for k in range(200)]
    expected = 200 * 3_000.0 * QUIET.adc.record_samples / QUIET.adc.sample_rate_hz
    low, high = stats.poisson.interval(1.0 - 1e-4, expected)
    assert low <= sum(counts) <= high


def test_a_spike_takes_the_trigger_as_often_as_one_comes_first(specimen):
    made = specimen(spikes=SpikesFault(rate_hz=10.0, height_v=2.0, armed_s=0.1))
    early, false_triggers = [], []
    for k in range(200):
        truth = made.simulate_wave(key(k % 10, k // 10), 0.0).truth
        early.append(truth["trigger_time_s"] < 0.0)
        false_triggers.append(truth["fault_false_triggers"] > 0.0)
    assert early == false_triggers
    assert_rate(early, 1.0 - math.exp(-0.5 * 10.0 * 0.1))  # every other one rises


def test_spikes_below_the_trigger_level_take_no_trigger(specimen):
    made = specimen(spikes=SpikesFault(rate_hz=1e4, height_v=0.2, armed_s=0.1))
    assert made.simulate_wave(key(), 0.0).truth["fault_false_triggers"] == 0.0


# ---- parameters


@pytest.mark.parametrize(
    ("parameters", "values", "message"),
    [
        (MissedStrikeFault, {"probability": 1.1}, "probability is 1.1; it must be at most 1.0"),
        (DoubleStrikeFault, {"shortest_delay_s": 1e-3}, "longest_delay_s is 0.0007 s"),
        (TiltFault, {"tilt_rad": 0.3}, "tilt_rad is 0.3"),
        (BeadWearFault, {"radius_growth_fraction": -0.1}, "radius_growth_fraction is -0.1"),
        (PztAgeingFault, {"loss_fraction_per_year": 1.0}, "loss_fraction_per_year is 1.0"),
        (LooseContactFault, {"gain_factor": 0.0}, "gain_factor is 0.0; it must be greater than 0.0"),
        (TemperatureFault, {"change_k": float("nan")}, "change_k is nan"),
        (ClippingFault, {"gain_factor": 0.5}, "gain_factor is 0.5"),
        (SpikesFault, {"rate_hz": 1e5}, "rate_hz is 100000.0"),
        (MainsHumFault, {"frequency_hz": 0.0}, "frequency_hz is 0.0"),
        (
            TwinParameters,
            {"faults": {"B": FaultParameters(mains_hum=MainsHumFault(amplitude_v=0.25))}},
            r"faults\.B\.mains_hum\.amplitude_v is 0\.25 V; it must be below adc\.trigger_level_v",
        ),
    ],
)
def test_a_value_out_of_bounds_is_named(parameters, values, message):
    with pytest.raises(ValueError, match=message):
        parameters(**values)


def test_the_shipped_file_spells_every_default():
    shipped = Path(__file__).parents[4] / "config" / "simulated.toml"
    lines = shipped.read_text(encoding="utf-8").split("[twin.faults]")[1].splitlines()[2:]
    example = [line.removeprefix("# ") for line in lines[: lines.index("")]]
    assert tomllib.loads("\n".join(example)) == asdict(FaultParameters())
