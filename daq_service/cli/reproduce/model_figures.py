"""Figures 10, 12 and 13: Zener's impact, the influence of the incident wave, the influence of the depth."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from daq_service.cli.reproduce import item, models, style
from daq_service.cli.reproduce.paper_values import printed_number
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters

STRONG_GAMMA_N_S_PER_M = 1000.0
"""Dashpot between chain and plate of the paper's "modified" model."""
DEPTHS = tuple(k / 20 for k in range(17))
SOLID_DEPTHS = (0.0, 0.2, 0.4, 0.5, 0.6, 0.7, 0.8)
"""Fewer depths: the solid plate is assembled and reduced for each."""
CASE_3 = 0.258
"""Lambda of the paper's Table 2, case 3."""

_SPHERE, _DISK = ChainParameters(sensor="sphere"), ChainParameters(sensor="disk")
_STRONG_SPHERE, _STRONG_DISK = (
    replace(chain, contact_damping_n_s_per_m=STRONG_GAMMA_N_S_PER_M) for chain in (_SPHERE, _DISK)
)
_PLATE, _SOLID = PlateParameters(), PlateParameters(model="solid")
_PATCH, _LARGE_PATCH = CorrosionParameters(size_m=25.4e-3), CorrosionParameters(size_m=50.8e-3)
_GRID = tuple(float(x) for x in np.linspace(0.0, 2.0, 41))

_Curves = Mapping[str, Sequence[models.Point]]


@dataclass(frozen=True, slots=True)
class _Curve:
    """A curve of ToF and AR: its style, and the computation of its points."""

    label: str
    colour: str
    dash: str
    job: item.Job


def _draw_curves(
    styles: Mapping[str, _Curve], curves: _Curves, *, height_in: float
) -> tuple[Figure, list[Axes]]:
    """Draw ToF (us) and AR over the varied quantity in two panels, AR without the static force as thin lines.

    Returns figure and axes. ``styles`` has label, color and line style of each curve by name.
    """
    figure, axes = style.create_sheet(1, 2, height_in=height_in)
    for name, points in curves.items():
        curve, columns = styles[name], np.transpose(points)
        for axis, values, label in ((axes[0], columns[1], curve.label), (axes[1], columns[2], None)):
            axis.plot(columns[0], values, color=curve.colour, ls=curve.dash, label=label)
        axes[1].plot(columns[0], columns[3], color=curve.colour, ls=curve.dash, lw=0.5)
    axes[0].set_ylabel("time of flight (µs)")
    axes[1].set_ylabel("amplitude ratio (1); thin: without static force")
    style.title_panels(axes, ("time of flight", "amplitude ratio"))
    return figure, axes


def _make_curve_table(curves: _Curves, varied: str) -> item.Table:
    """Build a table of the points of all curves, in order; ``varied`` names the column of the abscissa."""
    rows = [(name, *point) for name, points in curves.items() for point in points]
    names = ("curve", varied, "tof_us", "amplitude_ratio", "dynamic_amplitude_ratio")
    return item.Table(columns={name: [row[k] for row in rows] for k, name in enumerate(names)})


# Figure 10 --------------------------------------------------------------------------------------


