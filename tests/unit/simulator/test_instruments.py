"""The twin's bench: who hears which strike, when the wall is how deep, and the same numbers always."""

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from hardware_drivers.errors import AcquisitionTimeoutError, ConfigurationError
from hardware_drivers.instruments import Rig
from hardware_drivers.measurement import ShotKey
from simulator.instruments import LARGEST_GROUP, RECORDS_AHEAD, build_bench
from simulator.parameters.chain import ChainParameters
from simulator.parameters.electronics import AdcParameters, NoiseParameters
from simulator.parameters.experiment import (
    DriftParameters,
    ScatterParameters,
    ThinningParameters,
    TwinParameters,
)
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.shot.model import ShotModel
from simulator.shot.pulse_summary import summarise_pulses
from simulator.specimen import Transducer, build_specimen

EPOCH_NS = 1_704_067_200_000_000_000
NS_PER_S = 1_000_000_000
TIMEOUT_S = 1.0
CHAIN = ChainParameters()
TWIN = TwinParameters()
SMOOTH = replace(TWIN.echo, roughness_fraction=0.0, bubble_probability=0.0, velocity_per_k=0.0)


class HandClock:
    """Clock of the experiment, set by the test."""

    def __init__(self):
        self.now_ns = EPOCH_NS

    def utc_ns(self):
        return self.now_ns

    def mono_ns(self):
        return self.now_ns

    def wait_until(self, utc_ns, idle):
        self.now_ns = max(self.now_ns, utc_ns)
        return idle()

    def go_to_hour(self, hour_h):
        self.now_ns = EPOCH_NS + round(hour_h * 3600 * NS_PER_S)


@pytest.fixture(scope="module")
def model():
    """The paper's plate with the patch of position B."""
    return ShotModel(CHAIN, PlateParameters(), CorrosionParameters(size_m=25.4e-3), cache_folder=None)


@pytest.fixture
def clock():
    return HandClock()


@pytest.fixture
def make_bench(model, clock):
    def make(twin=TWIN, executor=None):
        return build_bench(
            twin,
            clock=clock,
            epoch_utc_ns=EPOCH_NS,
            transducers={name: Transducer(chain=CHAIN, model=model) for name in ("B", "D")},
            probed_thickness_m={"A": 6.35e-3},
            strikes_after=strikes_after,
            executor=executor,
        )

    return make


def key(shot_index=0, set_index=0, position="B", attempt=0):
    return ShotKey(position=position, set_index=set_index, shot_index=shot_index, attempt=attempt)


def shoot(bench, shot):
    bench.digitizer.arm(shot)
    bench.striker.strike(shot)
    return bench.digitizer.read(TIMEOUT_S)


def assert_same(first, second):
    np.testing.assert_array_equal(first.waveform.counts, second.waveform.counts)
    assert list(first.truth) == list(second.truth)
    np.testing.assert_array_equal(list(first.truth.values()), list(second.truth.values()))


def test_a_strike_elsewhere_is_not_recorded(make_bench):
    bench = make_bench()
    bench.digitizer.arm(key(position="B"))
    bench.striker.strike(key(position="D"))
    with pytest.raises(AcquisitionTimeoutError, match="'B'"):
        bench.digitizer.read(TIMEOUT_S)


def test_only_the_first_strike_triggers(make_bench):
    bench = make_bench()
    bench.digitizer.arm(key(0))
    bench.striker.strike(key(0))
    bench.striker.strike(key(1))
    assert_same(bench.digitizer.read(TIMEOUT_S), shoot(make_bench(), key(0)))


def test_a_rig_of_these_instruments_leaves_everything_safe(make_bench, clock):
    bench = make_bench()
    with Rig(kind="simulated", clock=clock, striker=bench.striker, digitizer=bench.digitizer) as rig:
        rig.digitizer.arm(key())
    with pytest.raises(ConfigurationError, match="not armed"):
        bench.digitizer.read(TIMEOUT_S)


def test_a_strike_too_weak_for_the_trigger_is_a_missed_one(make_bench):
    deaf = replace(TWIN, adc=AdcParameters(trigger_level_v=4.5))
    with pytest.raises(AcquisitionTimeoutError, match=r"trigger level of 4\.5 V"):
        shoot(make_bench(deaf), key())


def test_a_record_longer_than_the_physics_is_refused_with_the_remedy(make_bench):
    long = replace(TWIN, adc=AdcParameters(record_samples=40_000))
    with pytest.raises(ConfigurationError, match="shorten the record"):
        shoot(make_bench(long), key())


