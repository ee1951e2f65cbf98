"""One set after another at a solitary-wave transducer: a pure step from state and set to state and verdict.

The recorder feeds each set as it is taken; a restart feeds those of the catalogue again and stands where
the last recorder stood. Rows and wording are `solitary_wave`'s.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from analysis.errors import NotEnoughSetsError, SingularCovarianceError
from analysis.statistics.baseline import Baseline, fit_baseline
from analysis.statistics.distance import distance_squared, named_contributions
from analysis.statistics.limits import f_predictive_limit, paper_limit
from analysis.statistics.rules import (
    AlarmRule,
    AlarmState,
    HoleRule,
    HoleState,
    next_alarm_state,
    next_hole_state,
    next_poor_sets,
)
from analysis.waves.features import FEATURE_NAMES
from daq_service.catalogue.rows import LimitName


@dataclass(frozen=True, slots=True, kw_only=True)
class Rules:
    """What a transducer is judged by.

    Attributes
    ----------
    last_baseline_set
        Index of the last set that belongs to the baseline.
    minimum_sets, minimum_valid_shots
        Fewer valid sets make no baseline, fewer valid shots a poor set.
    limit
        Which limit decides: ``f_predictive`` or ``paper_mean_3sd``.
    """

    baseline_name: str
    last_baseline_set: int
    minimum_sets: int
    minimum_valid_shots: int
    shots_per_set: int
    limit: LimitName
    false_alarm_rate: float
    alarm: AlarmRule
    hole: HoleRule


@dataclass(frozen=True, slots=True, kw_only=True)
class SetOfShots:
    """What a set gave.

    Attributes
    ----------
    n_taken, n_tried, n_valid
        Records of every attempt; shots tried, with or without a record; accepted shots that are valid.
    quality, reason
        Of the set's feature (`analysis.waves.features.SetFeatures`).
    values
        The set's feature by name; None or NaN where it is not available.
    flags
        Flags of each accepted shot.
    """

    set_index: int
    due_h: float
    n_taken: int
    n_tried: int
    n_valid: int
    quality: str
    reason: str
    values: Mapping[str, float | None]
    flags: Sequence[Sequence[str]]

    def vector(self) -> tuple[float, ...] | None:
        """Return the five features of the Mahalanobis vector; None where the set is not to be judged."""
        values = [self.values.get(name) for name in FEATURE_NAMES]
        known = tuple(value for value in values if value is not None and math.isfinite(value))
        return known if self.quality != "bad" and len(known) == len(values) else None


@dataclass(frozen=True, slots=True, kw_only=True)
class FrozenBaseline:
    """The closed baseline with its limits; ``fitted`` None: the sets gave none, and ``reason`` says why."""

    fitted: Baseline | None
    limit_f: float | None = None
    limit_paper: float | None = None
    reason: str | None = None

    def limit(self, name: str) -> float | None:
        """Return the limit of a name, None where there is none."""
        return self.limit_f if name == "f_predictive" else self.limit_paper


@dataclass(frozen=True, slots=True, kw_only=True)
class State:
    """What later sets are judged by.

    Attributes
    ----------
    healthy, n_left_out
        Sets of the baseline, and how many of its sets were unfit for it.
    baseline
        None while it is being recorded.
    poor_sets
        Sets running with too few valid shots.
    """

    healthy: tuple[SetOfShots, ...] = ()
    n_left_out: int = 0
    baseline: FrozenBaseline | None = None
    alarm: AlarmState = field(default_factory=AlarmState)
    hole: HoleState = field(default_factory=HoleState)
    poor_sets: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """What a set says.

    Attributes
    ----------
    outlier, outlier_paper
        Beyond the deciding limit, and beyond the paper's; None: not judged, ``reason`` says why.
    contributions
        Part of the squared distance of each feature, by its name.
    """

    in_baseline: bool = False
    distance_squared: float | None = None
    outlier: bool | None = None
    outlier_paper: bool | None = None
    reason: str | None = None
    contributions: Mapping[str, float] | None = None


def step(state: State, found: SetOfShots, rules: Rules) -> tuple[State, Verdict | None]:
    """Judge one set; no verdict where not one record was taken."""
    poor_sets = next_poor_sets(
        state.poor_sets,
        n_valid=found.n_valid,
        n_tried=found.n_tried,
        n_planned=rules.shots_per_set,
        minimum_valid=rules.minimum_valid_shots,
    )
    state = replace(state, poor_sets=poor_sets)
    if not found.n_taken:
        return state, None
    state = replace(state, hole=next_hole_state(state.hole, found.flags, rules.hole))
    in_baseline = found.set_index <= rules.last_baseline_set
    if in_baseline:
        state = _remembering(state, found)
    # Where the baseline's last set was missed, it closes at the first one after it.
    closes = state.baseline is None and found.set_index >= rules.last_baseline_set
    if closes:
        state = replace(state, baseline=_frozen(state, rules))
    if in_baseline:
        return state, Verdict(
            in_baseline=True,
            reason="left out of the baseline: too few valid shots"
            if closes
            else "the baseline is being recorded",
        )
    assert state.baseline is not None, "it closes at the first set after it"
    verdict = _judged(found, state.baseline, rules)
    return replace(state, alarm=next_alarm_state(state.alarm, verdict.outlier, rules.alarm)), verdict


def reinstated(state: State) -> State:
    """Forget what retired the transducer: a person says that it may strike again."""
    return replace(state, hole=HoleState(), poor_sets=0)


def _remembering(state: State, found: SetOfShots) -> State:
    if found.vector() is None:
        return replace(state, n_left_out=state.n_left_out + 1)
    return replace(state, healthy=(*state.healthy, found))


def _frozen(state: State, rules: Rules) -> FrozenBaseline:
    """Fit the baseline from the remembered sets; the same sets always give the same bits."""
    try:
        if len(state.healthy) < rules.minimum_sets:
            raise NotEnoughSetsError(
                f"a baseline of {len(state.healthy)} sets; baseline.minimum_sets asks for "
                f"{rules.minimum_sets}: let the baseline run longer"
            )
        fitted = fit_baseline(
            np.array([found.vector() for found in state.healthy]),
            [found.set_index for found in state.healthy],
            name=rules.baseline_name,
        )
    except (NotEnoughSetsError, SingularCovarianceError) as error:
        return FrozenBaseline(fitted=None, reason=str(error))
    return FrozenBaseline(
        fitted=fitted,
        limit_f=f_predictive_limit(fitted.n, fitted.p, rules.false_alarm_rate),
        limit_paper=paper_limit(fitted.distances_squared),
    )


def _judged(found: SetOfShots, baseline: FrozenBaseline, rules: Rules) -> Verdict:
    if baseline.fitted is None:
        return Verdict(reason=baseline.reason)
    values = found.vector()
    if values is None:
        return Verdict(reason=found.reason or "a feature is not available")
    vector = np.array(values)
    distance = float(distance_squared(vector, baseline.fitted))
    return Verdict(
        distance_squared=distance,
        outlier=_beyond(distance, baseline.limit(rules.limit)),
        outlier_paper=_beyond(distance, baseline.limit_paper),
        contributions=named_contributions(vector, baseline.fitted),
    )


def _beyond(distance: float, limit: float | None) -> bool | None:
    return None if limit is None else distance > limit
