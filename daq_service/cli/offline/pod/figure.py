"""Draw the curves of the probability of detection with their 95 % bounds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import cycle

import matplotlib as mpl
import numpy as np
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from analysis.statistics.detection_probability import PROBABILITIES, DetectionCurve
from daq_service.cli.reproduce import style


def draw_pods(curves: Mapping[str, DetectionCurve], estimand: str, ending: str) -> bytes:
    """Draw the POD over the loss of each rule, its bound dashed, a90/95 as a diamond; return SVG or PNG.

    Infinite bounds are left out. ``estimand`` is written above the figure.
    """
    with mpl.rc_context(style.RULES):
        figure, (axis,) = style.create_sheet(height_in=4.2)
        axis.axhline(0.9, color=style.GREY, lw=0.8)
        for colour, (rule, curve) in zip(cycle(style.COLOURS), curves.items(), strict=False):
            is_finite = np.isfinite(curve.bound_m)
            bound = f"a90/95 {1e3 * curve.a90_95_m:#.3g} mm" if math.isfinite(curve.a90_95_m) else "no a90/95"
            axis.plot(1e3 * curve.loss_m, PROBABILITIES, color=colour, label=f"{rule}, {bound}")
            axis.plot(1e3 * curve.bound_m[is_finite], PROBABILITIES[is_finite], "--", color=colour)
            axis.plot([1e3 * curve.a90_95_m], [0.9], "D", color=colour, ms=5)
        largest_mm = 3e3 * max(curve.loss_m[-1] for curve in curves.values())
        axis.set(xscale="log", ylim=(0.0, 1.0), xlabel="wall loss (mm)", ylabel="probability of detection")
        axis.set_xlim(right=min(largest_mm, axis.get_xlim()[1]))
        axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.set_title(f"Wall loss: {estimand}\nsolid: estimate; dashed: 95 % bound", fontsize=8)
        style.add_legend(figure, ncols=2)
        return style.render_figure(figure, [ending])[ending]
