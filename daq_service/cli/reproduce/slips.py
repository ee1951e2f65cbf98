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
from daq_service.cli.reproduce.paper_values import printed_number
from daq_service.cli.reproduce.texts import TEXTS, Slip
from simulator.chain.hertz_contact import indentation_m, sphere_on_flat_stiffness, sphere_on_sphere_stiffness
from simulator.materials import bending_stiffness_n_m, plane_modulus_pa, shear_modulus_pa
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, LiquidParameters, PlateParameters
from simulator.zener.model import amplitude_ratio, approximate_restitution
from simulator.zener.table_2 import compute_table_2

_SPHERE, _DISK = ChainParameters(sensor="sphere"), ChainParameters(sensor="disk")
_PLATE, _PATCH = PlateParameters(), CorrosionParameters()
_FREE = replace(_SPHERE, damping_n_s_per_m=0.0, contact_damping_n_s_per_m=0.0, gravity_m_per_s2=0.0)
_WALL, _THIN = PlateParameters(model="rigid_wall"), PlateParameters(model="infinite_kirchhoff")
_WATER = LiquidParameters(depth_m=0.3)
"""About half the plate's height (half immersed); more than some centimeters change nothing."""
_Numbers = Mapping[str, object]


def _remove_chain_damping(chain: ChainParameters) -> ChainParameters:
    """Return the parameters of the chain with both damping coefficients 0."""
    return replace(chain, damping_n_s_per_m=0.0, contact_damping_n_s_per_m=0.0)


def _build_pristine_shot_job(chain: ChainParameters, plate: PlateParameters = _PLATE) -> Job:
    """Create the job that simulates one shot on the plate without corrosion."""
    return Job(function=models.compute_pulses_over_depth, arguments=(chain, plate, _PATCH, (0.0,)))


def _build_element_shot_job(size_m: float) -> Job:
    """Create the job that simulates one shot with a contact element of this size, m."""
    return _build_pristine_shot_job(_DISK, replace(_PLATE, contact_element_m=size_m))


_CANDIDATES: Mapping[str, tuple[str, Job]] = {
    "sphere": ("sensor a sphere", _build_pristine_shot_job(_SPHERE)),
    "disk": ("sensor two disks", _build_pristine_shot_job(_DISK)),
    "sphere_undamped": (
        "sphere, no dashpots (eq. 1 as printed)",
        _build_pristine_shot_job(_remove_chain_damping(_SPHERE)),
    ),
    "disk_undamped": (
        "disks, no dashpots (eq. 1 as printed)",
        _build_pristine_shot_job(_remove_chain_damping(_DISK)),
    ),
    "sphere_wall": ("sphere, rigid wall", _build_pristine_shot_job(_SPHERE, _WALL)),
    "disk_wall": ("disks, rigid wall", _build_pristine_shot_job(_DISK, _WALL)),
    "sphere_thin": ("sphere, infinite thin plate", _build_pristine_shot_job(_SPHERE, _THIN)),
    "disk_thin": ("disks, infinite thin plate", _build_pristine_shot_job(_DISK, _THIN)),
    "disk_nu": ("disks, nu of the chain 0.28", _build_pristine_shot_job(replace(_DISK, poisson_ratio=0.28))),
    "element_1_mm": ("disks, contact element 1 mm", _build_element_shot_job(1e-3)),
    "element_10_um": ("disks, contact element 0.01 mm", _build_element_shot_job(1e-5)),
}
"""Settings compatible with the paper, and limiting cases, compared with its 319 us and 0.837."""
_JOBS = {
    **{name: job for name, (_, job) in _CANDIDATES.items()},
    "element_100_um": _build_element_shot_job(1e-4),
    "free_wall": _build_pristine_shot_job(_FREE, _WALL),
    "disk_gamma": _build_pristine_shot_job(replace(_DISK, contact_damping_n_s_per_m=STRONG_GAMMA_N_S_PER_M)),
    "disk_wet": _build_pristine_shot_job(_DISK, replace(_PLATE, liquid=_WATER)),
    "disk_depths": Job(function=models.compute_pulses_over_depth, arguments=(_DISK, _PLATE, _PATCH, DEPTHS)),
    "zener_wall": Job(function=models.compute_zener_on_thickness, arguments=(1.0,)),
}


class _Values(dict[str, object]):
    """What a sentence names: the numbers of a finding, else the first pulse of the job of this name."""

    def __init__(self, material: Material, numbers: Mapping[str, object]) -> None:
        """Store the numbers of a finding, and the material whose jobs give missing names."""
        super().__init__(numbers)
        self._material = material

    def __missing__(self, name: str) -> models.Pulse:
        """Return the first shot of the job with this name; raise as `_find_shot`."""
        return _find_shot(self._material, name)


