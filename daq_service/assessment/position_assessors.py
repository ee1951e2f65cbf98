"""Assessors of all positions of a test, and which of their states are stored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

from analysis.assessment.exact_json import to_json
from daq_service.archive import SetReader
from daq_service.assessment.assessor import Assessor, StoredResult
from daq_service.assessment.methods import METHODS
from daq_service.assessment.restore_state import STATE_FORMAT
from daq_service.catalogue import Catalogue
from daq_service.catalogue.rows import AssessmentRow, AssessorStateRow
from daq_service.settings.tree import Settings

FROZEN_FIELDS = frozenset({"healthy", "n_left_out", "baseline", "reference"})
"""Fields of a state that rarely change. They are large and have a row of their own."""


class PositionAssessors:
    """Assessors by position, restored when they are first used.

    Parameters
    ----------
    rehearsal
        The waveforms are noise of a rehearsal.

    Attributes
    ----------
    reinstated
        A person has enabled a transducer since the states were stored.
    """

    def __init__(self, settings: Settings, catalogue: Catalogue, archive: SetReader, rehearsal: bool) -> None:
        self._settings, self._catalogue, self._archive = settings, catalogue, archive
        self._rehearsal, self._configuration_hash = rehearsal, settings.configuration_hash()
        self._assessors: dict[str, Assessor] = {}
        self._stored: dict[str, object] = {}
        self.reinstated = False
        for position in settings.positions:
            self[position]  # an error of its state is reported at the start

    def __getitem__(self, position: str) -> Assessor:
        if position not in self._assessors:
            method = METHODS[self._settings.positions[position].method]
            self._assessors[position] = method.restored(
                position, self._settings, self._catalogue, self._archive, self._rehearsal
            )
        return self._assessors[position]

    def reinstate(self, position: str) -> None:
        """Reset the reason why a transducer was disabled: a person has enabled it."""
        self[position].reinstate()
        self.reinstated = True

    def renew(self, position: str) -> None:
        """Assess by what is stored from the next set on: a person has renewed the baseline."""
        self._assessors.pop(position, None)
        self._stored.pop(position, None)

    def follow(self, stored: StoredResult) -> Sequence[AssessmentRow]:
        """Update the state with a set by its rows (`Assessor.follow`)."""
        return self[stored.its_set.position].follow(stored)

    @property
    def states(self) -> dict[str, object]:
        """Return the state of each position; set it to continue from an earlier one."""
        return {position: assessor.state for position, assessor in self._assessors.items()}

    @states.setter
    def states(self, states: Mapping[str, object]) -> None:
        for position, state in states.items():
            self[position].state = state

    def changed_states(self) -> dict[str, AssessorStateRow]:
        """Return the rows of the states that have changed since the last call, by ``place``."""
        rows: list[AssessorStateRow] = []
        for position, assessor in self._assessors.items():
            before, self._stored[position] = self._stored.get(position), assessor.state
            rows += state_rows(
                before,
                assessor.state,
                position=position,
                baseline_id=assessor.baseline_id,
                configuration_hash=self._configuration_hash,
            )
        self.reinstated = False
        return {row.place: row for row in rows}


def state_rows(
    before: Any, after: Any, *, position: str, baseline_id: int | None, configuration_hash: str
) -> list[AssessorStateRow]:
    """Return the rows of a state that differ from those of the state before; None: all of them."""
    parts = {"frozen": FROZEN_FIELDS, "running": {item.name for item in fields(after)} - FROZEN_FIELDS}
    rows = []
    for part, names in parts.items():
        values = {item.name: getattr(after, item.name) for item in fields(after) if item.name in names}
        if before is not None and all(getattr(before, name) is value for name, value in values.items()):
            continue
        rows.append(
            AssessorStateRow(
                place=f"{position}/{part}",
                position=position,
                baseline_id=baseline_id,
                configuration_hash=configuration_hash,
                format=STATE_FORMAT,
                state=to_json(values),
            )
        )
    return rows
