"""Assessors with the memory that the catalogue and the archive hold: how a restart goes on judging."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from analysis.waves.quality_gate import ACCEPTED
from daq_service.acquisition.schedule import due_hours
from daq_service.alarms.states import RETIRING
from daq_service.archive import SetReader, SetReference
from daq_service.catalogue import Catalogue
from daq_service.catalogue.rows import EventRow, FeatureRow, SetRow, ShotRow, ThicknessRow, VerdictRow
from daq_service.judgement.pulse_echo import PulseEchoAssessor
from daq_service.judgement.solitary_wave import SolitaryWaveAssessor
from daq_service.settings.tree import Settings

Assessor = SolitaryWaveAssessor | PulseEchoAssessor


def restored_assessors(
    settings: Settings, catalogue: Catalogue, archive: SetReader
) -> Mapping[str, Assessor]:
    """One assessor a position, judging as if the recorder had never been away."""
    # The whole schedule, not one cut by end_h: a test that is carried on later has the same baseline.
    last_baseline_set = (
        sum(hour <= settings.baseline.hours for hour in due_hours(settings.schedule.phases)) - 1
    )
    assessors: dict[str, Assessor] = {}
    for number, (position, place) in enumerate(settings.positions.items(), 1):
        if place.method == "pulse_echo":
            assessors[position] = _pulse_echo(position, settings, catalogue, archive)
        else:
            assessor = SolitaryWaveAssessor(
                position, settings, last_baseline_set=last_baseline_set, baseline_id=number
            )
            sets = _sets_since_reinstated(position, catalogue)
            assessor.restore(
                set_features=catalogue.rows(FeatureRow, position=position, scope="set"),
                verdicts=catalogue.rows(VerdictRow, position=position),
                baseline=catalogue.baseline(position),
                flags_by_set=_last_flags(position, settings, catalogue, sets),
                sets=sets,
            )
            assessors[position] = assessor
    return assessors


def _sets_since_reinstated(position: str, catalogue: Catalogue) -> list[SetRow]:
    """List a position's sets, in order; those that retired it are behind it once it is reinstated."""
    rows = sorted(catalogue.rows(SetRow, position=position), key=lambda row: row.set_index)
    resets = [
        event.id
        for event in catalogue.rows(EventRow, topics={"alarms"})
        if event.kind == "alarm_reset" and event.position == position and event.payload["kind"] in RETIRING
    ]
    if not resets:
        return rows
    # By the order of commits: a set may be taken long after it was due.
    since = {
        event.set_index
        for event in catalogue.rows(EventRow, after_id=resets[-1], topics={"sets"})
        if event.position == position
    }
    return [row for row in rows if row.set_index in since]


def _last_flags(
    position: str, settings: Settings, catalogue: Catalogue, sets: Sequence[SetRow]
) -> list[list[list[str]]]:
    """List the flags of each accepted shot of the sets that the hole rule still looks at."""
    recent = [row.set_index for row in sets if row.n_taken][-settings.alarms.hole_sets :]
    return [
        [
            shot.flags
            for shot in catalogue.rows(ShotRow, position=position, set_index=index)
            if shot.outcome == ACCEPTED
        ]
        for index in recent
    ]


def _pulse_echo(
    position: str, settings: Settings, catalogue: Catalogue, archive: SetReader
) -> PulseEchoAssessor:
    assessor = PulseEchoAssessor(position, settings)
    rows = catalogue.rows(ThicknessRow, position=position)
    read = [row for row in rows if row.travel_time_s is not None]
    reference = None
    if read:
        (its_set,) = catalogue.rows(SetRow, position=position, set_index=read[0].set_index)
        assert its_set.file is not None, "its record was read"
        reference = archive.read_waveform(SetReference(its_set.file), position, 0)
    assessor.restore(reference=reference, thickness_rows=rows)
    return assessor
