"""Alarm rules over the sequence of sets: when outliers raise an alarm, and when the wall has a hole.

The configuration's defaults are those of the rules here, which load without NumPy.

States are small frozen values; a step takes one and returns the next, so a restart resumes from what
the catalogue holds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from analysis.errors import InvalidInputError

NOMINAL_RATE = 0.0027
"""One in 370: a normal variable beyond three standard deviations (the paper's 99.73 %)."""
MINIMUM_SETS = 15
"""Fewer make no baseline: at p = 5 the limit would exceed 65 and its realised rate scatter tenfold."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmRule:
    """Alarm rule: on at ``k`` outliers in the last ``n`` assessed sets, off at ``off_at_most`` or fewer.

    A set that was not assessed (None) does not enter the window: it neither raises nor clears. So the
    rule's rate an assessed set does not depend on gaps, and a sensor that fails often cannot hide outliers.
    The alarm clears only over a full window of n assessed sets.
    """

    k: int = 3
    n: int = 5
    off_at_most: int = 0

    def __post_init__(self) -> None:
        """Raise InvalidInputError unless 1 <= k <= n and 0 <= off_at_most < k."""
        if not 1 <= self.k <= self.n:
            raise InvalidInputError(f"k is {self.k} of n = {self.n}; it must lie in 1..n")
        if not 0 <= self.off_at_most < self.k:
            raise InvalidInputError(
                f"off_at_most is {self.off_at_most}; it must lie in 0..k - 1 = {self.k - 1}"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmState:
    """State of the alarm rule.

    Attributes
    ----------
    recent
        Assessments of the last assessed sets, oldest first, at most n.
    active
        The alarm is on.
    """

    recent: tuple[bool, ...] = ()
    active: bool = False


def update_alarm_state(
    state: AlarmState,
    outlier: bool | None,
    rule: AlarmRule = AlarmRule(),
) -> AlarmState:
    """Return the state of the k-of-n alarm after one more set; unchanged if ``outlier`` is None."""
    if outlier is None:
        return state
    recent = (*state.recent, bool(outlier))[-rule.n :]
    count = sum(recent)
    clears = len(recent) == rule.n and count <= rule.off_at_most
    return AlarmState(recent=recent, active=not clears if state.active else count >= rule.k)


def determines_alarm(outliers: Sequence[bool | None], rule: AlarmRule) -> bool:
    """Check whether these outliers, oldest first, alone determine the alarm state.

    A full window with outliers enough, or few enough, leaves no doubt whether the alarm is on.
    """
    assessed = [outlier for outlier in outliers if outlier is not None]
    counts = [sum(assessed[first : first + rule.n]) for first in range(len(assessed) - rule.n + 1)]
    return any(count >= rule.k or count <= rule.off_at_most for count in counts)


@dataclass(frozen=True, slots=True, kw_only=True)
class HoleRule:
    """Rule for a hole: ``shots`` shots without a reflected wave in ``consecutive_sets`` consecutive sets.

    A set without any shot (a gap) neither counts nor interrupts; a set with some shots but fewer than
    ``shots`` without reflection interrupts.
    """

    shots: int = 7
    consecutive_sets: int = 2

    def __post_init__(self) -> None:
        """Raise InvalidInputError unless both numbers are at least 1."""
        if self.shots < 1 or self.consecutive_sets < 1:
            raise InvalidInputError(
                f"shots is {self.shots} and consecutive_sets {self.consecutive_sets}; both must be at least 1"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class HoleState:
    """Consecutive sets without a reflected wave, and whether that makes a permanent hole."""

    sets_running: int = 0
    hole: bool = False


def update_hole_state(
    state: HoleState,
    shot_flags: Sequence[Sequence[str]],
    rule: HoleRule = HoleRule(),
) -> HoleState:
    """Return the hole rule's state after one more set: the count of sets without a reflection, and the hole.

    A set without shots changes nothing; a hole, once found, remains.

    Parameters
    ----------
    shot_flags
        Flags of each shot taken (`analysis.waves.features.ShotFeatures.flags`).
    """
    if not shot_flags:
        return state
    silent = sum("no_psw" in flags for flags in shot_flags)
    running = state.sets_running + 1 if silent >= rule.shots else 0
    return HoleState(sets_running=running, hole=state.hole or running >= rule.consecutive_sets)


def count_poor_sets(running: int, *, n_valid: int, n_tried: int, n_planned: int, minimum_valid: int) -> int:
    """Return the count of consecutive sets with too few valid shots, after one more set.

    Parameters
    ----------
    running
        The count before this set.
    n_valid
        Valid shots of the set.
    n_tried
        Shots tried, repetitions not counted.
    n_planned
        Shots planned. A set that was cut short (a pause, a lost rig) neither counts nor interrupts, unless it
        has enough valid shots.
    minimum_valid
        Fewer make a poor set.
    """
    if n_valid >= minimum_valid:
        return 0
    return running + 1 if n_tried >= n_planned else running
