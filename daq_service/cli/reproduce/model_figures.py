"""Figures 10, 12 and 13: Zener's impact, the influence of the incident wave, the influence of the depth."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes

from daq_service.cli.reproduce import item, models, style
from daq_service.cli.reproduce.paper_values import SENSORS, printed
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters

STRONG_GAMMA_N_S_PER_M = 1000.0
"""Dashpot between chain and plate of the paper's "modified" model."""
DEPTHS = tuple(k / 20 for k in range(17))
SOLID_DEPTHS = (0.0, 0.2, 0.4, 0.5, 0.6, 0.7, 0.8)
"""Fewer depths: the solid plate is assembled and reduced for each."""
CASE_3 = 0.258
"""Lambda of the paper's Table 2, case 3."""

_CHAINS = {sensor: ChainParameters(sensor=sensor) for sensor in ("sphere", "disk")}
_PLATE = PlateParameters()
_GRID = tuple(float(x) for x in np.linspace(0.0, 2.0, 41))


def draw_fig10(material: item.Material) -> item.Product:
    """Draw restitution and contact time over lambda."""
    columns: dict[str, list[float]] = material.result("curve")
    case_3: dict[str, list[float]] = material.result("case_3")
    figure, axes = style.sheet(1, 2, height_in=3.0)
    for axis, name, closed, equation, quantity in (
        (axes[0], "e_eq8", "e_eq10", "eq. 10", "e_case_3"),
        (axes[1], "tau_c_eq8", "tau_c_eq12", "eq. 12", "tau_c_case_3"),
    ):
        axis.plot(columns["inelasticity"], columns[name], color=style.BLUE, label="eq. 8, numerically")
        axis.plot(columns["inelasticity"], columns[closed], color=style.VERMILLION, ls="--", label=equation)
        axis.plot([CASE_3], [printed("fig10", quantity)], **style.PAPER_MARK, label="paper, Table 2 case 3")
        axis.set(xlabel="inelasticity parameter lambda (1)", xlim=(0.0, 2.0))
        axis.legend()
    axes[0].set_ylabel("coefficient of restitution e (1)")
    axes[1].set_ylabel("contact time tau_c (1)")
    style.name_panels(axes, ("restitution", "contact time"))
    return item.Product(
        drawing=figure,
        tables={"": item.Table(columns=columns)},
        found={
            "e_case_3": item.found(case_3["e_eq8"][0], "eq. 8"),
            "tau_c_case_3": item.found(case_3["tau_c_eq8"][0], "eq. 8"),
        },
        notes=(
            (
                "Largest distance of the closed forms from eq. 8: eq. 10 "
                f"{_worst(columns, 'e_eq10', 'e_eq8'):.1f} % up to lambda = 1, eq. 12 "
                f"{_worst(columns, 'tau_c_eq12', 'tau_c_eq8'):.2f} % up to 2."
            ),
        ),
    )


def _worst(columns: Mapping[str, Sequence[float]], approximate: str, exact: str) -> float:
    """Return the largest deviation of an approximation in per cent."""
    return 100.0 * float(np.nanmax(np.abs(np.divide(columns[approximate], columns[exact]) - 1.0)))


# Figure 12 --------------------------------------------------------------------------------------

_ISW_CURVES = (
    ("disk", "coupled model, sensor two disks", style.BLUE, "-"),
    ("sphere", "coupled model, sensor a sphere", style.SKY, "-"),
    ("disk_gamma", "the same disks, gamma 1,000 N s/m at the plate", style.VERMILLION, "-"),
    ("zener_eq8", "Zener, eq. 8", style.GREEN, "--"),
    ("zener_closed", "Zener, eqs 10 and 12", style.ORANGE, ":"),
)


