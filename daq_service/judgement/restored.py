"""Assessors that know what the catalogue and the archive hold: a restart feeds every set again.

The assessors, and the numerics below them, are imported when one is made: the web only asks what methods
there are.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from analysis.waves.quality_gate import ACCEPTED
from daq_service.acquisition.schedule import due_hours
from daq_service.alarms.states import RETIRING
from daq_service.archive import SetReader, SetReference
from daq_service.catalogue import Catalogue
from daq_service.catalogue.rows import FeatureRow, SetRow, ShotRow, ThicknessRow, values
from daq_service.settings.tree import Settings

if TYPE_CHECKING:
    from daq_service.judgement.pulse_echo import PulseEchoAssessor
    from daq_service.judgement.solitary_wave import SolitaryWaveAssessor
    from daq_service.judgement.solitary_wave_step import SetOfShots


def restored_solitary_wave(
    position: str, settings: Settings, catalogue: Catalogue, archive: SetReader, rehearsal: bool
) -> SolitaryWaveAssessor:
    """Give the assessor of a transducer, fed with every set and with a person's word to reinstate it."""
    from daq_service.judgement.solitary_wave import SolitaryWaveAssessor

    del archive
    # The whole schedule, not one cut by end_h: a test that is carried on later has the same baseline.
    in_baseline = [hour for hour in due_hours(settings.schedule.phases) if hour <= settings.baseline.hours]
    assessor = SolitaryWaveAssessor(
        position,
        settings,
        last_baseline_set=len(in_baseline) - 1,
        baseline_id=1 + list(settings.positions).index(position),
        rehearsal=rehearsal,
    )
    before, since = _sets_by_reinstatement(position, catalogue)
    for sets in (before, since):
        assessor.reinstate()
        for found in _fed(position, catalogue, sets, settings.alarms.hole_sets):
            assessor.feed(found)
    return assessor


def _sets_by_reinstatement(position: str, catalogue: Catalogue) -> tuple[list[SetRow], list[SetRow]]:
    """List a position's sets as they were committed: until it was last reinstated, and since."""
    rows = catalogue.rows(SetRow, position=position)
    resets = [
        event.id or 0
        for event in catalogue.events_after(0, {"alarms"}, limit=None)
        if event.kind == "alarm_reset" and event.position == position and event.payload["kind"] in RETIRING
    ]
    if not resets:
        return [], rows
    # By the order of commits: a set may be taken long after it was due.
    since = {
        event.set_index
        for event in catalogue.events_after(resets[-1], {"sets"}, limit=None)
        if event.position == position
    }
    return (
        [row for row in rows if row.set_index not in since],
        [row for row in rows if row.set_index in since],
    )


def _fed(position: str, catalogue: Catalogue, sets: Sequence[SetRow], hole_sets: int) -> Iterator[SetOfShots]:
    """Give sets as the step takes them; the last ones have flags, the hole rule looks no further back."""
    from daq_service.judgement.solitary_wave_step import SetOfShots

    of_set = {row.set_index: row for row in catalogue.rows(FeatureRow, position=position, scope="set")}
    recent = [row.set_index for row in sets if row.n_taken][-hole_sets:]
    for row in sets:
        index = row.set_index
        feature = of_set.get(index)
        shots = catalogue.rows(ShotRow, position=position, set_index=index) if index in recent else []
        yield SetOfShots(
            set_index=index,
            due_h=row.due_h,
            n_taken=row.n_taken,
            n_tried=row.n_taken + row.n_missed - row.n_restrikes,
            n_valid=row.n_valid,
            quality="bad" if feature is None else feature.quality,
            reason="",
            values={} if feature is None else values(feature),
            flags=[shot.flags for shot in shots if shot.outcome == ACCEPTED],
        )


def restored_pulse_echo(
    position: str, settings: Settings, catalogue: Catalogue, archive: SetReader, rehearsal: bool
) -> PulseEchoAssessor:
    """Give the assessor of a probe, fed with every reading; a rehearsal's echoes are real ones."""
    from daq_service.judgement.pulse_echo import PulseEchoAssessor

    del rehearsal
    assessor = PulseEchoAssessor(position, settings)
    rows = catalogue.rows(ThicknessRow, position=position)
    read = [row.set_index for row in rows if row.travel_time_s is not None]
    if read:
        (its_set,) = catalogue.rows(SetRow, position=position, set_index=read[0])
        assert its_set.file is not None, "it was read"
        assessor.refer_to(archive.read_waveform(SetReference(its_set.file), position, 0))
    for row in rows:
        assessor.feed(row)
    return assessor