def strikes_after(shot, utc_ns):
    """Two positions of ten shots 4 s apart, every half hour."""
    order = [(position, index) for position in ("B", "D") for index in range(10)]
    slot = order.index((shot.position, shot.shot_index)) + 1
    set_index, start_ns = shot.set_index, utc_ns - (slot - 1) * 4 * NS_PER_S
    while True:
        for number, (position, index) in enumerate(order[slot:], slot):
            yield key(index, set_index, position), start_ns + number * 4 * NS_PER_S
        set_index, start_ns, slot = set_index + 1, start_ns + 1_800 * NS_PER_S, 0


class Recording:
    """Executor that logs what it was given."""

    def __init__(self, pool):
        self.pool = pool
        self.submitted = []
        self.groups = []
        self.futures = []

    def submit(self, function, strikes):
        self.groups.append([shot for shot, _ in strikes])
        self.submitted += self.groups[-1]
        self.futures.append(self.pool.submit(function, strikes))
        return self.futures[-1]


class TestAhead:
    """Records computed ahead equal those computed when read."""

    @pytest.fixture
    def executor(self):
        with ThreadPoolExecutor(max_workers=1) as pool:
            yield Recording(pool)

    @pytest.fixture
    def held(self):
        """Its only worker is busy until the test ends, so that nothing starts."""
        gate = threading.Event()
        with ThreadPoolExecutor(max_workers=1) as pool:
            pool.submit(gate.wait)
            yield Recording(pool)
            gate.set()

    def strike_all(self, bench, clock, shots, hour_h):
        """Acquire the shots 4 s apart, starting at an hour."""
        start_ns = EPOCH_NS + round(hour_h * 3600 * NS_PER_S)
        for number, shot in enumerate(shots):
            clock.now_ns = start_ns + number * 4 * NS_PER_S
            yield shoot(bench, shot)

    def test_sets_are_the_same(self, make_bench, clock, executor):
        ahead, plain = make_bench(executor=executor), make_bench()
        for set_index, hour_h in ((0, 0.5), (1, 1.0), (300, 225.0)):
            shots = [key(i, set_index, position) for position in ("B", "D") for i in range(10)]
            both = zip(
                self.strike_all(ahead, clock, shots, hour_h),
                self.strike_all(plain, clock, shots, hour_h),
                strict=True,
            )
            for first, second in both:
                assert_same(first, second)

    def test_a_set_across_an_update_of_the_wall_is_the_same(self, make_bench, clock, executor):
        ahead, plain = make_bench(executor=executor), make_bench()
        depths = set()
        for shot_index, acquired in enumerate(
            self.strike_all(ahead, clock, [key(i) for i in range(10)], 100.0 + 590.0 / 3600.0)
        ):
            depths.add(acquired.truth["depth_fraction"])
            assert_same(acquired, shoot(plain, key(shot_index)))
        assert len(depths) == 2

    def test_a_repeated_and_a_missed_shot_are_the_same(self, make_bench, executor):
        ahead, plain = make_bench(executor=executor), make_bench()
        shoot(ahead, key(0))
        assert_same(shoot(ahead, key(0, attempt=1)), shoot(plain, key(0, attempt=1)))
        ahead.digitizer.arm(key(1))
        ahead.digitizer.disarm()
        assert_same(shoot(ahead, key(2)), shoot(plain, key(2)))

    def test_the_next_shots_are_under_way_and_none_is_computed_twice(self, make_bench, clock, executor):
        bench = make_bench(executor=executor)
        shots = [key(i, j, position) for j in (0, 1) for position in ("B", "D") for i in range(10)]
        first_set = list(self.strike_all(bench, clock, shots[:20], 0.5))
        # The first was computed by its reader; at the last one those of the next set are under way.
        assert executor.submitted[:39] == shots[1:]
        assert len(executor.submitted) <= 19 + RECORDS_AHEAD
        list(self.strike_all(bench, clock, shots[20:], 1.0))
        assert len(set(executor.submitted)) == len(executor.submitted) <= 39 + RECORDS_AHEAD
        assert len(first_set) == 20

    def test_strikes_of_a_position_and_set_go_together(self, make_bench, clock, executor):
        bench = make_bench(executor=executor)
        list(self.strike_all(bench, clock, [key(i) for i in range(10)], 0.5))
        assert executor.groups[:3] == [
            [key(i) for i in range(1, 10)],
            [key(i, 0, "D") for i in range(10)],
            [key(i, 1, "B") for i in range(10)],
        ]

    def test_the_number_of_waiting_jobs_is_limited(self, make_bench, clock, held):
        bench = make_bench(executor=held)
        shoot(bench, key(0))
        assert RECORDS_AHEAD - LARGEST_GROUP < len(held.submitted) <= RECORDS_AHEAD

    def test_an_unscheduled_strike_waits_for_no_other(self, make_bench, held):
        # The worker is held up: this would never end if the strike were queued behind those to come.
        bench = make_bench(executor=held)
        shoot(bench, key(0))
        submitted = list(held.submitted)
        assert_same(shoot(bench, key(0, attempt=1)), shoot(make_bench(), key(0, attempt=1)))
        assert held.submitted == submitted  # all of them are still expected
        assert not any(future.cancelled() for future in held.futures)

    def test_strikes_no_longer_expected_are_dropped(self, make_bench, clock, held):
        bench = make_bench(executor=held)
        shoot(bench, key(0))
        n_submitted = len(held.futures)
        clock.go_to_hour(50.0)
        shoot(bench, key(0, set_index=100))
        assert all(future.cancelled() for future in held.futures[:n_submitted])
        assert held.groups[n_submitted][0] == key(1, set_index=100)
        assert not any(future.cancelled() for future in held.futures[n_submitted:])

    def test_a_group_of_which_some_are_still_expected_goes_on(self, make_bench, clock, held):
        clock.go_to_hour(0.55)
        bench = make_bench(executor=held)
        shoot(bench, key(0))
        submitted = list(held.submitted)
        # The second to fourth strike do not come; they were started together with the fifth.
        clock.now_ns += 12 * NS_PER_S
        assert_same(shoot(bench, key(3, attempt=1)), shoot(make_bench(), key(3, attempt=1)))
        assert held.submitted == submitted
        assert not any(future.cancelled() for future in held.futures)

    def test_a_disabled_position_is_expected_again_after_a_strike(self, make_bench, clock, executor):
        bench = make_bench(executor=executor)
        list(self.strike_all(bench, clock, [key(9, 0, "B")], 0.5))
        for set_index in (1, 2):  # position D stops striking
            executor.submitted.clear()
            shots = [key(i, set_index) for i in range(10)]
            list(self.strike_all(bench, clock, shots, 0.5 + 0.5 * set_index))
        assert {shot.position for shot in executor.submitted} == {"B"}
        executor.submitted.clear()
        list(self.strike_all(bench, clock, [key(0, 2, "D")], 1.6))
        assert key(0, 3, "D") in executor.submitted

    def test_an_error_of_the_worker_surfaces_at_its_own_strike(self, make_bench, clock, model, executor):
        """The third drop is one that the physics refuses; the others are none the worse."""

        class Failing:
            def shot(self, **strike):
                if strike["drop_height_m"] == bad_drop_m:
                    raise ValueError("the energy balance is off")
                return model.shot(**strike)

        plain = make_bench()
        bad_drop_m = shoot(plain, key(2)).truth["drop_height_m"]
        bench = build_bench(
            TWIN,
            clock=clock,
            epoch_utc_ns=EPOCH_NS,
            transducers={name: Transducer(chain=CHAIN, model=Failing()) for name in ("B", "D")},
            probed_thickness_m={},
            strikes_after=strikes_after,
            executor=executor,
        )
        for shot_index in range(5):
            if shot_index == 2:
                with pytest.raises(ConfigurationError, match="energy balance is off"):
                    shoot(bench, key(2))
            else:
                assert_same(shoot(bench, key(shot_index)), shoot(plain, key(shot_index)))