def _find_shot(material: Material, name: str) -> models.Pulse:
    """Return the first shot of the simulation job with this name; raise NotAvailableError if it failed."""
    shot: models.Pulse = material.result(name)[0]
    return shot


def _percent_change(new: float, old: float) -> float:
    """Compute the relative change from an old to a new value, %."""
    return 100.0 * (new / old - 1.0)


def _compute_sphere_overlap(material: Material) -> _Numbers:
    """Compute the overlap of two spheres at the peak of the incident wave, in m and um.

    Raises NotAvailableError if the job failed.
    """
    overlap_m = indentation_m(
        _find_shot(material, "sphere").isw_peak_n,
        sphere_on_sphere_stiffness(_SPHERE.radius_m, _SPHERE.youngs_modulus_pa, _SPHERE.poisson_ratio),
    )
    return {"overlap_m": overlap_m, "overlap_um": 1e6 * overlap_m}


def _compute_contact_stiffness(_: Material) -> _Numbers:
    """Compute the stiffness of sphere and plate as printed, and correctly in N/m^(3/2)."""
    E, nu, radius = _PLATE.youngs_modulus_pa, _PLATE.poisson_ratio, _SPHERE.radius_m
    as_printed = 4.0 * math.sqrt(radius) / 3.0 * 2.0 / plane_modulus_pa(E, nu)
    return {"as_printed": as_printed, "right": sphere_on_flat_stiffness(radius, E, nu, E, nu)}


def _compute_shear_moduli(_: Material) -> _Numbers:
    """Compute the plate's shear modulus in GPa as printed and with the factor 2 in the denominator."""
    E, nu = _PLATE.youngs_modulus_pa, _PLATE.poisson_ratio
    return {"printed_gpa": E / (1.0 + nu) / 1e9, "right_gpa": shear_modulus_pa(E, nu) / 1e9}


def _find_nearest_candidate(material: Material) -> _Numbers:
    """Find the setting or limit whose ToF and AR together are nearest to the paper's.

    Raises NotAvailableError if a job failed.
    """
    tof_us, ar = printed_number("fig12", "sphere_tof"), printed_number("fig12", "sphere_ar")
    candidates = {label: _find_shot(material, name) for name, (label, _) in _CANDIDATES.items()}

    def distance_to_paper(shot: models.Pulse) -> float:
        """Compute the relative distance of a shot from the paper's ToF and AR."""
        return math.hypot(shot.tof_us / tof_us - 1.0, shot.amplitude_ratio / ar - 1.0)

    label, nearest = min(candidates.items(), key=lambda item: distance_to_paper(item[1]))
    numbers = {"n": len(candidates), "tof_us": tof_us, "ar": ar, "label": label, "nearest": nearest}
    # A linear element of length L = 2 h in pure bending, fully integrated: 1 + kappa (1 - nu) / 2 (L / h)^2.
    return {**numbers, "locked": 1.0 + 5.0 / 6.0 * (1.0 - _PLATE.poisson_ratio) / 2.0 * 2.0**2}


def _check_monotonicity(material: Material) -> _Numbers:
    """Find the depth with the minimal amplitude ratio, and whether the ToF rises with each depth.

    Raises NotAvailableError if the job failed.
    """
    shots: list[models.Pulse] = material.result("disk_depths")
    minimum = min(shots, key=lambda shot: shot.amplitude_ratio)
    rises = all(after.tof_us > before.tof_us for before, after in pairwise(shots))
    return {
        "first": shots[0],
        "minimum": minimum,
        "last": shots[-1],
        "minimum_percent": 100 * minimum.depth_fraction,
        "last_percent": 100 * shots[-1].depth_fraction,
        "tof": "rises throughout" if rises else "is not monotonic either",
    }


def _compare_equation_13(material: Material) -> _Numbers:
    """Compare the time of flight of eq. 13 in us with that of the simulated wall; the difference in %.

    Raises NotAvailableError if a job failed.
    """
    equation_us = 1e6 * material.result("zener_wall").tof_s
    return {
        "equation_us": equation_us,
        "more": _percent_change(equation_us, _find_shot(material, "free_wall").tof_us),
    }


def _compute_false_alarm_rates(material: Material) -> _Numbers:
    """Compute the false-alarm rate of the limit mean + 3 SD for each baseline, as sentences.

    Raises NotAvailableError if no baseline has such a limit.
    """
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
    return {"baselines": "; ".join(sentences)}


