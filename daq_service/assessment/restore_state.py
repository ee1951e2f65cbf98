"""Restore assessors from their stored state, or from the stored rows of all sets where it is not stored.

The assessors, and the numerics that they need, are imported when one is created: the web service only needs
the names of the methods.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, TypeVar

from analysis.waves.quality_gate import ACCEPTED
from daq_service.alarms.states import RETIRING
from daq_service.archive import SetNotFoundError, SetReader, SetReference
from daq_service.assessment.assessor import Assessor, StoredResult
from daq_service.assessment.baseline_lifecycle import get_baseline_range
from daq_service.catalogue import Catalogue
from daq_service.catalogue.rows import AssessorStateRow, EventRow, FeatureRow, SetRow, ShotRow, ThicknessRow
from daq_service.settings.tree import Settings
from hardware_drivers.measurement import SetKey

if TYPE_CHECKING:
    from daq_service.assessment.pulse_echo import PulseEchoAssessor
    from daq_service.assessment.solitary_wave import SolitaryWaveAssessor
    from hardware_drivers.measurement import Waveform

A = TypeVar("A", bound=Assessor)

NEVER = SetKey(2**63 - 1)
STATE_FORMAT = 1
"""Version of the stored states; a state of another version is computed from the stored sets."""


def restore_solitary_wave(
    position: str, settings: Settings, catalogue: Catalogue, archive: SetReader, rehearsal: bool
) -> SolitaryWaveAssessor:
    """Restore the assessor of a transducer from its stored state, or from all stored sets (`_restore_state`).

    Parameters
    ----------
    rehearsal
        Its waveforms are noise: no alarm of wall or transducer.

    Raises
    ------
    StorageError
        Catalogue or archive cannot be read.
    """
    from daq_service.assessment.solitary_wave import SolitaryWaveAssessor

    stored = catalogue.baseline(position)
    assessor = SolitaryWaveAssessor(
        position,
        settings,
        baseline=get_baseline_range(position, settings, stored),
        rehearsal=rehearsal,
        has_chart=stored is None or stored.state == "collecting" or stored.limits is not None,
    )
    return _restore_state(assessor, settings.configuration_hash(), catalogue, archive)


def restore_pulse_echo(
    position: str, settings: Settings, catalogue: Catalogue, archive: SetReader, rehearsal: bool
) -> PulseEchoAssessor:
    """Restore the assessor of a probe; ``rehearsal`` is ignored, because its echoes are real ones.

    A lost reference is replaced by the next good reading whose record can be read.

    Raises
    ------
    ArchiveError
        Its reference is not stored, and no record of any good reading is left.
    StorageError
        The catalogue cannot be read.
    """
    from daq_service.assessment.pulse_echo import PulseEchoAssessor

    del rehearsal
    assessor = _restore_state(
        PulseEchoAssessor(position, settings), settings.configuration_hash(), catalogue, archive
    )
    if assessor.lost is not None and assessor.state.reference is None:
        raise assessor.lost[1]
    return assessor


def _restore_state(assessor: A, configuration_hash: str, catalogue: Catalogue, archive: SetReader) -> A:
    """Restore the state of a new assessor, in place, and return the assessor.

    The stored state is used if this state format and configuration wrote all of it; otherwise all stored sets
    are replayed. Of a state of an earlier baseline only the wall is used: otherwise the new baseline starts
    empty. Raise StorageError if the catalogue cannot be read, ValueError, KeyError or TypeError for a stored
    state that cannot be decoded.
    """
    from analysis.assessment.exact_json import from_json

    rows = catalogue.rows(AssessorStateRow, position=assessor.position)
    made_by = (STATE_FORMAT, configuration_hash)
    if not rows or any((row.format, row.configuration_hash) != made_by for row in rows):
        replay_stored_sets(assessor, catalogue, archive)
    elif {row.baseline_id for row in rows} == {assessor.baseline_id}:
        assessor.state = from_json(type(assessor.state), *(row.state for row in rows))
    else:  # a new baseline of the same wall
        walls = [row.state for row in rows if row.place == f"{assessor.position}/wall"]
        assessor.state = from_json(type(assessor.state), *walls)
    return assessor


def replay_stored_sets(assessor: Assessor, catalogue: Catalogue, archive: SetReader) -> None:
    """Update the state of a new assessor with all stored sets in the order of their commits.

    The faults of a transducer are cleared where a person enabled it. Raise StorageError if the catalogue
    cannot be read.
    """
    from daq_service.assessment.follow_rows import replay_stored_set

    position = assessor.position
    results: dict[SetKey, FeatureRow | ThicknessRow] = {
        row.set_key: row
        for rows in (
            catalogue.rows(FeatureRow, position=position, scope="set", purpose="any"),
            catalogue.rows(ThicknessRow, position=position),
        )
        for row in rows
    }
    enabled_at = _find_sets_after_enabling(position, catalogue)
    for row in sorted(catalogue.rows(SetRow, position=position, purpose="any"), key=lambda row: row.id or 0):
        if row.set_key in enabled_at:
            assessor.enable()
        if affects_state(row):
            replay_stored_set(
                assessor,
                StoredResult(
                    its_set=row,
                    result=results.get(row.set_key),
                    flags=_read_accepted_flags(catalogue, row),
                    waveform=partial(read_first_waveform, archive, row),
                ),
            )
    if NEVER in enabled_at:
        assessor.enable()


def affects_state(row: SetRow) -> bool:
    """Return whether a set changes the state of an assessor.

    It does if it has a record, or if it is scheduled and all its shots were missed.
    """
    return row.n_taken > 0 or (row.n_missed > 0 and row.purpose is None)


def read_first_waveform(archive: SetReader, row: SetRow) -> Waveform:
    """Read the waveform of the first shot (index 0), or of the pulse-echo record, of a set at its position.

    Raises
    ------
    SetNotFoundError
        The set has no file, or its file or record is missing.
    CorruptArchiveError
        The record is corrupt.
    """
    if row.file is None:
        raise SetNotFoundError(f"set {row.set_key} has a reading of {row.position!r} and no file")
    return archive.read_waveform(SetReference(row.file), row.position, 0)


def _read_accepted_flags(catalogue: Catalogue, row: SetRow) -> list[list[str]]:
    """Read the flags of each accepted shot of a set; empty lists, without reading, if all shots are valid."""
    if row.n_valid == row.n_taken:
        return [[]] * row.n_taken
    shots = catalogue.rows(ShotRow, position=row.position, **row.set_key._asdict())
    return [shot.flags for shot in shots if shot.outcome == ACCEPTED]


def _find_sets_after_enabling(position: str, catalogue: Catalogue) -> set[SetKey]:
    """Return the key of the first set that was committed after each time the transducer was enabled.

    `NEVER` is among them if no set was committed after one of them. Raise StorageError if the catalogue
    cannot be read.
    """
    found = set[SetKey]()
    for event in catalogue.rows(EventRow, topic="alarms", kind="alarm_reset", position=position):
        if event.payload["kind"] in RETIRING:
            first = catalogue.rows(EventRow, topic="sets", position=position, after_id=event.id, limit=1)
            found.add((first[0].set_key if first else None) or NEVER)
    return found