def draw_impact_figure(material: item.Material) -> item.Product:
    """Draw the coefficient of restitution and the contact time over the inelasticity parameter lambda.

    Numerical solution, closed forms, and the paper's values of case 3. Raises NotAvailableError if a job
    failed.
    """
    columns: dict[str, list[float]] = material.result("curve")
    case_3: dict[str, list[float]] = material.result("case_3")
    figure, axes = style.create_sheet(1, 2, height_in=3.0)
    for axis, name, closed, equation, quantity in (
        (axes[0], "e_eq8", "e_eq10", "eq. 10", "e_case_3"),
        (axes[1], "tau_c_eq8", "tau_c_eq12", "eq. 12", "tau_c_case_3"),
    ):
        axis.plot(columns["inelasticity"], columns[name], color=style.BLUE, label="eq. 8, numerically")
        axis.plot(columns["inelasticity"], columns[closed], color=style.VERMILLION, ls="--", label=equation)
        axis.plot(
            [CASE_3], [printed_number("fig10", quantity)], **style.PAPER_MARK, label="paper, Table 2 case 3"
        )
        axis.set(xlabel="inelasticity parameter lambda (1)", xlim=(0.0, 2.0))
        axis.legend()
    axes[0].set_ylabel("coefficient of restitution e (1)")
    axes[1].set_ylabel("contact time tau_c (1)")
    style.title_panels(axes, ("restitution", "contact time"))
    return item.Product(
        drawing=figure,
        tables={"": item.Table(columns=columns)},
        found={
            "e_case_3": item.make_value(case_3["e_eq8"][0], "eq. 8"),
            "tau_c_case_3": item.make_value(case_3["tau_c_eq8"][0], "eq. 8"),
            **{name: item.make_value(values[0]) for name, values in case_3.items()},
        },
        notes=(
            (
                "Largest distance of the closed forms from eq. 8: eq. 10 "
                f"{_max_deviation_percent(columns, 'e_eq10', 'e_eq8'):.1f} % up to lambda = 1, eq. 12 "
                f"{_max_deviation_percent(columns, 'tau_c_eq12', 'tau_c_eq8'):.2f} % up to 2."
            ),
        ),
    )


def _max_deviation_percent(columns: Mapping[str, Sequence[float]], approximate: str, exact: str) -> float:
    """Compute the largest relative deviation of an approximation from the exact column, %, without NaN."""
    return 100.0 * float(np.nanmax(np.abs(np.divide(columns[approximate], columns[exact]) - 1.0)))


# Figure 12 --------------------------------------------------------------------------------------


def _build_isw_job(chain: ChainParameters) -> item.Job:
    """Create the job that simulates a chain over the amplitude of the incident wave."""
    return item.Job(function=models.compute_pulses_over_isw, arguments=(chain, _PLATE, models.ISW_STEPS))


def _build_zener_job(*, closed_form: bool) -> item.Job:
    """Create the job that computes Zener's model over the amplitude of the incident wave.

    ``closed_form`` as in `models.compute_zener_over_isw`.
    """
    return item.Job(function=models.compute_zener_over_isw, arguments=(models.ISW_STEPS, closed_form))


_ISW_CURVES = {
    "sphere": _Curve("coupled model, sensor a sphere (paper)", style.SKY, "-", _build_isw_job(_SPHERE)),
    "disk": _Curve("coupled model, sensor two disks (rig)", style.BLUE, "-", _build_isw_job(_DISK)),
    "sphere_gamma": _Curve("sphere, gamma 1,000 N s/m", style.ORANGE, "-", _build_isw_job(_STRONG_SPHERE)),
    "disk_gamma": _Curve("disks, gamma 1,000 N s/m", style.VERMILLION, "-", _build_isw_job(_STRONG_DISK)),
    "zener_eq8": _Curve("Zener, eq. 8", style.GREEN, "--", _build_zener_job(closed_form=False)),
    "zener_closed": _Curve("Zener, eqs 10 and 12", style.PURPLE, ":", _build_zener_job(closed_form=True)),
}
_ISW_MARKS = (
    (0, "numerical", "sphere_tof", "center"),
    (0, "Zener", "tof_zener", "bottom"),
    (1, "numerical", "sphere_ar", "center"),
    (1, "Zener", "ar_zener", "bottom"),
    (1, "measured", "ar_measured", "top"),
)
"""Panel, label, quantity and vertical alignment of the paper's values, on the side without curves."""