def quiet(twin=TWIN):
    """Return the twin without noise, scatter and drift."""
    return replace(
        twin,
        noise=NoiseParameters(enabled=False),
        scatter=ScatterParameters(scale=0.0),
        drift=DriftParameters(enabled=False),
    )


def assert_is_simulated(truth, force):
    """Check that the truth equals the model at the stored depth, drop height and tilt."""
    pulses = summarise_pulses(force)
    expected = {
        "isw_peak_n": pulses.isw_peak_n,
        "isw_time_s": 1e-6 * pulses.isw_time_us,
        "psw_peak_n": pulses.psw_peak_n,
        "psw_time_s": 1e-6 * pulses.psw_time_us,
        "tof_s": 1e-6 * pulses.tof_us,
        "amplitude_ratio": pulses.amplitude_ratio,
        "dynamic_amplitude_ratio": pulses.dynamic_amplitude_ratio,
    }
    # The requirement is 1e-6; the same numbers go in, so rounding alone is left.
    for name, value in expected.items():
        assert truth[name] == pytest.approx(value, rel=1e-9), name


@pytest.mark.parametrize("hour_h", [0.5, 150.0, 260.0])
def test_any_stored_shot_is_simulated_again_from_its_truth(make_bench, model, clock, hour_h):
    clock.go_to_hour(hour_h)
    for shot_index in range(3):
        truth = shoot(make_bench(), key(shot_index)).truth
        force = model.shot(**{n: truth[n] for n in ("depth_fraction", "drop_height_m", "tilt_rad")})
        assert_is_simulated(truth, force)


