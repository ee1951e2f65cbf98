"""Comparison of a shot with its transducer's own waves: those of the frozen baseline, or the other shots.

Corrosion leaves the incident wave exactly as it was and only delays the reflected one. So a record whose
incident wave is not the transducer's is none of its strikes, whatever follows in it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import Any

import numpy as np

from analysis.waves.distortion import find_clipped_shots, find_shots_with_lost_samples
from analysis.waves.features import ALL_FEATURE_NAMES, ShotFeatures, apply_flags
from analysis.waves.outline import find_dissimilar_shots
from analysis.waves.quality_gate import DISTURBED
from analysis.waves.record_reduction import MAD_TO_SD, STANDS_OUT, FloatArray, median

FEWEST_SHOTS = 3
"""Fewer valid shots have no middle."""
WEAKEST = 0.35
"""Of the usual amplitude: between strikes that did not really come (up to .25) and a loose contact (.5)."""
NARROWEST, WIDEST = 0.75, 1.35
"""Of the usual width: beads worn to twice their radius have .87 of it, a disk that leans by .05 rad 1.09."""
WIDENED, LOWERED, WIDTH_POWER = 1.06, 0.8, 1 / 6
"""A weaker strike's wave is wider by height^(-1/6) (Hertz contacts: velocity^(-1/5), its height by
velocity^(6/5)). One that is lower than the second, and wider than that by the first, was bent on its way:
tanh to .8 of the height makes it 1.07 times that wide; a disk that leans by .05 rad has .98, at .54."""
LIKE_ITS_OWN = 0.12
"""A wave without a reflection may show a hole only where its width is the usual one within this part."""
WEAKEST_REFLECTION = 0.25
"""Of the pristine wall's amplitude ratio: the smallest that any plate model sends back is .4 of it; through a
hole what follows the incident wave stays below a fifth of that wave."""
STRONGEST_REFLECTION = 1.4
"""Of the usual amplitude ratio: with depth it goes from .75 to 1.15 of the pristine wall's, a second strike
of a quarter on top of the reflected wave makes 1.5."""
DEEPER_PULL = 0.035
"""Beyond the usual one, of the ISW's amplitude: noise, which is in both, lets it scatter by .01."""
PULL_NOISE = 3.5
"""Standard deviations of an outline's point by which the deepest of two hundred lies beyond the usual deepest
one in fewer than one record of a thousand, if noise is white; in pink noise in one of a hundred."""
EARLIEST = 0.9
"""Of the earliest tenth's time of flight: no wall quickens the wave, and healthy shots scatter by 1 %."""
EARLIEST_TENTH, SHALLOW_QUARTER = 0.1, 0.25
LATEST_OWN = 0.5
"""Of the usual width: a wave that fires the trigger itself peaks always as late after it."""
LATEST_MERGED = 1.6
"""Of `Template.earliest_tof_s`: before, no thinned patch splits the reflected wave (the twin's: from 1.9)."""


