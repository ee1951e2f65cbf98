"""Update the state of an assessor with the stored rows of a set, as a rebuild and an older folder need."""

from __future__ import annotations

import logging
from collections.abc import Sequence

from analysis.assessment.step import SetOfShots
from analysis.errors import AnalysisError
from analysis.ultrasound.thickness import substitute_reference
from analysis.waves.features import ALL_FEATURE_NAMES
from daq_service.archive import CorruptArchiveError, SetNotFoundError
from daq_service.assessment.assessor import Assessor, StoredResult
from daq_service.assessment.pulse_echo import PulseEchoAssessor
from daq_service.assessment.solitary_wave import SolitaryWaveAssessor, has_completed_baseline
from daq_service.catalogue.rows import AssessmentRow, ThicknessRow

log = logging.getLogger(__name__)


def replay_stored_set(assessor: Assessor, stored: StoredResult) -> Sequence[AssessmentRow]:
    """Update an assessor's state with the stored rows of a set, without assessing it again.

    Return the assessments of a baseline that the set completes; empty otherwise, and for a probe. A
    transducer's unscheduled set changes only the diagnosis state.
    """
    if isinstance(assessor, SolitaryWaveAssessor):
        return _update_from_shots(assessor, stored)
    assert isinstance(assessor, PulseEchoAssessor)
    if isinstance(stored.result, ThicknessRow):
        if assessor.state.reference is None:
            _restore_reference(assessor, stored, stored.result)
        assessor.add(stored.result)
    return ()


def _update_from_shots(assessor: SolitaryWaveAssessor, stored: StoredResult) -> Sequence[AssessmentRow]:
    """Update a transducer's state with a stored set; return the assessments of a baseline that it completes.

    An unscheduled set changes only the diagnosis state and returns none.
    """
    row, result, before = stored.its_set, stored.result, assessor.state
    set_of_shots = SetOfShots(
        set_index=row.set_index,
        due_h=row.due_h,
        n_taken=row.n_taken,
        n_tried=row.n_taken + row.n_missed - row.n_restrikes,
        n_valid=row.n_valid,
        quality="bad" if result is None else result.quality,
        reason="",
        values={} if result is None else {name: getattr(result, name) for name in ALL_FEATURE_NAMES},
        flags=stored.flags,
    )
    if row.purpose is not None:
        assessor.diagnose_unscheduled(set_of_shots)
        return ()
    assessor.add_set(set_of_shots)
    return assessor.build_baseline_assessments() if has_completed_baseline(before, assessor.state) else ()


def _restore_reference(assessor: PulseEchoAssessor, stored: StoredResult, reading: ThicknessRow) -> None:
    """Set a probe's reference echo from its stored record; if that is lost, from the next good reading.

    A first record that cannot be read is stored in ``assessor.lost`` with its error; one without an echo
    changes nothing. A substitute from a later reading is logged as a warning.
    """
    if assessor.lost is not None and (reading.quality != "good" or reading.thickness_m is None):
        return
    try:
        waveform = stored.waveform()
        if assessor.lost is None:
            assessor.set_reference(assessor.build_reference_echo(waveform, assessor.initial_thickness_m))
            return
        first, error = assessor.lost
        assert reading.travel_time_s is not None
        assert reading.thickness_m is not None
        assert first.travel_time_s is not None
        substitute = substitute_reference(
            assessor.build_reference_echo(waveform, reading.thickness_m),
            travel_time_s=reading.travel_time_s,
            reference_travel_time_s=first.travel_time_s,
        )
    except AnalysisError:  # it has no echo
        return
    except (CorruptArchiveError, SetNotFoundError) as unreadable:
        if assessor.lost is None and reading.travel_time_s is not None:
            assessor.lost = reading, unreadable
        return
    log.warning("set %d replaces the reference of %s: %s", reading.set_index, assessor.position, error)
    assessor.set_reference(substitute)