def draw_isw_figure(material: item.Material) -> item.Product:
    """Draw ToF and AR over the relative amplitude of the incident wave, with the paper's values.

    Raises NotAvailableError if a job failed.
    """
    curves: _Curves = {name: material.result(name) for name in _ISW_CURVES}
    figure, axes = _draw_curves(_ISW_CURVES, curves, height_in=4.1)
    for panel, text, quantity, side in _ISW_MARKS:
        value, offset_points = printed_number("fig12", quantity), {"bottom": 3, "center": 0, "top": -3}[side]
        axes[panel].plot([1.0], [value], **style.PAPER_MARK)
        axes[panel].annotate(
            text, (1.0, value), (6, offset_points), textcoords="offset points", va=side, fontsize=7
        )
    for axis, nominal in zip(axes, ("tof", "ar"), strict=True):
        value, percent = (printed_number("fig12", f"sphere_{name}") for name in (nominal, f"{nominal}_plus"))
        for sign in (-1.0, 1.0):
            axis.plot([0.8, 1.2], [value * (1.0 + sign * 0.01 * percent)] * 2, **style.PAPER_LINE)
        axis.set(xlabel="ISW amplitude over the nominal one (1)")
    axes[0].plot([], [], **style.PAPER_MARK, label="paper's values; dashed: its model's ± band")
    style.add_legend(figure, ncols=2)
    return item.Product(
        drawing=figure, tables={"": _make_curve_table(curves, "isw_ratio")}, found=_compute_isw_values(curves)
    )


def _compute_isw_values(curves: _Curves) -> dict[str, item.Found]:
    """Return our values of figure 12: ToF (us) and AR, and their changes at 0.8 and 1.2 of the ISW in %.

    Also those by Zener's model (eq. 8), and their differences with a strong dashpot.
    """
    at = {name: {round(point[0], 6): point[1:] for point in points} for name, points in curves.items()}
    found = {"ar_measured": item.make_value(at["disk"][1.0][1], "our model, not a measurement")}
    for kind, name in enumerate(("tof", "ar")):
        found[f"{name}_zener"] = item.make_value(at["zener_eq8"][1.0][kind], "eq. 8")
        for sensor in ("sphere", "disk"):
            nominal, strong = at[sensor][1.0][kind], at[f"{sensor}_gamma"][1.0][kind]
            for ratio, sign in ((1.2, "plus"), (0.8, "minus")):
                change = 100.0 * (at[sensor][ratio][kind] / nominal - 1.0)
                found[f"{sensor}_{name}_{sign}"] = item.make_value(abs(change), f"{change:+.2f} %")
            found[f"{sensor}_{name}"] = item.make_value(nominal)
            shift = f"{100 * (strong / nominal - 1):+.{1 - kind}f} %"
            found[f"{sensor}_gamma_{name}"] = item.make_value(strong - nominal, shift)
    return found


# Figure 13 --------------------------------------------------------------------------------------


def _build_depth_job(
    chain: ChainParameters, plate: PlateParameters, patch: CorrosionParameters, depths: tuple[float, ...]
) -> item.Job:
    """Create the job that simulates a chain over the relative depths of a patch."""
    return item.Job(function=models.compute_pulses_over_depth, arguments=(chain, plate, patch, depths))


_DEPTH_CURVES = {
    "mindlin_sphere": _Curve(
        "plate theory, sensor a sphere", style.SKY, "-", _build_depth_job(_SPHERE, _PLATE, _PATCH, DEPTHS)
    ),
    "mindlin_disk": _Curve(
        "plate theory, sensor two disks", style.BLUE, "-", _build_depth_job(_DISK, _PLATE, _PATCH, DEPTHS)
    ),
    "mindlin_disk_large": _Curve(
        "plate theory, disks, patch of 50.8 mm (C)",
        style.GREEN,
        "-.",
        _build_depth_job(_DISK, _PLATE, _LARGE_PATCH, DEPTHS),
    ),
    "solid_sphere": _Curve(
        "solid, sensor a sphere", style.ORANGE, "--", _build_depth_job(_SPHERE, _SOLID, _PATCH, SOLID_DEPTHS)
    ),
    "solid_disk": _Curve(
        "solid, sensor two disks",
        style.VERMILLION,
        "--",
        _build_depth_job(_DISK, _SOLID, _PATCH, SOLID_DEPTHS),
    ),
}


