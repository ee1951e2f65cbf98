"""Simulate what a set of shots of an array knows about the wall, and sets of an array to confirm it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from analysis.errors import AnalysisError, InvalidInputError
from analysis.statistics.design import DAYS_PER_YEAR
from analysis.wall import array_design
from analysis.wall.bank import FEATURES
from analysis.waves.features import ShotFeatures, extract_all
from analysis.waves.record_reduction import ExtractionSettings, FloatArray, minimum_after_isw_s
from analysis.waves.transducer import find_obstacles, settings_of_chain
from daq_service.acquisition.shot_features import describe_chain
from daq_service.assessment.wall_bank import compute_mean_loss
from daq_service.catalogue.rows import FeatureRow
from daq_service.cli.offline.twin_line import simulate_assessed_sets
from daq_service.settings.tree import Settings
from hardware_drivers.measurement import Waveform
from simulator.chain.contact_pressure import peak_pressures_pa, yield_pressures_pa
from simulator.chain.spheres import Contacts
from simulator.electronics.transduction import make_adc_calibration, simulate_triggered_record
from simulator.errors import SimulatorError
from simulator.experiment.seating import compute_source_effects
from simulator.parameters.chain import ChainParameters
from simulator.parameters.experiment import ThinningParameters, TwinParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.shot.model import Impact, ShotModel
from simulator.shot.pulse_summary import summarise_pulses
from simulator.specimen import Transducer, build_specimen
from simulator.zener.model import compute_reflection

DEPTHS = (0.05, 0.1, 0.25, 0.5)
"""Depths of the patch at which d' is computed; the first two are those of every table."""
CHECKED_SHOTS = 24
"""Scattered shots at a sound wall and each of the larger depths that are checked for flags."""
NOISE_RECORDS = 32
"""Records of one shot, from which the covariance of the electronic noise is estimated."""
RANGE_FRACTION = 0.5
"""Height of the incident wave over the digitizer's range: the gain is set so."""
FEWEST_VALID, FEWEST_VALID_OF_SETS = 0.98, 0.9
"""Fraction of shots that must be valid: with one source moved, and in sets with all that disturbs a shot."""
CONFIRMED_SETS = 48
"""Healthy and thinned sets per seed: a baseline of a day at two sets an hour."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Site:
    """Where arrays are compared: a position with its plate and patch.

    Attributes
    ----------
    loss_m
        Loss of the estimand at `DEPTHS`, shape (4,).
    required_distance
        d' that one set detects at the alarm's budget.
    """

    settings: Settings
    position: str
    plate: PlateParameters
    corrosion: CorrosionParameters
    model: ShotModel
    loss_m: FloatArray
    required_distance: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Design:
    """Array of spheres and what a set of its shots knows about the wall.

    Attributes
    ----------
    twin
        Record and gain that fit its waves.
    inelasticity, predicted_slope
        Zener's lambda, and the law's change of ln AR by the loss as a fraction of the wall.
    pressure_pa, yield_ratio, amplitude_ratio
        Largest pressure at the plate, largest one between spheres over that of first yield, and AR without
        static force; NaN if not simulated.
    distances
        d' of a set at `DEPTHS`, shape (4,); NaN where there is no reflected wave.
    confirmed
        d' at the first two depths from simulated sets; None if there are none.
    refused
        Why it cannot be used, each with number and limit; empty: it can.
    """

    name: str
    chain: ChainParameters
    twin: TwinParameters
    inelasticity: float = math.inf
    predicted_slope: float = 0.0
    pressure_pa: float = math.nan
    yield_ratio: float = math.nan
    amplitude_ratio: float = math.nan
    distances: tuple[float, ...] = (math.nan,) * len(DEPTHS)
    confirmed: tuple[float, ...] | None = None
    refused: tuple[str, ...] = ()


def build_site(settings: Settings, position: str) -> Site:
    """Build a site; raise SimulatorError for a plate or patch that the twin cannot simulate."""
    place = settings.positions[position]
    plate, patch = place.plate, place.corrosion
    sets_per_year = 24.0 / settings.schedule.phases[-1].interval_h * DAYS_PER_YEAR
    rate = settings.false_alarms_per_sensor_year() / sets_per_year
    return Site(
        settings=settings,
        position=position,
        plate=plate,
        corrosion=patch,
        model=ShotModel(place.chain, plate, patch),
        loss_m=np.array(DEPTHS) * compute_mean_loss(patch) * plate.thickness_m,
        required_distance=array_design.compute_detectable_distance(CONFIRMED_SETS, len(FEATURES), rate),
    )


def predict_design(site: Site, name: str, chain: ChainParameters) -> Design:
    """Predict an array by Zener's model and the law, without a simulation."""
    design = Design(name=name, chain=chain, twin=site.settings.twin)
    plate, description = replace(site.plate, liquid=None), describe_chain(chain)
    try:
        settings = settings_of_chain(description)
        inelasticity = compute_reflection(replace(chain, precompression_n=0.0), plate).inelasticity
    except (SimulatorError, AnalysisError) as error:
        return replace(design, refused=(str(error),))
    patch_kg = plate.density_kg_per_m3 * plate.thickness_m * site.corrosion.size_m**2
    return replace(
        design,
        inelasticity=inelasticity,
        predicted_slope=array_design.predict_ratio_slope(inelasticity, chain.mass_kg, patch_kg),
        refused=tuple(
            find_obstacles(description, settings, inelasticity=inelasticity, amplitude_ratio=math.inf)
        ),
    )


