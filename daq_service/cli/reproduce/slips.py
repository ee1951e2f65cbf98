"""Slips of the paper, each with what is right and with our finding, computed where it can be."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise

from analysis.errors import AnalysisError
from analysis.statistics.limits import false_alarm_rate
from daq_service.cli.reproduce import models
from daq_service.cli.reproduce.item import Item, Job, Material, NotAvailableError, Product, Table
from daq_service.cli.reproduce.model_figures import DEPTHS, STRONG_GAMMA_N_S_PER_M
from daq_service.cli.reproduce.paper_values import printed
from daq_service.cli.reproduce.texts import TEXTS, Slip
from simulator.chain.hertz_contact import indentation_m, sphere_on_flat_stiffness, sphere_on_sphere_stiffness
from simulator.materials import bending_stiffness_n_m, plane_modulus_pa, shear_modulus_pa
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, LiquidParameters, PlateParameters
from simulator.zener.model import amplitude_ratio, approximate_restitution

_SPHERE, _DISK = ChainParameters(sensor="sphere"), ChainParameters(sensor="disk")
_PLATE, _PATCH = PlateParameters(), CorrosionParameters()
_FREE = replace(_SPHERE, damping_n_s_per_m=0.0, contact_damping_n_s_per_m=0.0, gravity_m_per_s2=0.0)
_WALL, _THIN = PlateParameters(model="rigid_wall"), PlateParameters(model="infinite_kirchhoff")
_WATER_DEPTH_M = 0.3
"""About half the plate's height (half immersed); beyond some centimetres it no longer matters."""
_WATER = LiquidParameters(depth_m=_WATER_DEPTH_M)
_PRISTINE = (0.0,)


def _undamped(chain: ChainParameters) -> ChainParameters:
    """Return the chain without dashpots."""
    return replace(chain, damping_n_s_per_m=0.0, contact_damping_n_s_per_m=0.0)


def _shot(chain: ChainParameters, plate: PlateParameters = _PLATE) -> Job:
    """Return the simulation of one shot on the pristine plate."""
    return Job(function=models.pulses_over_depth, arguments=(chain, plate, _PATCH, _PRISTINE))


def _on_element(size_m: float) -> Job:
    """Return the simulation of one shot with the contact on an element of this size."""
    return _shot(_DISK, replace(_PLATE, contact_element_m=size_m))


_CANDIDATES: Mapping[str, tuple[str, Job]] = {
    "sphere": ("sensor a sphere", _shot(_SPHERE)),
    "disk": ("sensor two disks", _shot(_DISK)),
    "sphere_undamped": ("sphere, no dashpots (eq. 1 as printed)", _shot(_undamped(_SPHERE))),
    "disk_undamped": ("disks, no dashpots (eq. 1 as printed)", _shot(_undamped(_DISK))),
    "sphere_wall": ("sphere, rigid wall", _shot(_SPHERE, _WALL)),
    "disk_wall": ("disks, rigid wall", _shot(_DISK, _WALL)),
    "sphere_thin": ("sphere, infinite thin plate", _shot(_SPHERE, _THIN)),
    "disk_thin": ("disks, infinite thin plate", _shot(_DISK, _THIN)),
    "disk_nu": ("disks, nu of the chain 0.28", _shot(replace(_DISK, poisson_ratio=0.28))),
    "element_0.001": ("disks, contact element 1 mm", _on_element(1e-3)),
    "element_1e-05": ("disks, contact element 0.01 mm", _on_element(1e-5)),
}
"""Settings compatible with the paper, and limiting cases, compared with its 319 us and 0.837."""
_JOBS = {
    **{name: job for name, (_, job) in _CANDIDATES.items()},
    "element_0.0001": _on_element(1e-4),
    "free_wall": _shot(_FREE, _WALL),
    "disk_gamma": _shot(replace(_DISK, contact_damping_n_s_per_m=STRONG_GAMMA_N_S_PER_M)),
    "disk_wet": _shot(_DISK, replace(_PLATE, liquid=_WATER)),
    "disk_depths": Job(function=models.pulses_over_depth, arguments=(_DISK, _PLATE, _PATCH, DEPTHS)),
    "zener_wall": Job(function=models.zener_on_thickness, arguments=(1.0,)),
}


def _one(material: Material, name: str) -> models.Pulse:
    """Return the only shot of a simulation."""
    shot: models.Pulse = material.result(name)[0]
    return shot


def _dashpot(material: Material) -> str:
    """Return the finding on the printed dashpot term."""
    overlap_m = indentation_m(
        _one(material, "sphere").isw_peak_n,
        sphere_on_sphere_stiffness(_SPHERE.radius_m, _SPHERE.youngs_modulus_pa, _SPHERE.poisson_ratio),
    )
    with_us, without = _one(material, "sphere"), _one(material, "sphere_undamped")
    return (
        f"at the wave's peak overlap of {1e6 * overlap_m:.1f} um the printed term is {overlap_m:.1e} times "
        f"the intended one, so none at all. Without dashpots the sphere chain has ToF {without.tof_us:.1f} "
        f"us and AR {without.amplitude_ratio:.3f}, with them {with_us.tof_us:.1f} us and "
        f"{with_us.amplitude_ratio:.3f}"
    )


