"""Assessors that know what the catalogue and the archive hold: a restart feeds the sets that they remember.

The assessors, and the numerics below them, are imported when one is made: the web only asks what methods
there are.
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
from daq_service.assessment.baseline_lifecycle import planned
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
"""How many sets a restart reads; as a rule the first look tells all that a recorder would remember."""
NEVER = 2**63 - 1

if TYPE_CHECKING:
    from daq_service.assessment.pulse_echo import PulseEchoAssessor
    from daq_service.assessment.solitary_wave import SolitaryWaveAssessor
    from daq_service.assessment.solitary_wave_step import SetOfShots
    from hardware_drivers.measurement import Waveform


def restored_solitary_wave(
    position: str, settings: Settings, catalogue: Catalogue, archive: SetReader, rehearsal: bool
) -> SolitaryWaveAssessor:
    """Give the assessor of a transducer, fed with the sets that count and a person's word to reinstate it."""
    from daq_service.assessment.solitary_wave import SolitaryWaveAssessor

    del archive
    stored = catalogue.baseline(position)
    baseline = planned(position, settings, stored)
    assessor = SolitaryWaveAssessor(
        position,
        settings,
        baseline=baseline,
        rehearsal=rehearsal,
        has_chart=stored is None or stored.state == "collecting" or stored.limits is not None,
    )
    reinstated_at = _first_set_reinstated(position, catalogue)
    first, last = baseline.first_set, baseline.last_set
    healthy = catalogue.rows(SetRow, position=position, tried=True, first_set=first, last_set=last)
    recent = _recent_sets(position, settings, catalogue, reinstated_at)
    sets = [*healthy, *(row for row in recent if row.set_index > last)]
    since = max([last + 1, *(row.set_index for row in recent[:1])])
    features = {
        row.set_index: row
        for begin, end in ((first, last), (since, None))
        for row in catalogue.rows(FeatureRow, position=position, scope="set", first_set=begin, last_set=end)
    }
    assessments = {
        row.set_index: row for row in catalogue.rows(AssessmentRow, position=position, first_set=since)
    }
    for part in (
        [row for row in sets if row.set_index < reinstated_at],
        [row for row in sets if row.set_index >= reinstated_at],
    ):
        assessor.reinstate()
        for found in _fed(position, catalogue, part, features, settings.alarms.hole_sets):
            assessor.feed(found, assessments.get(found.set_index))
    beside = catalogue.rows(AssessmentRow, position=position, purpose="confirmation")
    if beside:
        newest = max(beside, key=lambda row: in_order(row.set_index))
        assessor.feed_unscheduled(in_order(newest.set_index)[0], newest)
    return assessor


def _first_set_reinstated(position: str, catalogue: Catalogue) -> int:
    """Find the first set that was committed since a transducer was last reinstated; 0: it never was.

    By the order of commits: a set may be taken long after it was due.
    """
    told = catalogue.rows(EventRow, topic="alarms", kind="alarm_reset", position=position)
    resets = [event.id or 0 for event in told if event.payload["kind"] in RETIRING]
    if not resets:
        return 0
    first = catalogue.rows(EventRow, topic="sets", position=position, after_id=resets[-1], limit=1)
    if not first or first[0].set_index is None:
        return NEVER
    index, beside = in_order(first[0].set_index)
    return index + 1 if beside else index


def _recent_sets(position: str, settings: Settings, catalogue: Catalogue, reinstated_at: int) -> list[SetRow]:
    """List the last sets of a transducer, as far back as its memory reaches; untried ones say nothing."""
    baseline = catalogue.baseline(position)
    judged = baseline is not None and bool(limits_by_name(baseline))
    rule = AlarmRule(k=settings.alarms.k, n=settings.alarms.n)
    for count in LOOK_BACK_SETS:
        rows = catalogue.last_rows(SetRow, position, count, tried=True)
        if len(rows) != count:
            break
        since = [row for row in rows if row.set_index >= reinstated_at]
        good = any(row.n_valid >= settings.baseline.minimum_valid_shots for row in since)
        silence_ends = good and sum(row.n_taken > 0 for row in since) >= settings.alarms.hole_sets
        if len(since) < len(rows) or silence_ends:
            assessments = catalogue.rows(AssessmentRow, position=position, first_set=rows[0].set_index)
            if not judged or determines_state([row.outlier for row in assessments], rule):
                break
    return rows


