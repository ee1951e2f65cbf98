"""Restore the state of assessors from catalogue and archive after a restart.

The assessors, and the numerics that they need, are imported when one is created: the web service only needs
the names of the methods.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

from analysis.statistics.rules import AlarmRule, determines_state
from analysis.waves.quality_gate import ACCEPTED
from daq_service.alarms.states import RETIRING
from daq_service.archive import CorruptArchiveError, SetNotFoundError, SetReader, SetReference
from daq_service.assessment.baseline_lifecycle import baseline_range
from daq_service.assessment.stored_limits import limits_by_name
from daq_service.catalogue import Catalogue
from daq_service.catalogue.rows import (
    AssessmentRow,
    EventRow,
    FeatureRow,
    SetRow,
    ShotRow,
    ThicknessRow,
    values,
)
from daq_service.settings.tree import Settings
from hardware_drivers.measurement import in_order

log = logging.getLogger(__name__)

LOOK_BACK_SETS = (64, 1024, None)
"""Numbers of sets that a restart reads, one after the other; the first one is usually sufficient."""
NEVER = 2**63 - 1

if TYPE_CHECKING:
    from daq_service.assessment.pulse_echo import PulseEchoAssessor
    from daq_service.assessment.solitary_wave import SolitaryWaveAssessor
    from daq_service.assessment.solitary_wave_step import SetOfShots
    from hardware_drivers.measurement import Waveform


def restored_solitary_wave(
    position: str, settings: Settings, catalogue: Catalogue, archive: SetReader, rehearsal: bool
) -> SolitaryWaveAssessor:
    """Restore the assessor of a transducer from its stored sets and its last reinstatement."""
    from daq_service.assessment.solitary_wave import SolitaryWaveAssessor

    del archive
    stored = catalogue.baseline(position)
    baseline = baseline_range(position, settings, stored)
    assessor = SolitaryWaveAssessor(
        position,
        settings,
        baseline=baseline,
        rehearsal=rehearsal,
        has_chart=stored is None or stored.state == "collecting" or stored.limits is not None,
    )
    reinstated_at = _first_set_after_reinstatement(position, catalogue)
    first, last = baseline.first_set, baseline.last_set
    healthy = catalogue.rows(SetRow, position=position, tried=True, first_set=first, last_set=last)
    recent = _recent_sets(position, settings, catalogue, reinstated_at)
    sets = [*healthy, *(row for row in recent if row.set_index > last)]
    first_after = max([last + 1, *(row.set_index for row in recent[:1])])
    features = {
        row.set_index: row
        for first_index, last_index in ((first, last), (first_after, None))
        for row in catalogue.rows(
            FeatureRow, position=position, scope="set", first_set=first_index, last_set=last_index
        )
    }
    assessments = {
        row.set_index: row for row in catalogue.rows(AssessmentRow, position=position, first_set=first_after)
    }
    for group in (
        [row for row in sets if row.set_index < reinstated_at],
        [row for row in sets if row.set_index >= reinstated_at],
    ):
        assessor.reinstate()
        for set_of_shots in _sets_of_shots(position, catalogue, group, features, settings.alarms.hole_sets):
            assessor.feed(set_of_shots, assessments.get(set_of_shots.set_index))
    unscheduled = catalogue.rows(AssessmentRow, position=position, purpose="confirmation")
    if unscheduled:
        newest = max(unscheduled, key=lambda row: in_order(row.set_index))
        assessor.feed_unscheduled(in_order(newest.set_index)[0], newest)
    return assessor


def _first_set_after_reinstatement(position: str, catalogue: Catalogue) -> int:
    """Find the first set that was committed after a transducer was last reinstated; 0 if it never was.

    The order of commits counts, because a set may be recorded long after it was due.
    """
    events = catalogue.rows(EventRow, topic="alarms", kind="alarm_reset", position=position)
    resets = [event.id or 0 for event in events if event.payload["kind"] in RETIRING]
    if not resets:
        return 0
    first = catalogue.rows(EventRow, topic="sets", position=position, after_id=resets[-1], limit=1)
    if not first or first[0].set_index is None:
        return NEVER
    index, extra = in_order(first[0].set_index)
    return index + 1 if extra else index


def _recent_sets(position: str, settings: Settings, catalogue: Catalogue, reinstated_at: int) -> list[SetRow]:
    """Read the last sets of a transducer that its state depends on; sets that were not tried do not count."""
    baseline = catalogue.baseline(position)
    has_limits = baseline is not None and bool(limits_by_name(baseline))
    rule = AlarmRule(k=settings.alarms.k, n=settings.alarms.n)
    for count in LOOK_BACK_SETS:
        rows = catalogue.last_rows(SetRow, position, count, tried=True)
        if len(rows) != count:
            break
        since = [row for row in rows if row.set_index >= reinstated_at]
        has_valid = any(row.n_valid >= settings.baseline.minimum_valid_shots for row in since)
        ends_silence = has_valid and sum(row.n_taken > 0 for row in since) >= settings.alarms.hole_sets
        if len(since) < len(rows) or ends_silence:
            assessments = catalogue.rows(AssessmentRow, position=position, first_set=rows[0].set_index)
            if not has_limits or determines_state([row.outlier for row in assessments], rule):
                break
    return rows


def _sets_of_shots(
    position: str,
    catalogue: Catalogue,
    sets: Sequence[SetRow],
    of_set: Mapping[int, FeatureRow],
    hole_sets: int,
) -> Iterator[SetOfShots]:
    """Yield sets as input of `step`; only the last ones have flags, because only the hole rule uses them."""
    from daq_service.assessment.solitary_wave_step import SetOfShots

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
    """Restore the assessor of a probe from its stored readings; a rehearsal's echoes are real ones."""
    from daq_service.assessment.pulse_echo import PulseEchoAssessor

    del rehearsal
    assessor = PulseEchoAssessor(position, settings)
    first = catalogue.first_reading(position)
    if first is None:
        return assessor
    _restore_reference(assessor, first, catalogue, archive)
    rule = AlarmRule(k=settings.alarms.k, n=settings.alarms.n)
    for count in LOOK_BACK_SETS:
        rows = catalogue.last_rows(ThicknessRow, position, count)
        if len(rows) != count or determines_state([assessor.too_thin(row) for row in rows], rule):
            break
    for row in rows:
        assessor.feed(row)
    return assessor