def draw_fig12(material: item.Material) -> item.Product:
    """Draw ToF and AR over the amplitude of the incident wave."""
    curves: dict[str, list[tuple[float, float, float]]] = {}
    for name, *_ in _ISW_CURVES:
        curves[name] = [
            (ratio, shot.tof_us, shot.amplitude_ratio)
            if isinstance(shot, models.Pulse)
            else (ratio, 1e6 * shot.tof_s, shot.amplitude_ratio)
            for ratio, shot in material.result(name)
        ]
    figure, axes = style.sheet(1, 2, height_in=4.1)
    for name, label, colour, dash in _ISW_CURVES:
        ratio, tof_us, ar = (list(column) for column in zip(*curves[name], strict=True))
        axes[0].plot(ratio, tof_us, color=colour, ls=dash, label=label)
        axes[1].plot(ratio, ar, color=colour, ls=dash)
    for axis, quantities in ((axes[0], ("tof", "tof_zener")), (axes[1], ("ar", "ar_zener", "ar_measured"))):
        for quantity in quantities:
            axis.plot([1.0], [printed("fig12", quantity)], **style.PAPER_MARK)
        _band(axis, *(("tof", "tof_plus") if axis is axes[0] else ("ar", "ar_plus")))
        axis.set(xlabel="ISW amplitude over the nominal one (1)")
    axes[0].plot([], [], **style.PAPER_MARK, label="paper's values; dashed: its model's ± band")
    axes[0].set_ylabel("time of flight (µs)")
    axes[1].set_ylabel("amplitude ratio (1)")
    for axis, text, quantity, side in (
        (axes[0], "numerical", "tof", "center"),
        (axes[0], "Zener", "tof_zener", "bottom"),
        (axes[1], "numerical", "ar", "center"),
        (axes[1], "Zener", "ar_zener", "bottom"),
        (axes[1], "measured", "ar_measured", "top"),
    ):
        _name_mark(axis, text, printed("fig12", quantity), side)
    figure.legend(loc="outside lower center", ncols=2)
    style.name_panels(axes, ("time of flight", "amplitude ratio"))
    return item.Product(
        drawing=figure, tables={"": _curve_table(curves, "isw_ratio")}, found=_isw_found(curves)
    )


def _name_mark(axis: Axes, text: str, value: float, side: str) -> None:
    """Label one of the paper's values on the side without curves."""
    axis.annotate(
        text,
        (1.0, value),
        (6, {"bottom": 3, "center": 0, "top": -3}[side]),
        textcoords="offset points",
        va=side,
        fontsize=7,
    )


def _band(axis: Axes, nominal: str, spread: str) -> None:
    """Draw the paper's range around a nominal value."""
    value, percent = printed("fig12", nominal), printed("fig12", spread)
    for sign in (-1.0, 1.0):
        axis.plot([0.8, 1.2], [value * (1.0 + sign * 0.01 * percent)] * 2, **style.PAPER_LINE)


def _curve_table(curves: Mapping[str, Sequence[tuple[float, float, float]]], over: str) -> item.Table:
    """Return the points of all curves as a table."""
    rows = [(name, *point) for name, points in curves.items() for point in points]
    names = ("curve", over, "tof_us", "amplitude_ratio")
    return item.Table(
        columns=dict(zip(names, (list(column) for column in zip(*rows, strict=True)), strict=True))
    )


