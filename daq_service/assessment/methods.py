"""The measuring methods: what each asks of a set, keeps as rows, is judged by and shows.

A further method is an entry here, beside its name (`hardware_drivers.methods`), the way a set takes it
(`acquisition.take_set`), its kind of row and its assessor.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from daq_service.archive import SetReader
from daq_service.assessment.assessor import Assessor
from daq_service.assessment.restore_state import restored_pulse_echo, restored_solitary_wave
from daq_service.catalogue import Catalogue
from daq_service.catalogue.reader import Filters
from daq_service.catalogue.rows import MEASURED_BY, FeatureRow, ThicknessRow, measured
from daq_service.settings.tree import ScheduleSettings, Settings
from hardware_drivers.methods import PULSE_ECHO, SOLITARY_WAVE, Method


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuringMethod:
    """What the line and its views know of a method.

    Attributes
    ----------
    row, of_sets
        Kind of row of its results, and what chooses those of whole sets among them.
    records_planned
        How many records a set wants at a position.
    has_baseline
        A set is judged against the healthy ones, which are recorded first.
    restored
        Makes a position's assessor, judging as if the recorder had never been away. Takes the position, the
        settings, the catalogue, the archive and whether records are a rehearsal's noise.
    """

    row: type[FeatureRow] | type[ThicknessRow]
    of_sets: Filters
    records_planned: Callable[[ScheduleSettings], int]
    has_baseline: bool
    restored: Callable[[str, Settings, Catalogue, SetReader, bool], Assessor]

    @property
    def values(self) -> tuple[str, ...]:
        """Names of the measured values, units in the names."""
        return measured(self.row)


METHODS: Mapping[Method, MeasuringMethod] = MappingProxyType(
    {
        SOLITARY_WAVE: MeasuringMethod(
            row=MEASURED_BY[SOLITARY_WAVE],
            of_sets={"scope": "set"},
            records_planned=lambda schedule: schedule.shots_per_set,
            has_baseline=True,
            restored=restored_solitary_wave,
        ),
        PULSE_ECHO: MeasuringMethod(
            row=MEASURED_BY[PULSE_ECHO],
            of_sets={},
            records_planned=lambda schedule: 1,
            has_baseline=False,
            restored=restored_pulse_echo,
        ),
    }
)
"""By name, in the order in which their instruments' trouble is told."""