def simulate_design(site: Site, design: Design, largest_pa: float = math.inf) -> Design:
    """Simulate pressure, waves and information of a predicted array; refuse it with numbers.

    ``largest_pa`` is the bound of the peak pressure at the plate.
    """
    chain, model, description = (
        design.chain,
        site.model.with_chain(design.chain),
        describe_chain(design.chain),
    )
    try:
        settings = settings_of_chain(description)
        force = model.shot(tilt_rad=_mean_tilt_rad(design), contact_forces=True)
        pulses = summarise_pulses(force)
        pressures_pa = peak_pressures_pa(chain, site.plate, np.asarray(force.contact_force_n))
        design = replace(
            design,
            pressure_pa=float(pressures_pa[-1]),
            yield_ratio=float((pressures_pa / yield_pressures_pa(chain, site.plate))[:-1].max()),
            amplitude_ratio=pulses.dynamic_amplitude_ratio or 0.0,
            twin=fit_recorder(design, settings, pulses.isw_peak_n - force.preload_n),
        )
        waves = {"inelasticity": design.inelasticity, "amplitude_ratio": design.amplitude_ratio}
        refused = find_obstacles(description, settings, **waves)
        if design.pressure_pa > largest_pa:
            values_gpa = f"{1e-9 * design.pressure_pa:.3g} GPa, above {1e-9 * largest_pa:.3g} GPa"
            refused.append(f"peak pressure at the plate {values_gpa}")
        distances, flags = _compute_information(site, design, model, settings)
        return replace(design, distances=distances, refused=(*refused, *flags))
    except (SimulatorError, AnalysisError, ValueError) as error:
        return replace(design, refused=(*design.refused, str(error)))


def fit_recorder(design: Design, settings: ExtractionSettings, isw_n: float) -> TwinParameters:
    """Return the twin with a record long enough for an array's waves, and the incident one at half the range.

    ``isw_n`` is the height of the incident wave.
    """
    adc, sensor = design.twin.adc, design.twin.sensor
    before = max(adc.pretrigger_samples, math.ceil(adc.pretrigger_samples * settings.stretch))
    after_s = minimum_after_isw_s(settings) + 2.0 * settings.isw_fwhm_s
    samples = max(adc.record_samples, before + math.ceil(after_s * adc.sample_rate_hz))
    height_n = isw_n * math.exp(-sensor.tilt_loss_per_rad * _mean_tilt_rad(design))
    return replace(
        design.twin,
        adc=replace(adc, record_samples=samples, pretrigger_samples=before),
        sensor=replace(sensor, sensitivity_v_per_n=float(f"{RANGE_FRACTION * adc.range_v / height_n:.3g}")),
    )


def _mean_tilt_rad(design: Design) -> float:
    """Return the mean tilt of the sensor disk."""
    return design.chain.tilt_rad + design.twin.scatter.mean_tilt_rad


