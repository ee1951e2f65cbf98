"""A shot beside its transducer's own waves: those of the frozen baseline, or of the other shots.

Corrosion leaves the incident wave exactly as it was and only delays the reflected one. So a record whose
incident wave is not the transducer's is none of its strikes, whatever follows in it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from analysis.waves.features import ALL_FEATURE_NAMES, ShotFeatures, graded
from analysis.waves.quality_gate import DISTURBED
from analysis.waves.record_reduction import median

FEWEST_SHOTS = 3
"""Fewer valid shots have no middle."""
WEAKEST = 0.35
"""Of the usual amplitude: between strikes that did not really come (up to .25) and a loose contact (.5)."""
NARROWEST, WIDEST = 0.75, 1.35
"""Of the usual width: beads worn to twice their radius have .87 of it, a disk that leans by .05 rad 1.09."""
LIKE_ITS_OWN = 0.12
"""A wave without a reflection may tell of a hole only where its width is the usual one within this part."""
STRONGEST_REFLECTION = 1.4
"""Of the usual amplitude ratio: with depth it goes from .75 to 1.15 of the pristine wall's, a second strike
of a quarter on top of the reflected wave makes 1.5."""
DEEPER_PULL = 0.035
"""Beyond the usual one, of the ISW's amplitude: noise, which is in both, lets it scatter by .01."""
EARLIEST = 0.9
"""Of the earliest tenth's time of flight: no wall quickens the wave, and healthy shots scatter by 1 %."""
EARLIEST_TENTH, SHALLOW_QUARTER = 0.1, 0.25
LATEST_MERGED = 1.6
"""Of `Template.earliest_tof_s`: before, no thinned patch splits the reflected wave (the twin's: from 1.9)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Template:
    """A transducer's own waves.

    Attributes
    ----------
    amplitude_ratio
        Usual one; None: not known.
    pull_fraction
        How far records usually fall below their quiet level; None: not known.
    merged
        Most reflected waves are merged with another one.
    earliest_tof_s
        Time of flight below which no wall sends a wave back; None: not known.
    """

    isw_fwhm_s: float
    isw_amplitude_v: float
    amplitude_ratio: float | None = None
    merged: bool = False
    pull_fraction: float | None = None
    earliest_tof_s: float | None = None


def learnt(shots: Sequence[ShotFeatures]) -> Template | None:
    """Medians of the valid shots; None where there are fewer than `FEWEST_SHOTS`."""
    valid = [shot for shot in shots if shot.valid and math.isfinite(shot.isw_fwhm_s)]
    if len(valid) < FEWEST_SHOTS:
        return None
    tofs_s = [shot.tof_mf_s for shot in valid]
    return Template(
        isw_fwhm_s=median(np.array([shot.isw_fwhm_s for shot in valid])),
        isw_amplitude_v=median(np.array([shot.isw_amplitude_v for shot in valid])),
        amplitude_ratio=float(np.median([shot.amplitude_ratio for shot in valid])),
        # Not the middle: where every second shot is disturbed, the sound ones are the others.
        pull_fraction=float(np.quantile([shot.pull_fraction for shot in valid], SHALLOW_QUARTER)),
        merged=2 * sum("psw_merged" in shot.flags for shot in valid) >= len(valid),
        earliest_tof_s=EARLIEST * float(np.quantile(tofs_s, EARLIEST_TENTH)),
    )


def compared(shot: ShotFeatures, template: Template | None) -> ShotFeatures:
    """Flag a shot whose incident wave is not the transducer's, or whose reflection came too early.

    A shot that is flagged ``missed`` keeps what was measured of its incident wave, and nothing else.
    """
    if shot.compared or template is None or not math.isfinite(shot.isw_amplitude_v):
        return shot
    width = shot.isw_fwhm_s / template.isw_fwhm_s
    # A plateau widens a wave, two strikes in one do too: those are told already.
    other = not NARROWEST <= width <= WIDEST and {"clipped", "double"}.isdisjoint(shot.flags)
    if "no_psw" in shot.flags:
        other = other or abs(width - 1.0) > LIKE_ITS_OWN
    if other or shot.isw_amplitude_v < WEAKEST * template.isw_amplitude_v:
        unknown: dict[str, Any] = dict.fromkeys(
            (name for name in ALL_FEATURE_NAMES if not name.startswith(("isw_", "noise_"))), math.nan
        )
        return graded(replace(shot, **unknown), {*shot.flags, "missed"} - {"no_psw"})
    found = set(shot.flags)
    # A noisy shot's own noise pulls deeper than the others'.
    usual_pull = math.inf if template.pull_fraction is None or "noisy" in found else template.pull_fraction
    if shot.pull_fraction > usual_pull + DEEPER_PULL:
        found.add(DISTURBED)
    if template.earliest_tof_s is not None:
        later = shot.tof_mf_s / template.earliest_tof_s
        if later < 1.0:
            found.add(DISTURBED)
        # What the wall merges it merges in most shots.
        if "psw_merged" in found and not template.merged and later < LATEST_MERGED:
            found.add("double")
    usual = template.amplitude_ratio
    if usual is not None and shot.amplitude_ratio > STRONGEST_REFLECTION * usual:
        found.add("double")
    return shot if len(found) == len(shot.flags) else graded(shot, found)