def _isw_found(curves: Mapping[str, Sequence[tuple[float, float, float]]]) -> dict[str, item.Found]:
    """Return our values of figure 12."""
    at = {name: {round(point[0], 6): point[1:] for point in points} for name, points in curves.items()}
    tof_us, ar = at["disk"][1.0]
    change = {
        (ratio, kind): 100.0 * (at["disk"][ratio][kind] / at["disk"][1.0][kind] - 1.0)
        for ratio in (0.8, 1.2)
        for kind in (0, 1)
    }
    strong_tof_us, strong_ar = at["disk_gamma"][1.0]
    return {
        "tof_plus": item.found(abs(change[1.2, 0]), f"{change[1.2, 0]:+.2f} %"),
        "tof_minus": item.found(abs(change[0.8, 0]), f"{change[0.8, 0]:+.2f} %"),
        "ar_plus": item.found(abs(change[1.2, 1]), f"{change[1.2, 1]:+.2f} %"),
        "ar_minus": item.found(abs(change[0.8, 1]), f"{change[0.8, 1]:+.2f} %"),
        "tof": item.found(tof_us, "sensor two disks"),
        "ar": item.found(ar, "sensor two disks"),
        "tof_zener": item.found(at["zener_eq8"][1.0][0], "eq. 8"),
        "ar_zener": item.found(at["zener_eq8"][1.0][1], "eq. 8"),
        "ar_measured": item.found(ar, "our model beside the paper's measurement"),
        "gamma_tof": item.found(strong_tof_us - tof_us, f"{100 * (strong_tof_us / tof_us - 1):+.1f} %"),
        "gamma_ar": item.found(strong_ar - ar, f"{100 * (strong_ar / ar - 1):+.0f} %"),
    }


# Figure 13 --------------------------------------------------------------------------------------

_DEPTH_CURVES = (
    ("mindlin_sphere", "plate theory, sensor a sphere", style.SKY, "-", DEPTHS),
    ("mindlin_disk", "plate theory, sensor two disks", style.BLUE, "-", DEPTHS),
    ("mindlin_disk_large", "plate theory, disks, patch of 50.8 mm (C)", style.GREEN, "-.", DEPTHS),
    ("solid_sphere", "solid, sensor a sphere", style.ORANGE, "--", SOLID_DEPTHS),
    ("solid_disk", "solid, sensor two disks", style.VERMILLION, "--", SOLID_DEPTHS),
)
_LABELS = {name: label for name, label, *_ in _DEPTH_CURVES}


def _depth_jobs() -> dict[str, item.Job]:
    """Return the jobs of figure 13."""
    jobs = {}
    for name, _, _, _, depths in _DEPTH_CURVES:
        model, sensor, *large = name.split("_")
        if model not in models.plate_models():
            continue
        patch = CorrosionParameters(size_m=50.8e-3 if large else 25.4e-3)
        plate = models.plate_of_model(model)
        jobs[name] = item.Job(
            function=models.pulses_over_depth, arguments=(_CHAINS[sensor], plate, patch, depths)
        )
    return jobs


def draw_fig13(material: item.Material) -> item.Product:
    """Draw ToF and AR over the relative depth of the patch."""
    curves: dict[str, list[tuple[float, float, float]]] = {}
    absent: dict[str, str] = {}
    for name, *_ in _DEPTH_CURVES:
        try:
            shots = material.result(name)
        except KeyError:
            absent[name] = "this version has no plate.model = 'solid'"
        except item.NotAvailableError as error:
            absent[name] = str(error)
        else:
            curves[name] = [(s.depth_fraction, s.tof_us, s.amplitude_ratio) for s in shots]
    figure, axes = style.sheet(1, 2, height_in=4.3)
    for name, curve_label, colour, dash, _ in _DEPTH_CURVES:
        if name not in curves:
            continue
        depth, tof_us, ar = (np.array(column) for column in zip(*curves[name], strict=True))
        axes[0].plot(100 * depth, tof_us, color=colour, ls=dash, label=curve_label)
        axes[1].plot(100 * depth, ar, color=colour, ls=dash)
    for program, model, mark in (("MATLAB", "mindlin", "D"), ("ABAQUS", "solid", "s")):
        for axis, kind in ((axes[0], "tof"), (axes[1], "ar")):
            ends = [printed("fig13", f"{model}_sphere_{kind}_{depth}") for depth in (0, 80)]
            mark_style = {**style.PAPER_MARK, "marker": mark, "linestyle": ":", "linewidth": 0.8}
            label = f"paper, {program} (ends only)" if axis is axes[0] else None
            axis.plot([0, 80], ends, **mark_style, label=label)
    for axis in axes:
        axis.set(xlabel="depth of the patch (% of the thickness)")
    axes[0].set_ylabel("time of flight (µs)")
    axes[1].set_ylabel("amplitude ratio (1)")
    figure.legend(loc="outside lower center", ncols=2)
    style.name_panels(axes, ("time of flight", "amplitude ratio"))
    return item.Product(
        drawing=figure,
        tables={"": _curve_table(curves, "depth_fraction")},
        found=_depth_found(curves, absent),
        notes=(
            *(_turning(name, points) for name, points in curves.items()),
            *(f"{_LABELS[name].capitalize()}: not available, {why}." for name, why in absent.items()),
        ),
    )