def _compute_row_5_ratios(_: Material) -> _Numbers:
    """Compute AR of row 5 of table 2 from its printed restitution, and by eq. 10 from its printed lambda."""
    rounded_e, inelasticity = (
        printed_number("table2", "restitution_5"),
        printed_number("table2", "inelasticity_5"),
    )
    return {
        "row": compute_table_2()[4],
        "rounded_e": rounded_e,
        "of_rounded": amplitude_ratio(rounded_e),
        "of_printed": amplitude_ratio(approximate_restitution(inelasticity)),
    }


def _compute_wall_losses(_: Material) -> _Numbers:
    """Compare the wall losses of the ultrasonic reading and of the core, mm and %."""
    initial, read, core = (printed_number("fig15", name) for name in ("initial", "thickness_300", "core"))
    end_h = printed_number("table1", "end")
    return {
        "initial": initial,
        "read": read,
        "read_percent": -_percent_change(read, initial),
        "core_percent": -_percent_change(core, initial),
        "line": initial - (initial - read) / 300.0 * end_h,
        "end_h": end_h,
    }


def _compute_energy_ratio(_: Material) -> _Numbers:
    """Compute the energy ratio that the measured amplitude ratio implies, AR^(5/3)."""
    ar = printed_number("fig12", "ar_measured")
    return {"ar": ar, "energy": ar ** (5.0 / 3.0)}


def _compute_dashpot_shift(material: Material) -> _Numbers:
    """Compute the shift of the time of flight that a strong dashpot causes, us and %.

    Raises NotAvailableError if a job failed.
    """
    weak_us, strong_us = _find_shot(material, "disk").tof_us, _find_shot(material, "disk_gamma").tof_us
    gamma = STRONG_GAMMA_N_S_PER_M
    return {"gamma": gamma, "shift_us": strong_us - weak_us, "shift": _percent_change(strong_us, weak_us)}


def _compute_added_mass_ratios(_: Material) -> _Numbers:
    """Compute the added mass of a half-space of liquid on a bending plate, rho_w / k per area.

    Returned as a text of percentages of the plate's mass per area at 5 and 10 kHz.
    """
    surface = _PLATE.density_kg_per_m3 * _PLATE.thickness_m
    bending = bending_stiffness_n_m(_PLATE.youngs_modulus_pa, _PLATE.poisson_ratio, _PLATE.thickness_m)
    ratios = []
    for frequency_hz in (5e3, 10e3):
        stiff = (2.0 * math.pi * frequency_hz) ** 2 / bending
        # D k^4 = omega^2 (rho h + rho_w / k), by repeated substitution; it contracts like k^(-1/4).
        k = (stiff * surface) ** 0.25
        for _repetition in range(50):
            k = (stiff * (surface + _WATER.density_kg_per_m3 / k)) ** 0.25
        ratios.append(f"{100 * _WATER.density_kg_per_m3 / k / surface:.0f} % at {frequency_hz / 1e3:g} kHz")
    return {"ratios": ", ".join(ratios), "depth_m": _WATER.depth_m}


_FINDINGS: Mapping[str, Callable[[Material], _Numbers]] = {
    "dashpot": _compute_sphere_overlap,
    "bracket": _compute_contact_stiffness,
    "shear": _compute_shear_moduli,
    "locking": _find_nearest_candidate,
    "not_monotonic": _check_monotonicity,
    "equation_13": _compare_equation_13,
    "thresholds": _compute_false_alarm_rates,
    "row_5": _compute_row_5_ratios,
    "thinner": _compute_wall_losses,
    "energy": _compute_energy_ratio,
    "gamma": _compute_dashpot_shift,
    "salt_water": _compute_added_mass_ratios,
}
"""Numbers of the sentences that name more than pulses."""
SLIPS = TEXTS.slips


def build_slip_table(material: Material) -> Product:
    """Build the table of the paper's slips with our finding, or the reason why there is none here."""
    columns = {
        "where": [slip.where for slip in SLIPS],
        "printed": [slip.prints for slip in SLIPS],
        "right": [slip.right for slip in SLIPS],
        "finding": [_compose_finding(slip, material) for slip in SLIPS],
    }
    return Product(tables={"": Table(columns=columns)})


def _compose_finding(slip: Slip, material: Material) -> str:
    """Compose the sentence with our finding on a slip, or the reason why it is not available.

    Raises KeyError if the sentence names an unknown job.
    """
    try:
        numbers = _FINDINGS[slip.finding](material) if slip.finding else {}
        return slip.sentence.format_map(_Values(material, numbers))
    except NotAvailableError as error:
        return f"not available: {error}"


SLIP_LIST = Item(name="slips", make=build_slip_table, jobs=_JOBS)
