"""The measuring methods: records of a set, rows, assessor and values of each.

A new method needs an entry here, a name (`hardware_drivers.methods`), an acquisition
(`acquisition.take_set`), a kind of row and an assessor.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from daq_service.archive import SetReader
from daq_service.assessment.assessor import Assessor
from daq_service.assessment.restore_state import restore_pulse_echo, restore_solitary_wave
from daq_service.catalogue import Catalogue
from daq_service.catalogue.reader import Filters
from daq_service.catalogue.rows import MEASURED, MEASURED_BY, FeatureRow, ThicknessRow
from daq_service.settings.tree import ScheduleSettings, Settings
from hardware_drivers.methods import PULSE_ECHO, SOLITARY_WAVE, Method


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuringMethod:
    """Properties of a measuring method.

    Attributes
    ----------
    row, of_sets
        Kind of row of its results, and the filter that selects the rows of complete sets.
    records_planned
        Number of records of a set at a position.
    has_baseline
        Whether sets are compared with a baseline, which is recorded first.
    restored
        Function that restores a position's assessor to its state before the restart. Its arguments are the
        position, the settings, the catalogue, the archive, and whether records are noise of a rehearsal.
    """

    row: type[FeatureRow] | type[ThicknessRow]
    of_sets: Filters
    records_planned: Callable[[ScheduleSettings], int]
    has_baseline: bool
    restored: Callable[[str, Settings, Catalogue, SetReader, bool], Assessor]

    @property
    def value_names(self) -> tuple[str, ...]:
        """Return the names of the measured values of a row, with units in the names."""
        return MEASURED[self.row]


METHODS: Mapping[Method, MeasuringMethod] = MappingProxyType(
    {
        SOLITARY_WAVE: MeasuringMethod(
            row=MEASURED_BY[SOLITARY_WAVE],
            of_sets={"scope": "set"},
            records_planned=lambda schedule: schedule.shots_per_set,
            has_baseline=True,
            restored=restore_solitary_wave,
        ),
        PULSE_ECHO: MeasuringMethod(
            row=MEASURED_BY[PULSE_ECHO],
            of_sets={},
            records_planned=lambda schedule: 1,
            has_baseline=False,
            restored=restore_pulse_echo,
        ),
    }
)
"""Methods by name, in the order in which errors of their instruments are reported."""