def _list_sources(twin: TwinParameters, chain: ChainParameters) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return effects, SDs of a set and SDs of a shot of all sources of scatter, as `seating.Sources`."""
    scatter, rows = twin.scatter, 2 * chain.bodies + 3
    effect = np.eye(rows)[:, [rows - 3, rows - 1]]
    set_sd = scatter.scale * np.array([scatter.set_drop_height_sd_fraction, scatter.set_tilt_sd_rad])
    shot_sd = scatter.scale * np.array([scatter.shot_drop_height_sd_fraction, scatter.shot_tilt_sd_rad])
    if twin.nuisance != "none":
        sources = compute_source_effects(twin.nuisance, chain)
        effect = np.hstack([effect, sources.effect])
        set_sd, shot_sd = np.append(set_sd, sources.set_sd), np.append(shot_sd, sources.shot_sd)
    is_there = set_sd + shot_sd > 0.0
    return effect[:, is_there], set_sd[is_there], shot_sd[is_there]


def _compute_information(
    site: Site, design: Design, model: ShotModel, settings: ExtractionSettings
) -> tuple[tuple[float, ...], list[str]]:
    """Compute d' at `DEPTHS` from shots with each source moved, and find flagged shots."""
    effect, set_sd, shot_sd = _list_sources(design.twin, design.chain)
    scaled = (effect * np.hypot(set_sd, shot_sd)).T
    moved = array_design.QUADRATURE_SD * scaled
    checked = np.repeat((0.0, *DEPTHS[2:]), CHECKED_SHOTS)
    still = np.zeros((1 + len(DEPTHS) + NOISE_RECORDS, len(effect)))
    scattered = np.random.default_rng(0).standard_normal((checked.size, len(scaled))) @ scaled
    places = np.vstack([-moved, moved, still, scattered])
    depths = np.concatenate([np.zeros(2 * len(moved) + 1), DEPTHS, np.zeros(NOISE_RECORDS), checked])
    # One realization of the noise where a source is moved: it cancels in differences.
    seeds = np.maximum(0, np.arange(len(places)) - 2 * len(moved) - len(DEPTHS))
    shots = _simulate_shots(design, model, settings, places, depths, seeds)
    logs = _take_logs(shots)
    ends = np.cumsum([len(moved), len(moved), 1, len(DEPTHS), NOISE_RECORDS])
    low, high, middle, thinned, noisy, _ = np.split(logs, ends)
    per_set = site.settings.schedule.shots_per_set
    sources = array_design.compute_set_covariance(
        low, middle[0], high, set_sd=set_sd, shot_sd=shot_sd, shots=per_set
    )
    covariance = sources + np.cov(noisy.T) / per_set
    distances = array_design.compute_distances(thinned - middle, covariance)
    if math.isnan(distances[0]):
        raise InvalidInputError(f"no reflected wave at a loss of {100.0 * DEPTHS[0]:g} %")
    flags = [shot.flags for shot in shots if not shot.valid]
    return tuple(distances.tolist()), find_flagged(flags, len(shots), FEWEST_VALID)


def _take_logs(rows: Sequence[ShotFeatures | FeatureRow]) -> FloatArray:
    """Return the logarithms of the features, shape (n, 5); NaN where there is none or it is not positive."""
    values = np.array([[getattr(row, name) or math.nan for name in FEATURES] for row in rows])
    return np.asarray(np.log(np.where(values > 0.0, values, math.nan)))


def find_flagged(flags: Sequence[Sequence[str]], n_shots: int, fewest_valid: float) -> list[str]:
    """Find that too many shots are not valid, from the flags of each that is not; empty if not."""
    if n_shots - len(flags) >= fewest_valid * n_shots:
        return []
    names = ", ".join(sorted(set(itertools.chain.from_iterable(flags))))
    largest = 100.0 * (1.0 - fewest_valid)
    return [f"{len(flags)} of {n_shots} simulated shots are not valid ({names}), at most {largest:.0f} %"]


