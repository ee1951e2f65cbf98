"""What a set says of one position, whatever measured it; and who says it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

from daq_service.acquisition.schedule import DueSet
from daq_service.alarms.states import Condition
from daq_service.archive import SetRecord
from daq_service.catalogue.rows import AssessmentRow, BaselineRow, FeatureRow, ThicknessRow

if TYPE_CHECKING:
    from analysis.waves.features import ShotFeatures


@dataclass(frozen=True, slots=True, kw_only=True)
class PositionResult:
    """Rows for the catalogue, conditions for the alarms.

    Attributes
    ----------
    baseline
        Row of a baseline that this set completed, else None.
    assessments
        This set's row, and those of the baseline's sets when it was completed.
    shot_flags, invalid
        Flags of each record by its sequence, and the sequences of those without trustworthy features.
    note
        What the reader of the result should know, empty if nothing.
    suspicion
        Why a confirmation set is wanted, empty if none is.
    """

    features: Sequence[FeatureRow] = ()
    thickness: Sequence[ThicknessRow] = ()
    baseline: BaselineRow | None = None
    assessments: Sequence[AssessmentRow] = ()
    conditions: Sequence[Condition] = ()
    n_valid: int = 0
    shot_flags: Mapping[int, Sequence[str]] = field(default_factory=dict)
    invalid: frozenset[int] = frozenset()
    note: str = ""
    suspicion: str = ""


class Assessor(Protocol):
    """Judges one position, set after set."""

    def assess_set(
        self, due: DueSet, record: SetRecord, features: Mapping[int, ShotFeatures]
    ) -> PositionResult:
        """Judge what a set took at this position; ``features`` of its shots by their sequence."""
        ...

    def assess_unscheduled(
        self, due: DueSet, record: SetRecord, features: Mapping[int, ShotFeatures]
    ) -> PositionResult:
        """Judge a set beside the plan by what the planned ones say; no chart and no baseline sees it."""
        ...

    @property
    def not_assessed_reason(self) -> str:
        """Why there is nothing to compare a set with; empty: there is."""
        ...

    def nothing_taken(self, due: DueSet, n_tried: int) -> PositionResult:
        """Judge a set that gave not one record; ``n_tried`` shots were tried, repetitions not counted."""
        ...

    def reinstate(self) -> None:
        """Forget what retired the transducer: a person says that it may be used again."""
        ...