LEARNT_FROM = (
    "isw_fwhm_s",
    "isw_amplitude_v",
    "amplitude_ratio",
    "pull_fraction",
    "tof_mf_s",
    "isw_time_s",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Template:
    """Typical waves of a transducer.

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
    isw_time_s, isw_time_sd_s
        Usual arrival of the incident wave after the trigger, and its scatter; None: not known.
    """

    isw_fwhm_s: float
    isw_amplitude_v: float
    amplitude_ratio: float | None = None
    merged: bool = False
    pull_fraction: float | None = None
    earliest_tof_s: float | None = None
    isw_time_s: float | None = None
    isw_time_sd_s: float = 0.0


def learn_template(shots: Sequence[ShotFeatures]) -> Template | None:
    """Compute the typical wave from quantiles of the valid shots; None for fewer than three.

    A shot without a width of its incident wave does not count.
    """
    valid = [shot for shot in shots if shot.valid and math.isfinite(shot.isw_fwhm_s)]
    if len(valid) < FEWEST_SHOTS:
        return None
    ordered = np.sort([[getattr(shot, name) for name in LEARNT_FROM] for shot in valid], axis=0)
    middle = dict(zip(LEARNT_FROM, _column_quantiles(ordered, 0.5).tolist(), strict=True))
    arrivals_s = np.abs(ordered[:, LEARNT_FROM.index("isw_time_s")] - middle["isw_time_s"])
    return Template(
        isw_fwhm_s=middle["isw_fwhm_s"],
        # Weak strikes are lower, nothing is higher: the middle of the sound ones, were half of all weak.
        isw_amplitude_v=float(
            _column_quantiles(ordered, 1.0 - SHALLOW_QUARTER)[LEARNT_FROM.index("isw_amplitude_v")]
        ),
        amplitude_ratio=middle["amplitude_ratio"],
        # Not the middle: where every second shot is disturbed, the sound ones are the others.
        pull_fraction=float(_column_quantiles(ordered, SHALLOW_QUARTER)[LEARNT_FROM.index("pull_fraction")]),
        merged=2 * sum("psw_merged" in shot.flags for shot in valid) >= len(valid),
        earliest_tof_s=EARLIEST
        * float(_column_quantiles(ordered, EARLIEST_TENTH)[LEARNT_FROM.index("tof_mf_s")]),
        isw_time_s=middle["isw_time_s"],
        isw_time_sd_s=MAD_TO_SD * median(arrivals_s),
    )


def _column_quantiles(ordered: FloatArray, part: float) -> FloatArray:
    """Compute a quantile of each column of a sorted table, shape (m,), linear between two rows.

    `numpy.quantile` is slow.
    """
    place = part * (len(ordered) - 1)
    low, high = ordered[math.floor(place)], ordered[math.ceil(place)]
    return np.asarray(low + (place % 1.0) * (high - low))


def flag_residual_reflections(shots: Sequence[ShotFeatures], usual_ratio: float | None) -> list[ShotFeatures]:
    """Flag shots ``no_psw`` whose reflection is too weak for any wall; only the incident wave's values stay.

    A disturbed shot is flagged ``missed`` instead. Shots that were compared before are not changed.

    Parameters
    ----------
    usual_ratio
        Amplitude ratio of the transducer's baseline; None: not known.
    """
    limit = WEAKEST_REFLECTION * (usual_ratio or 0.0)
    return [
        _flag_without_reflection(shot) if shot.amplitude_ratio < limit and not shot.compared else shot
        for shot in shots
    ]


def _flag_without_reflection(shot: ShotFeatures) -> ShotFeatures:
    """Return the shot without a reflected wave, with the flag ``no_psw`` (``missed`` if disturbed).

    Its outline and the flag ``psw_merged`` are removed.
    """
    # What is no strike alone can be no sign of a hole.
    flag = "missed" if DISTURBED in shot.flags else "no_psw"
    return apply_flags(replace(_keep_incident_wave(shot), outline=None), {*shot.flags, flag} - {"psw_merged"})


def _keep_incident_wave(shot: ShotFeatures) -> ShotFeatures:
    """Return the shot with NaN for every feature that is not of the incident wave or the noise."""
    unknown = [name for name in ALL_FEATURE_NAMES if not name.startswith(("isw_", "noise_"))]
    nothing: dict[str, Any] = dict.fromkeys(unknown, math.nan)
    return replace(shot, **nothing)


def compare_with_others(shots: Sequence[ShotFeatures], template: Template | None) -> list[ShotFeatures]:
    """Flag shots of one transducer that differ from its template, then from one another; same order.

    Flags are those of `flag_residual_reflections` and `compare_with_template`; an outline unlike the others
    gives ``disturbed``, a flattened top ``clipped``. Shots compared before stay as they are.
    """
    typical_ratio = None if template is None else template.amplitude_ratio
    found = [
        compare_with_template(shot, template) for shot in flag_residual_reflections(shots, typical_ratio)
    ]
    seen = {
        index: shot.outline
        for index, shot in enumerate(found)
        if shot.valid and not shot.compared and shot.outline is not None
    }
    outlines = [*seen.values()]
    tofs_s = np.array([found[index].tof_mf_s / one.stretch for index, one in seen.items()])
    foreign = find_dissimilar_shots(outlines, tofs_s) | find_shots_with_lost_samples(outlines, tofs_s)
    for flag, flagged in ((DISTURBED, foreign), ("clipped", find_clipped_shots(outlines, tofs_s) & ~foreign)):
        for index in compress(seen, flagged):
            found[index] = apply_flags(found[index], {*found[index].flags, flag})
    return found


def compare_with_template(shot: ShotFeatures, template: Template | None) -> ShotFeatures:
    """Flag a shot whose incident wave is not the transducer's, or whose reflection came too early.

    A shot that is flagged ``missed`` keeps what was measured of its incident wave, and nothing else.
    Return the shot unchanged without a template, without an incident wave, or if it was compared before.
    Other flags are ``clipped``, ``disturbed`` and ``double``.
    """
    if shot.compared or template is None or not math.isfinite(shot.isw_amplitude_v):
        return shot
    width = shot.isw_fwhm_s / template.isw_fwhm_s
    # A plateau widens a wave, two strikes in one do too: those are reported already.
    other = not NARROWEST <= width <= WIDEST and {"clipped", "double"}.isdisjoint(shot.flags)
    if "no_psw" in shot.flags:
        other = other or abs(width - 1.0) > LIKE_ITS_OWN or _has_different_arrival(shot, template)
    if other or shot.isw_amplitude_v < WEAKEST * template.isw_amplitude_v:
        return apply_flags(_keep_incident_wave(shot), {*shot.flags, "missed"} - {"no_psw"})
    found = set(shot.flags)
    height = shot.isw_amplitude_v / template.isw_amplitude_v
    if height < LOWERED and width * height**WIDTH_POWER > WIDENED:
        found.add("clipped")
    # A noisy shot's own noise pulls deeper than the others'.
    usual_pull = math.inf if template.pull_fraction is None or "noisy" in found else template.pull_fraction
    noise = 0.0 if shot.outline is None else PULL_NOISE * shot.outline.sd
    if shot.pull_fraction > usual_pull + max(DEEPER_PULL, noise):
        found.add(DISTURBED)
    if template.earliest_tof_s is not None:
        later = shot.tof_mf_s / template.earliest_tof_s
        if later < 1.0:
            found.add(DISTURBED)
        # What the wall merges it merges in most shots.
        if "psw_merged" in found and not template.merged and later < LATEST_MERGED:
            found.add("double")
    typical_ratio = template.amplitude_ratio
    if typical_ratio is not None and shot.amplitude_ratio > STRONGEST_REFLECTION * typical_ratio:
        found.add("double")
    return shot if len(found) == len(shot.flags) else apply_flags(shot, found)


def _has_different_arrival(shot: ShotFeatures, template: Template) -> bool:
    """Check whether the incident wave's arrival after the trigger differs from the template's.

    It differs by more than half a usual width and six standard deviations. Return False if none is known.
    """
    if template.isw_time_s is None:
        return False
    limit_s = max(LATEST_OWN * template.isw_fwhm_s, STANDS_OUT * template.isw_time_sd_s)
    return abs(shot.isw_time_s - template.isw_time_s) > limit_s