def _bracket(_: Material) -> str:
    """Return the finding on the printed bracket of the contact stiffness."""
    E, nu, radius = _PLATE.youngs_modulus_pa, _PLATE.poisson_ratio, _SPHERE.radius_m
    as_printed = 4.0 * math.sqrt(radius) / 3.0 * 2.0 / plane_modulus_pa(E, nu)
    right = sphere_on_flat_stiffness(radius, E, nu, E, nu)
    return f"as printed {as_printed:.3g} m^2.5/N, no stiffness; with the power -1 {right:.4g} N/m^1.5"


def _shear(_: Material) -> str:
    """Return the finding on the printed shear modulus."""
    E, nu = _PLATE.youngs_modulus_pa, _PLATE.poisson_ratio
    right_gpa = shear_modulus_pa(E, nu) / 1e9
    return f"printed {E / (1.0 + nu) / 1e9:.1f} GPa; the shear modulus is {right_gpa:.1f} GPa"


def _locking(material: Material) -> str:
    """Return the finding on locking elements, from the settings that come nearest to the paper's values."""
    tof_us, ar = printed("fig12", "tof"), printed("fig12", "ar")
    candidates = {label: _one(material, name) for name, (label, _) in _CANDIDATES.items()}

    def distance(shot: models.Pulse) -> float:
        return math.hypot(shot.tof_us / tof_us - 1.0, shot.amplitude_ratio / ar - 1.0)

    label, nearest = min(candidates.items(), key=lambda item: distance(item[1]))
    return (
        f"none of {len(candidates)} settings and limits tried gives {tof_us:g} us with AR {ar:g}; nearest: "
        f"{label}, {nearest.tof_us:.1f} us with {nearest.amplitude_ratio:.3f}. Locking elements are a "
        "possible cause, unproven; the curves of figures 12 and 13 count as not reproducible"
    )


def _point_load(material: Material) -> str:
    """Return the finding on the convergence with the element at the contact."""
    shots = [
        f"{1e3 * size_m:g} mm: {shot.tof_us:.2f} us, {shot.amplitude_ratio:.4f}"
        for size_m in (1e-3, 1e-4, 1e-5)
        for shot in (_one(material, f"element_{size_m:g}"),)
    ]
    return f"ToF and AR with the element at the contact of {'; '.join(shots)}: no convergence"


def _not_monotonic(material: Material) -> str:
    """Return the finding that the amplitude ratio is not monotonic in depth."""
    shots: list[models.Pulse] = material.result("disk_depths")
    minimum = min(shots, key=lambda shot: shot.amplitude_ratio)
    first, last = shots[0], shots[-1]
    rises = all(after.tof_us > before.tof_us for before, after in pairwise(shots))
    return (
        f"AR is {first.amplitude_ratio:.3f} pristine, least ({minimum.amplitude_ratio:.3f}) at "
        f"{100 * minimum.depth_fraction:.0f} %, and {last.amplitude_ratio:.3f} at "
        f"{100 * last.depth_fraction:.0f} %: the thinned patch rebounds within the contact. ToF "
        f"{'rises throughout' if rises else 'is not monotonic either'}"
    )


def _equation_13(material: Material) -> str:
    """Return the finding on the time of flight by equation 13."""
    chain_us = _one(material, "free_wall").tof_us
    equation_us = 1e6 * material.result("zener_wall").tof_s
    return (
        f"on a rigid wall without gravity and dashpots the chain takes {chain_us:.1f} us, eq. 13 says "
        f"{equation_us:.1f} us, {100 * (equation_us / chain_us - 1):.0f} % more: the offset is not gravity "
        "or damping"
    )


def _thresholds(material: Material) -> str:
    """Return the finding on the limit mean + 3 SD and its false-alarm rate."""
    sentences = []
    for name, pulses in material.test.pulses.items():
        baseline = pulses.baseline
        if baseline is None or baseline.limit_mean_3sd is None:
            continue
        n, p = int(baseline.n_sets), len(baseline.feature_names)
        try:
            rate = false_alarm_rate(float(baseline.limit_mean_3sd), n, p)
        except AnalysisError as error:
            sentences.append(f"{name}: {error}")
            continue
        sentences.append(
            f"{name}: {baseline.limit_mean_3sd:.1f} ({100 * rate:.1f} % false alarms), exact "
            f"{baseline.limit_f_predictive:.1f}"
        )
    if not sentences:
        raise NotAvailableError("no baseline was frozen in this test")
    return f"computed from our baselines, mean + 3 SD: {'; '.join(sentences)}. It does not deliver 99.73 %"


def _row_5(_: Material) -> str:
    """Return the finding on row 5 of table 2."""
    rounded_e = printed("table2", "restitution_5")
    row = models.zeners_table()[4]
    return (
        f"lambda is {row.inelasticity:.3f}; the printed AR is that of the rounded e, {rounded_e:g}^1.2 = "
        f"{amplitude_ratio(rounded_e):.3f}; by the rule of the other rows it is {row.amplitude_ratio:.3f}, "
        "and from the printed lambda "
        f"{amplitude_ratio(approximate_restitution(printed('table2', 'inelasticity_5'))):.3f}"
    )


