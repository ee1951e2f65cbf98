"""Result of a set at one position, and the interface of the assessors that compute it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from daq_service.alarms.states import Condition
from daq_service.archive import SetRecord
from daq_service.catalogue.rows import AssessmentRow, BaselineRow, FeatureRow, SetRow, ThicknessRow, WallRow
from hardware_drivers.measurement import DueSet

if TYPE_CHECKING:
    from analysis.waves.features import ShotFeatures
    from hardware_drivers.measurement import Waveform


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
        Remark on the quality of the result, empty if there is none.
    suspicion
        Reason for a confirmation set, empty if none is requested.
    """

    features: Sequence[FeatureRow] = ()
    thickness: Sequence[ThicknessRow] = ()
    wall: WallRow | None = None
    baseline: BaselineRow | None = None
    assessments: Sequence[AssessmentRow] = ()
    conditions: Sequence[Condition] = ()
    n_valid: int = 0
    shot_flags: Mapping[int, Sequence[str]] = field(default_factory=dict)
    invalid: frozenset[int] = frozenset()
    note: str = ""
    suspicion: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StoredResult:
    """Stored rows of a set at a position.

    Attributes
    ----------
    result
        Features or thickness of the set; None if it has none.
    flags
        Flags of each accepted shot, as far as they are known.
    waveform
        Reads the record of the first shot.
    """

    its_set: SetRow
    result: FeatureRow | ThicknessRow | None
    flags: Sequence[Sequence[str]]
    waveform: Callable[[], Waveform]


class Assessor(Protocol):
    """Assessor of one position, set after set.

    Attributes
    ----------
    state
        State after the last set: a frozen dataclass, replaced by each set that changes it.
    """

    position: str
    state: Any

    @property
    def baseline_id(self) -> int | None:
        """Return the id of the baseline that the state belongs to; None for a method without baselines."""
        ...

    def assess_set(
        self, due: DueSet, record: SetRecord, features: Mapping[int, ShotFeatures]
    ) -> PositionResult:
        """Assess the records of a scheduled set at this position and update the state.

        Parameters
        ----------
        features
            Features of the set's shots by the shot's sequence number; a probe ignores them.
        """
        ...

    def assess_unscheduled(
        self, due: DueSet, record: SetRecord, features: Mapping[int, ShotFeatures]
    ) -> PositionResult:
        """Assess an unscheduled set; only the diagnosis state may change, never control chart and baseline.

        Raises
        ------
        AssertionError
            The measuring method takes no unscheduled sets.
        """
        ...

    def assess_empty_set(self, due: DueSet, n_tried: int) -> PositionResult:
        """Assess a scheduled set without any record at this position and update the state.

        Parameters
        ----------
        n_tried
            Number of shots that were tried, repetitions not counted.
        """
        ...

    def enable(self) -> None:
        """Clear the faults in the state that disabled the transducer, because a person has enabled it."""
        ...