def _fed(
    position: str,
    catalogue: Catalogue,
    sets: Sequence[SetRow],
    of_set: Mapping[int, FeatureRow],
    hole_sets: int,
) -> Iterator[SetOfShots]:
    """Give sets as the step takes them; the last ones have flags, the hole rule looks no further back."""
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
    """Give the assessor of a probe, fed with the readings that count; a rehearsal's echoes are real ones."""
    from daq_service.assessment.pulse_echo import PulseEchoAssessor

    del rehearsal
    assessor = PulseEchoAssessor(position, settings)
    first = catalogue.first_reading(position)
    if first is None:
        return assessor
    _refer(assessor, first, catalogue, archive)
    rule = AlarmRule(k=settings.alarms.k, n=settings.alarms.n)
    for count in LOOK_BACK_SETS:
        rows = catalogue.last_rows(ThicknessRow, position, count)
        if len(rows) != count or determines_state([assessor.too_thin(row) for row in rows], rule):
            break
    for row in rows:
        assessor.feed(row)
    return assessor


def thickness_interval_m(
    last: ThicknessRow, settings: Settings, catalogue: Catalogue, archive: SetReader
) -> tuple[float, float] | None:
    """Compute the 95 % interval of a reading anew, from its record and the reference; None: it has none.

    Raises
    ------
    ArchiveError
        One of the two records cannot be read.
    """
    from analysis.errors import AnalysisError
    from daq_service.assessment.pulse_echo import PulseEchoAssessor

    first = catalogue.first_reading(last.position)
    if first is None or last.thickness_m is None:
        return None
    assessor = PulseEchoAssessor(last.position, settings)
    try:
        _refer(assessor, first, catalogue, archive)
        return assessor.interval_m(_echo_of(last, catalogue, archive))
    except AnalysisError:  # judged by other settings than these: then it had one, and has none here
        return None


def _refer(
    assessor: PulseEchoAssessor, first: ThicknessRow, catalogue: Catalogue, archive: SetReader
) -> None:
    """Take the first reading's record as the reference; where it is lost, the next that can be read.

    Raises
    ------
    ArchiveError
        No record of any good reading is left, or the archive cannot be read now.
    """
    from analysis.errors import EchoNotFoundError

    try:
        return assessor.refer_to(_echo_of(first, catalogue, archive))
    except (CorruptArchiveError, SetNotFoundError) as error:
        lost = error
    for reading in catalogue.rows(ThicknessRow, position=first.position, first_set=first.set_index + 1):
        if reading.quality != "good" or reading.thickness_m is None:
            continue
        # What else is damaged is told by those who look for it.
        with suppress(CorruptArchiveError, SetNotFoundError, EchoNotFoundError):
            assessor.refer_to_later(_echo_of(reading, catalogue, archive), reading=reading, first=first)
            told = "set %d stands in for the reference of %s: %s"
            log.warning(told, reading.set_index, first.position, lost)
            return None
    raise lost


def _echo_of(reading: ThicknessRow, catalogue: Catalogue, archive: SetReader) -> Waveform:
    """Read the record that gave a reading."""
    (its_set,) = catalogue.rows(SetRow, position=reading.position, set_index=reading.set_index)
    if its_set.file is None:
        raise SetNotFoundError(f"set {reading.set_index} has a reading of {reading.position!r} and no file")
    return archive.read_waveform(SetReference(its_set.file), reading.position, 0)