def _restore_reference(
    assessor: PulseEchoAssessor, first: ThicknessRow, catalogue: Catalogue, archive: SetReader
) -> None:
    """Set the reference to the record of the first reading; if it is lost, to the next readable one.

    Raises
    ------
    ArchiveError
        No record of any good reading is left, or the archive cannot be read now.
    """
    from analysis.errors import EchoNotFoundError

    try:
        return assessor.set_reference(_echo_of(first, catalogue, archive))
    except (CorruptArchiveError, SetNotFoundError) as error:
        lost = error
    for reading in catalogue.rows(ThicknessRow, position=first.position, first_set=first.set_index + 1):
        if reading.quality != "good" or reading.thickness_m is None:
            continue
        # The verification reports other corrupt records.
        with suppress(CorruptArchiveError, SetNotFoundError, EchoNotFoundError):
            assessor.set_later_reference(_echo_of(reading, catalogue, archive), reading=reading, first=first)
            message = "set %d stands in for the reference of %s: %s"
            log.warning(message, reading.set_index, first.position, lost)
            return None
    raise lost


def _echo_of(reading: ThicknessRow, catalogue: Catalogue, archive: SetReader) -> Waveform:
    """Read the waveform of a reading."""
    (its_set,) = catalogue.rows(SetRow, position=reading.position, set_index=reading.set_index)
    if its_set.file is None:
        raise SetNotFoundError(f"set {reading.set_index} has a reading of {reading.position!r} and no file")
    return archive.read_waveform(SetReference(its_set.file), reading.position, 0)
