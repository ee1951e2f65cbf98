"""Wall thickness from solitary waves: bank of a position, row of a set, and condition of its alarm."""

from __future__ import annotations

from dataclasses import asdict
from functools import lru_cache

from analysis.assessment.step import Rules, State
from analysis.statistics.rules import AlarmRule
from analysis.wall.bank import Bank
from analysis.wall.estimator import WallEstimator
from analysis.wall.posterior import predict_changes
from analysis.wall.thickness import WallThickness
from analysis.waves.features import EXTRACTOR_VERSION
from analysis.waves.record_reduction import FloatArray
from daq_service.alarms.states import Condition
from daq_service.assessment.baseline_lifecycle import BaselineRange
from daq_service.assessment.wall_bank import Kind, list_bank_arguments, open_bank
from daq_service.catalogue.rows import WallRow
from daq_service.settings.tree import PositionSettings
from hardware_drivers.measurement import DueSet

FORMULA = "P(wall < limit): posterior of loss and rate over the wall curves of the twin"


@lru_cache(maxsize=8)
def _open_changes(kind: Kind) -> tuple[Bank, FloatArray]:
    """Return a bank and its changes; transducers of one kind share them. LookupError: it is not built yet."""
    bank = open_bank(*kind)
    if bank is None:
        raise LookupError("no bank of this kind")
    return bank, predict_changes(bank)


def build_wall_estimator(place: PositionSettings, rule: AlarmRule, baseline: BaselineRange) -> WallEstimator:
    """Return the estimator of a transducer, with the bank of its chain and plate as soon as it is there."""

    def find_bank() -> tuple[Bank, FloatArray] | None:
        """Return the bank and its changes, None as long as it is not built."""
        try:
            return _open_changes(list_bank_arguments(place))
        except LookupError:
            return None

    first = baseline.number == 1
    return WallEstimator(find_bank, rule, place.minimum_wall_m, baseline_id=baseline.row_id, is_first=first)


def build_wall_results(
    position: str, due: DueSet, state: State, rules: Rules, found: WallThickness
) -> tuple[WallRow, list[Condition]]:
    """Return the row of a wall thickness; of one with a minimum, the condition ``thickness_low`` (high).

    It is present by the k-of-n rule of sets whose wall is below the minimum with a probability above 95 %.
    """
    row = WallRow(
        set_index=due.set_index,
        position=position,
        due_h=due.due_h,
        extractor_version=EXTRACTOR_VERSION,
        **{**asdict(found), "reason": found.reason or None},
    )
    if state.wall is None or row.minimum_m is None:
        return row, []
    condition = Condition(
        position=position,
        kind="thickness_low",
        alarm_class="damage",
        priority="high",
        present=state.wall.alarm.active,
        evidence={
            "formula": FORMULA,
            "rule": {"k": rules.alarm.k, "n": rules.alarm.n},
            "set_index": row.set_index,
            "thickness_m": row.thickness_m,
            "interval_m": None if row.interval_low_m is None else [row.interval_low_m, row.interval_high_m],
            "below_minimum_probability": row.below_minimum_probability,
            "limit_m": row.minimum_m,
            "extractor_version": EXTRACTOR_VERSION,
        },
    )
    return row, [condition]