def _thinner(_: Material) -> str:
    """Return the finding on the thickness at the end, by probe and by core."""
    initial, read, core = (printed("fig15", name) for name in ("initial", "thickness_300", "core"))
    line = initial - (initial - read) / 300.0 * printed("table1", "end")
    return (
        f"{read:g} of {initial:g} mm is {100 * (1 - read / initial):.1f} % thinner, the core "
        f"{100 * (1 - core / initial):.1f} %. The line through {read:g} mm at 300 h reads {line:.2f} mm at "
        f"{printed('table1', 'end'):g} h: with a core taken at the end probe and core agree better than the "
        "paper says"
    )


def _poisson(material: Material) -> str:
    """Return the finding on Poisson's ratio in table 2."""
    shot, other = _one(material, "disk"), _one(material, "disk_nu")
    return (
        f"nu of spheres and disks 0.28 in place of 0.3 moves ToF from {shot.tof_us:.2f} to "
        f"{other.tof_us:.2f} us and AR from {shot.amplitude_ratio:.4f} to {other.amplitude_ratio:.4f}; Table "
        "2's digits need 0.28"
    )


def _energy(_: Material) -> str:
    """Return the finding on the energy of the measured amplitude ratio."""
    ar = printed("fig12", "ar_measured")
    return f"energy goes with F^(5/3): an AR of {ar:g} is {ar ** (5.0 / 3.0):.2f} of the energy"


def _gamma(material: Material) -> str:
    """Return the finding on the damping coefficient gamma."""
    weak, strong = _one(material, "disk"), _one(material, "disk_gamma")
    return (
        f"gamma {STRONG_GAMMA_N_S_PER_M:g} N s/m moves ToF by {strong.tof_us - weak.tof_us:+.1f} us "
        f"({100 * (strong.tof_us / weak.tof_us - 1):+.1f} %) and AR from {weak.amplitude_ratio:.3f} to "
        f"{strong.amplitude_ratio:.3f}; the paper's 20 % of ISW amplitude by 2.5 %"
    )


def _salt_water(material: Material) -> str:
    """Compute the added mass of a half-space of liquid on a bending plate, rho_w / k per area."""
    surface = _PLATE.density_kg_per_m3 * _PLATE.thickness_m
    bending = bending_stiffness_n_m(_PLATE.youngs_modulus_pa, _PLATE.poisson_ratio, _PLATE.thickness_m)
    ratios = []
    for frequency_hz in (5e3, 10e3):
        stiff = (2.0 * math.pi * frequency_hz) ** 2 / bending
        # D k^4 = omega^2 (rho h + rho_w / k), by repeated substitution; it contracts like k^(-1/4).
        k = (stiff * surface) ** 0.25
        for _ in range(50):
            k = (stiff * (surface + _WATER.density_kg_per_m3 / k)) ** 0.25
        ratios.append(f"{100 * _WATER.density_kg_per_m3 / k / surface:.0f} % at {frequency_hz / 1e3:g} kHz")
    dry, wet = _one(material, "disk"), _one(material, "disk_wet")
    return (
        f"added mass of liquid on one face over the plate's own: {', '.join(ratios)}; {_WATER_DEPTH_M:g} m "
        f"of salt solution on the plate moves our ToF from {dry.tof_us:.1f} to {wet.tof_us:.1f} us and AR "
        f"from {dry.amplitude_ratio:.3f} to {wet.amplitude_ratio:.3f}"
    )


def _nothing(_: Material) -> str:
    """Return that the slip needs no computation."""
    return "nothing to compute"


_FINDINGS: Mapping[str, Callable[[Material], str]] = {
    "dashpot": _dashpot,
    "bracket": _bracket,
    "shear": _shear,
    "locking": _locking,
    "point_load": _point_load,
    "not_monotonic": _not_monotonic,
    "equation_13": _equation_13,
    "thresholds": _thresholds,
    "row_5": _row_5,
    "thinner": _thinner,
    "poisson": _poisson,
    "energy": _energy,
    "gamma": _gamma,
    "salt_water": _salt_water,
    "nothing": _nothing,
}
SLIPS = TEXTS.slips


def make_slips(material: Material) -> Product:
    """List every slip with our finding, or why there is none in this run."""
    columns = {
        "where": [slip.where for slip in SLIPS],
        "printed": [slip.prints for slip in SLIPS],
        "right": [slip.right for slip in SLIPS],
        "finding": [_finding_of(slip, material) for slip in SLIPS],
    }
    return Product(tables={"": Table(columns=columns)})


def _finding_of(slip: Slip, material: Material) -> str:
    """Return the finding of a slip, or why there is none."""
    try:
        return _FINDINGS[slip.finding](material)
    except NotAvailableError as error:
        return f"not available: {error}"


SLIP_LIST = Item(name="slips", make=make_slips, jobs=_JOBS)
