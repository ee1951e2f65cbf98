"""Quality check of a shot: which strikes are worth a repeat, and which attempt counts.

A poor strike (nothing triggered, struck twice, clipped, ...) is repeated at once instead of being
averaged in or silently dropped. Both records stay; one of them counts. The number of repetitions in a
set is bounded: what stays poor after that is the transducer's state, not an accident.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Final, Literal, get_args

from analysis.errors import InvalidInputError

DISTURBED: Final = "disturbed"
LOST_SAMPLES: Final = "lost_samples"
FLAGS = (
    "missed",
    "false_trigger",
    LOST_SAMPLES,
    "double",
    "clipped",
    DISTURBED,
    "inverted",
    "no_psw",
    "psw_merged",
    "baseline",
    "noisy",
)
"""What may be wrong with a shot.

``missed``: no record, or no wave of this transducer in it; ``false_trigger``: something else than the wave
started the record; ``lost_samples``: a stretch of it is one value, where noise would have moved it;
``clipped``: a flat top, at the end of the ADC's range or below; ``disturbed``: next to the wave is something
that no strike leaves (a knock, a foreign pulse, a jump, a line drawn through lost samples).
"""
INVALIDATING_FLAGS = frozenset(
    {"missed", "false_trigger", LOST_SAMPLES, "double", "clipped", DISTURBED, "inverted", "no_psw"}
)
"""A shot with one of these has no trustworthy feature vector and stays out of its set's mean.

The other three leave the vector usable: a merged PSW is what a badly corroded wall sends back, and
dropping it would hide the damage.
"""
MINIMUM_VALID_SHOTS = 7
"""Of the paper's ten; fewer make no mean."""

RestrikeFlag = Literal["missed", "double", "clipped", "inverted", "no_psw", "noisy"]
RESTRIKE_FLAGS: tuple[RestrikeFlag, ...] = get_args(RestrikeFlag)
"""Flags of a shot that a repetition may cure; a merged reflection or a drifting baseline it would not."""

ACCEPTED: Final = "accepted"
SUPERSEDED: Final = "superseded"
_RANK = {"bad": 0, "suspect": 1, "good": 2}


@dataclass(frozen=True, slots=True, kw_only=True)
class RestrikeRule:
    """Rule to repeat a shot with one of ``flags`` once, at most ``restrikes_per_set`` times in a set.

    Attributes
    ----------
    flags
        Of `FLAGS`; a strike that left no record counts as ``missed``, and ``missed`` includes
        ``false_trigger``, ``lost_samples`` and ``disturbed`` too: none of them gave a wave to measure.
    restrikes_per_set
        For each transducer.
    """

    flags: tuple[str, ...] = RESTRIKE_FLAGS
    restrikes_per_set: int = 3

    def __post_init__(self) -> None:
        """Raise InvalidInputError for an unknown flag or a negative number of repetitions."""
        unknown = sorted(set(self.flags) - set(FLAGS))
        if unknown:
            raise InvalidInputError(f"{unknown} are no flags of a shot; there are {', '.join(FLAGS)}")
        if self.restrikes_per_set < 0:
            raise InvalidInputError(
                f"restrikes_per_set is {self.restrikes_per_set}; it must not be negative (0: never)"
            )

    def wants(self, shot_flags: Sequence[str], *, attempt: int, restrikes_so_far: int) -> bool:
        """Check whether the rule repeats a shot; at most one repetition of each shot.

        Parameters
        ----------
        shot_flags
            Its flags, ``("missed",)`` where no record came.
        attempt
            0 for the first strike; only that one is repeated.
        restrikes_so_far
            Repetitions already made for this transducer in this set.
        """
        found = {"missed" if f in ("false_trigger", LOST_SAMPLES, DISTURBED) else f for f in shot_flags}
        poor = not found.isdisjoint(self.flags)
        return poor and attempt == 0 and restrikes_so_far < self.restrikes_per_set


@dataclass(frozen=True, slots=True, kw_only=True)
class Attempt:
    """One record of a shot: which shot of the set, attempt, quality."""

    shot: Hashable
    attempt: int
    quality: str


def decide_outcomes(attempts: Sequence[Attempt]) -> list[str]:
    """Mark each record ``accepted`` or ``superseded``: of a shot's attempts the best one counts.

    Of equally good ones the last counts: it was struck because something was wrong with the first.
    The result has the order of the attempts. Raise InvalidInputError for an unknown quality.
    """
    best: dict[Hashable, int] = {}
    for number, item in enumerate(attempts):
        if item.quality not in _RANK:
            raise InvalidInputError(f"quality is {item.quality!r}; it must be one of {', '.join(_RANK)}")
        rival = best.get(item.shot)
        if rival is None or _rank_attempt(item) >= _rank_attempt(attempts[rival]):
            best[item.shot] = number
    chosen = set(best.values())
    return [ACCEPTED if number in chosen else SUPERSEDED for number in range(len(attempts))]


def _rank_attempt(item: Attempt) -> tuple[int, int]:
    """Return the sort key of an attempt: its quality, then its number, so that the latest wins."""
    return _RANK[item.quality], item.attempt