def _depth_found(
    curves: Mapping[str, Sequence[tuple[float, float, float]]], absent: Mapping[str, str]
) -> dict[str, item.Found]:
    """Return our values of figure 13."""
    values: dict[str, item.Found] = {}
    for model in ("mindlin", "solid"):
        for sensor, _ in SENSORS:
            name = f"{model}_{sensor}"
            for column, kind in ((1, "tof"), (2, "ar")):
                for depth, ending in ((0.0, "0"), (0.8, "80")):
                    key = f"{name}_{kind}_{ending}"
                    if name in absent:
                        values[key] = item.missing(absent[name])
                        continue
                    at = {round(point[0], 6): point[column] for point in curves[name]}
                    values[key] = item.found(at[depth])
    return values


def _turning(name: str, points: Sequence[tuple[float, float, float]]) -> str:
    """Describe where the amplitude ratio is minimal, among the computed depths."""
    depth, _, lowest = min(points, key=lambda point: point[2] if math.isfinite(point[2]) else math.inf)
    return (
        f"{_LABELS[name].capitalize()}: AR is least, {lowest:.3f}, at a depth of {100 * depth:.0f} % and "
        f"{points[-1][2]:.3f} at {100 * points[-1][0]:.0f} %."
    )


FIG10 = item.Item(
    name="fig10",
    title="Figure 10. Coefficient of restitution and contact time",
    shows="Zener's equation 8 solved numerically, and the closed forms of equations 10 (up to lambda = 1) "
    "and 12.",
    make=draw_fig10,
    jobs={
        "curve": item.Job(function=models.impact_over_inelasticity, arguments=(_GRID,)),
        "case_3": item.Job(function=models.impact_over_inelasticity, arguments=((CASE_3,),)),
    },
)
_STEPS = models.ISW_STEPS
_STRONG = replace(_CHAINS["disk"], contact_damping_n_s_per_m=STRONG_GAMMA_N_S_PER_M)
FIG12 = item.Item(
    name="fig12",
    title="Figure 12. Influence of the incident wave's amplitude",
    shows="Pristine plate; the striker's height is varied so that the ISW is 0.8 to 1.2 times the nominal "
    "one.",
    make=draw_fig12,
    jobs={
        "disk": item.Job(function=models.pulses_over_isw, arguments=(_CHAINS["disk"], _PLATE, _STEPS)),
        "sphere": item.Job(function=models.pulses_over_isw, arguments=(_CHAINS["sphere"], _PLATE, _STEPS)),
        "disk_gamma": item.Job(function=models.pulses_over_isw, arguments=(_STRONG, _PLATE, _STEPS)),
        "zener_eq8": item.Job(function=models.zener_by_eq_8, arguments=(_STEPS,)),
        "zener_closed": item.Job(function=models.zener_by_closed_forms, arguments=(_STEPS,)),
    },
)
FIG13 = item.Item(
    name="fig13",
    title="Figure 13. Influence of the depth of corrosion",
    shows="A patch of 25.4 mm thinned at the middle of the plate; of the paper's curves only the ends are "
    "printed as numbers. The paper's MATLAB model is plate theory, its ABAQUS model a solid.",
    make=draw_fig13,
    jobs=_depth_jobs(),
)