def test_the_wall_is_as_deep_as_the_hour_says(make_bench, clock):
    twin = replace(TWIN, thinning={"B": ThinningParameters(reference_h=300.0, depth_fraction=0.6)})
    bench = make_bench(twin)
    for hour_h in (0.5, 100.0, 300.0):
        clock.go_to_hour(hour_h)
        # 300 h are 0.6; the division into hours costs a few ulp.
        assert shoot(bench, key()).truth["depth_fraction"] == pytest.approx(0.002 * hour_h, rel=1e-12)
        assert shoot(bench, key(position="D")).truth["depth_fraction"] == 0.0


def test_echo_noise_is_averaged_keyed_and_switched_off(make_bench):
    def volts(twin, set_index=0):
        return (
            make_bench(twin)
            .pulse_echo.acquire(key(position="A", set_index=set_index), TIMEOUT_S)
            .waveform.volts()
        )

    clean = volts(quiet())
    np.testing.assert_array_equal(clean, volts(quiet(), set_index=1))
    noise_v = volts(replace(TWIN, echo=SMOOTH)) - clean  # a sound wall, smooth or not; no bubbles
    n = noise_v.size
    code_v = TWIN.echo.range_v / 2**13
    expected_v = np.hypot(TWIN.echo.noise_rms_v / np.sqrt(TWIN.echo.averages), code_v / np.sqrt(6.0))
    # Averaged noise plus the rounding of two records; four standard errors.
    assert noise_v.std() == pytest.approx(expected_v, rel=4.0 / np.sqrt(2 * n))
    np.testing.assert_array_equal(volts(TWIN), volts(TWIN))
    assert not np.array_equal(volts(TWIN), volts(TWIN, set_index=1))
    assert not np.array_equal(volts(TWIN), volts(replace(TWIN, seed=2)))


def set_means(model, scatter, n_sets):
    """Time of flight, amplitude ratio and incident volts of sets of ten shots: shape (3, n_sets)."""
    twin = replace(TWIN, scatter=scatter, drift=DriftParameters(enabled=False), seed=11)
    specimen = build_specimen(
        twin, transducers={"D": Transducer(chain=CHAIN, model=model)}, probed_thickness_m={}
    )
    wall = specimen.walls["D"].at(0.0)
    table = np.empty((3, n_sets, 10))
    for i, j in np.ndindex(n_sets, 10):
        strike = specimen.strike(key(j, i, "D"), 0.0)
        force = specimen.force(wall, strike, "D")
        pulses = summarise_pulses(force)
        incident_v = strike.sensor_gain_v_per_n * (pulses.isw_peak_n - force.preload_n)
        table[:, i, j] = pulses.tof_us, pulses.amplitude_ratio, incident_v
    return table.mean(axis=2)


@pytest.fixture(scope="module")
def usual_means(model):
    return set_means(model, ScatterParameters(), 150)


def relative_sd(means):
    return means.std(axis=1, ddof=1) / means.mean(axis=1)


def test_the_scatter_of_baseline_sets_has_the_size_assumed(usual_means):
    n_sets = usual_means.shape[1]
    # A standard deviation of n sets is known to 1 / sqrt(2 n) of itself, here 6 %; four of these, and
    # 10 % for "about" in what we size for.
    np.testing.assert_allclose(
        relative_sd(usual_means), [0.005, 0.025, 0.05], rtol=4.0 / np.sqrt(2 * n_sets) + 0.1
    )