def _simulate_shots(
    design: Design,
    model: ShotModel,
    settings: ExtractionSettings,
    places: FloatArray,
    depths: FloatArray,
    seeds: FloatArray,
) -> list[ShotFeatures]:
    """Simulate records of strikes and extract their features, in their order.

    Parameters
    ----------
    places
        What moves each strike, as `seating.Seat.place`, shape (n_shots, 2 n_bodies + 3).
    depths, seeds
        Depth of the patch, and seed of the noise, shape (n_shots,).
    """
    chain, twin, n = design.chain, design.twin, design.chain.bodies
    tilts = np.abs(_mean_tilt_rad(design) + places[:, -1])
    impacts = [
        Impact(
            depth_fraction=depth,
            drop_height_m=chain.drop_height_m * math.exp(place[2 * n]),
            tilt_rad=tilt,
            contacts=Contacts(stiffness_factor=np.exp(place[:n]), damping_factor=np.exp(place[n : 2 * n])),
        )
        for place, depth, tilt in zip(places, depths.tolist(), tilts.tolist(), strict=True)
    ]
    calibration = make_adc_calibration(twin.adc)
    gains = np.exp(places[:, 2 * n + 1] - twin.sensor.tilt_loss_per_rad * tilts)
    waveforms = []
    for force, gain, seed in zip(model.shots(impacts), gains.tolist(), seeds.tolist(), strict=True):
        record = simulate_triggered_record(
            force_step_s=float(force.time_s[-1]) / (force.time_s.size - 1),
            dynamic_force_n=force.force_n - force.preload_n,
            sensor_gain_v_per_n=twin.sensor.sensitivity_v_per_n * gain,
            adc=twin.adc,
            calibration=calibration,
            noise=twin.noise,
            random=np.random.default_rng(seed),
        )
        if record is None:
            raise InvalidInputError("the incident wave does not reach adc.trigger_level_v")
        waveforms.append(
            Waveform(
                counts=record.counts,
                sample_rate_hz=twin.adc.sample_rate_hz,
                pretrigger_samples=twin.adc.pretrigger_samples,
                calibration=calibration,
            )
        )
    return extract_all(waveforms, settings)


def confirm_design(site: Site, design: Design, seeds: Sequence[int]) -> Design:
    """Simulate sets of an array with all noise, through the recorder's functions; refuse it with numbers.

    Sets are simulated at a sound wall and at the first two depths of `DEPTHS`, `CONFIRMED_SETS` per seed.
    """
    place = site.settings.positions[site.position].model_copy(update={"chain": design.chain})
    settings = site.settings.model_copy(update={"positions": {site.position: place}})
    model = ShotModel(design.chain, site.plate, site.corrosion)
    transducers = {site.position: Transducer(chain=design.chain, model=model)}
    flags: list[Sequence[str]] = []
    n_shots = 0

    def simulate_sets(seed: int, depth: float) -> FloatArray:
        """Return the log features of the sets of a seed, shape (n, 5), and count their shots."""
        nonlocal n_shots
        thinning = {site.position: ThinningParameters(history=((0.0, depth),))}
        twin = replace(design.twin, seed=seed, thinning=thinning, faults={})
        specimen = build_specimen(twin, transducers=transducers, probed_thickness_m={})
        sets = simulate_assessed_sets(settings.model_copy(update={"twin": twin}), site.position, specimen)
        found = list(itertools.islice(sets, CONFIRMED_SETS))
        for one in found:
            n_shots += len(one.shots)
            flags.extend(one.position_result.shot_flags[number] for number in one.position_result.invalid)
        logs = np.full((CONFIRMED_SETS, len(FEATURES)), math.nan)
        logs[: len(found)] = _take_logs([one.position_result.features[-1] for one in found])
        return logs

    try:
        sound, *thinned = [[simulate_sets(seed, depth) for seed in seeds] for depth in (0.0, *DEPTHS[:2])]
        confirmed = array_design.estimate_distances(sound, thinned)
    except (SimulatorError, AnalysisError, ValueError) as error:
        return replace(design, refused=(*design.refused, f"sets: {error}"))
    flagged = find_flagged(flags, n_shots, FEWEST_VALID_OF_SETS)
    return replace(design, confirmed=tuple(confirmed.tolist()), refused=(*design.refused, *flagged))
