"""Estimate the wall thickness of a transducer set after set, from its baseline on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Protocol

import numpy as np

from analysis.errors import AnalysisError, InvalidInputError
from analysis.statistics.rules import AlarmRule
from analysis.wall import posterior
from analysis.wall.bank import Bank
from analysis.wall.calibration import Calibration, calibrate
from analysis.wall.thickness import (
    LOST,
    WallModel,
    WallThickness,
    WallTrack,
    begin_from,
    estimate_thickness,
    find_start,
    pack,
    to_logs,
    update_alarm,
)
from analysis.waves.record_reduction import FloatArray


class Features(Protocol):
    """Features of a set by name, and its hour."""

    @property
    def due_h(self) -> float:
        """Return the hour of the test."""
        ...

    @property
    def values(self) -> Mapping[str, float | None]:
        """Return the features; None where one is missing."""
        ...


MOST_KEPT = 32
"""Transducers whose arrays, up to 12 MB each, are kept from set to set: a thousand would take 12 GB."""

OpenBank = Callable[[], tuple[Bank, FloatArray] | None]
"""Returns a bank and its changes by hypothesis (`posterior.predict_changes`); None: it is not built yet."""


@dataclass(slots=True)
class _Arrays:
    """What is made again from the track where it is not kept."""

    model: WallModel | None = None
    last: tuple[WallTrack, posterior.WallState] | None = None


class WallEstimator:
    """Estimator of one transducer and baseline.

    Parameters
    ----------
    open_bank
        Called again before each set while it returns None.
    minimum_m
        Thickness below which the wall must not be; None: none is stated.
    is_first
        The baseline is the first one of the test, on a sound wall.
    """

    def __init__(
        self,
        open_bank: OpenBank,
        rule: AlarmRule,
        minimum_m: float | None,
        *,
        baseline_id: int,
        is_first: bool,
    ) -> None:
        self._open_bank, self._rule, self.minimum_m = open_bank, rule, minimum_m
        self._baseline_id, self._is_first = baseline_id, is_first
        self._bank = open_bank()
        self._calibration: Calibration | None = None
        self._refused = ""

    def add_set(
        self, track: WallTrack | None, baseline: Sequence[Features], features: Features, other_cause: str = ""
    ) -> tuple[WallTrack | None, WallThickness | None]:
        """Return the track after a set behind the baseline, and the wall thickness, if there is one.

        Parameters
        ----------
        baseline
            Its sets.
        other_cause
            Diagnosis of the set, if not the wall.
        """
        self._bank = self._bank or self._open_bank()
        if self._bank is None:
            return track, None
        if not self._refused and (self._calibration is None or track is None):
            try:
                track, self._calibration = self._begin(*self._bank, track, baseline)
            except AnalysisError as error:
                self._refused = str(error)
        if self._refused or track is None or self._calibration is None:
            return track, WallThickness(quality="bad", reason=self._refused)
        arrays = _find_arrays(self)
        if arrays.model is None:
            arrays.model = self._compare(
                *self._bank, self._calibration, track.start, _compute_middle_h(baseline)
            )
        known, before = arrays.last or (None, None)
        before = before if known is track and before is not None else track.unpack()
        after, pool, found = estimate_thickness(
            arrays.model,
            before,
            track.pool,
            to_logs(features.values),
            features.due_h,
            other_cause=other_cause,
        )
        track = replace(track, pool=pool, alarm=update_alarm(track.alarm, found, self._rule))
        if after is not before:
            lost = 0.0 if track.start is not None else posterior.compute_exceedance(after, LOST)
            track = replace(track, packed=pack(after), lost_probability=lost)
        arrays.last = track, after
        return track, found

    def _begin(
        self,
        bank: Bank,
        changes: FloatArray,
        track: WallTrack | None,
        baseline: Sequence[Features],
    ) -> tuple[WallTrack, Calibration]:
        """Return the track of the baseline, the given one if it is of this baseline, and the calibration.

        A track of an earlier baseline goes on from the loss that it has in the middle of this one. Raise
        AnalysisError if the baseline cannot be used, or the loss at a renewed one is not known.
        """
        expected, hour = bank.sound, _compute_middle_h(baseline)
        if track is None and not self._is_first:
            raise InvalidInputError("the loss at the renewed baseline is not known: measure the wall")
        if track is None:
            state = posterior.begin(len(changes), hour)
            track = WallTrack(packed=pack(state), baseline_id=self._baseline_id)
        elif (n_stored := (stored := track.unpack()).joint.shape[2]) != len(changes):
            raise InvalidInputError(
                f"the stored wall has {n_stored} hypotheses, those of this version are {len(changes)}: go on "
                "with the version that began the test, or measure the wall"
            )
        elif track.baseline_id != self._baseline_id:
            # The slow drift is one from the baseline's mean.
            state = replace(posterior.wait(stored, hour), slow=posterior.SlowDrift())
            track = WallTrack(packed=pack(state), baseline_id=self._baseline_id, start=find_start(state))
        if track.start is not None:
            expected = expected - np.nanmedian(begin_from(changes, track.start)[:, 0], axis=0)
        history = np.array([to_logs(one.values) for one in baseline])
        return track, calibrate(bank, history, expected)

    def _compare(
        self,
        bank: Bank,
        changes: FloatArray,
        calibration: Calibration,
        start: FloatArray | None,
        baseline_h: float,
    ) -> WallModel:
        """Return what sets are compared with, from the losses of each hypothesis at the baseline."""
        if start is not None:
            changes = begin_from(changes, start)
        return WallModel(
            hypotheses=posterior.compare(calibration, changes),
            curves=posterior.list_curves(bank),
            initial_m=bank.thickness_m,
            baseline_h=baseline_h,
            minimum_m=self.minimum_m,
        )


@lru_cache(maxsize=MOST_KEPT)
def _find_arrays(_: WallEstimator) -> _Arrays:
    """Return the arrays of a transducer, empty where they are not kept."""
    return _Arrays()


def _compute_middle_h(baseline: Sequence[Features]) -> float:
    """Return the mean hour of the sets of a baseline."""
    return float(np.mean([one.due_h for one in baseline]))