def draw_depth_figure(material: item.Material) -> item.Product:
    """Draw ToF and AR over the relative depth of the patch, with the paper's end values.

    A curve whose job failed is left out and named in the notes.
    """
    curves: dict[str, list[models.Point]] = {}
    absent: dict[str, str] = {}
    for name in _DEPTH_CURVES:
        try:
            curves[name] = [
                (s.depth_fraction, s.tof_us, s.amplitude_ratio, s.dynamic_amplitude_ratio)
                for s in material.result(name)
            ]
        except item.NotAvailableError as error:
            absent[name] = str(error)
    in_percent = {name: [(100 * point[0], *point[1:]) for point in curves[name]] for name in curves}
    figure, axes = _draw_curves(_DEPTH_CURVES, in_percent, height_in=4.3)
    for program, model, mark in (("MATLAB", "mindlin", "D"), ("ABAQUS", "solid", "s")):
        for axis, kind in ((axes[0], "tof"), (axes[1], "ar")):
            ends = [printed_number("fig13", f"{model}_sphere_{kind}_{depth}") for depth in (0, 80)]
            mark_style = {**style.PAPER_MARK, "marker": mark, "linestyle": ":", "linewidth": 0.8}
            axis.plot([0, 80], ends, **mark_style, label=f"paper, {program} (ends only)")
            axis.set(xlabel="depth of the patch (% of the thickness)")
    style.add_legend(figure, ncols=2)
    return item.Product(
        drawing=figure,
        tables={"": _make_curve_table(curves, "depth_fraction")},
        found=_compute_depth_values(curves, absent),
        notes=(
            *(_describe_minimum(name, points) for name, points in curves.items()),
            *(
                f"{_DEPTH_CURVES[name].label.capitalize()}: not available, {why}."
                for name, why in absent.items()
            ),
        ),
    )


def _compute_depth_values(curves: _Curves, absent: Mapping[str, str]) -> dict[str, item.Found]:
    """Return ToF (us) and AR of each curve at depths 0 and 0.8; those of absent curves with the reason.

    Also the smallest AR of each curve, and its depth in %.
    """
    ends = [
        (f"{kind}_{ending}", k, depth)
        for k, kind in ((1, "tof"), (2, "ar"))
        for depth, ending in ((0.0, "0"), (0.8, "80"))
    ]
    found = {f"{name}_{key}": item.no_value(why) for name, why in absent.items() for key, *_ in ends}
    for name, points in curves.items():
        at = {round(point[0], 6): point for point in points}
        found |= {f"{name}_{key}": item.make_value(at[depth][k]) for key, k, depth in ends}
        depth, _, least, _ = _find_minimum(points)
        found |= {f"{name}_ar_least": item.make_value(least), f"{name}_at": item.make_value(100.0 * depth)}
    return found


def _find_minimum(points: Sequence[models.Point]) -> models.Point:
    """Return the point of a curve with the smallest amplitude ratio."""
    return min(points, key=lambda point: point[2] if math.isfinite(point[2]) else math.inf)


def _describe_minimum(name: str, points: Sequence[models.Point]) -> str:
    """Describe the minimum of a curve's amplitude ratio over the computed depths, and its last value."""
    depth, _, lowest, _ = _find_minimum(points)
    return (
        f"{_DEPTH_CURVES[name].label.capitalize()}: AR is least, {lowest:.3f}, at a depth of "
        f"{100 * depth:.0f} % and {points[-1][2]:.3f} at {100 * points[-1][0]:.0f} %."
    )


FIG10 = item.Item(
    name="fig10",
    make=draw_impact_figure,
    jobs={
        "curve": item.Job(function=models.compute_impact_over_inelasticity, arguments=(_GRID,)),
        "case_3": item.Job(function=models.compute_impact_over_inelasticity, arguments=((CASE_3,),)),
    },
)
FIG12, FIG13 = (
    item.Item(name=name, make=make, jobs={key: curve.job for key, curve in curves.items()})
    for name, make, curves in (
        ("fig12", draw_isw_figure, _ISW_CURVES),
        ("fig13", draw_depth_figure, _DEPTH_CURVES),
    )
)
