"""Set files are made in the background: an error is reported and retried and costs no set."""

import pytest
from support.archived_sets import SET_INDEX, make_set, other_set
from support.damaging import flip
from support.filed_archive import FiledArchive
from support.machine import clock_in_seconds
from support.small_experiment import AtOnce, BrokenExecutor

from daq_service.archive import FolderArchive
from daq_service.background import finalize_sets as module
from daq_service.background.finalize_sets import AGAIN_AFTER_S, SetFinalizer
from hardware_drivers.measurement import SetKey


@pytest.fixture
def archive(tmp_path):
    archive = FolderArchive(tmp_path)
    for index in (SET_INDEX, SET_INDEX + 1):
        archive.store_set(other_set(make_set(), index))
    yield archive
    archive.close()


def files(folder):
    return sorted(path.name for path in (folder / "sets").iterdir())


def test_sets_get_their_files_and_leave_the_journal(archive, tmp_path):
    making = SetFinalizer(tmp_path, archive, start=AtOnce)
    for index in archive.sets():
        making.after_set(index)
    making.run_for(0.0)
    making.close()
    assert (len(files(tmp_path)), making.waits, making.trouble) == (2, False, "")
    archive.close()
    assert list((tmp_path / "journal").iterdir()) == []


@pytest.mark.parametrize(
    "refusal", [OSError(28, "No space left on device"), KeyError("what nobody foresaw")], ids=repr
)
def test_an_error_of_the_worker_is_reported_and_retried(archive, tmp_path, monkeypatch, refusal):
    now_s = [0.0]
    making = SetFinalizer(tmp_path, archive, start=AtOnce, machine=clock_in_seconds(lambda: now_s[0]))

    def refuse(folder, set_index, places, results, also):
        raise refusal

    with monkeypatch.context() as patch:
        patch.setattr(module, "finalize_set", refuse)
        making.after_set(SetKey(SET_INDEX))
        making.run_for(0.0)
        assert (making.waits, making.trouble, files(tmp_path)) == (True, str(refusal), [])
    now_s[0] = AGAIN_AFTER_S - 1.0
    making.run_for(0.0)
    assert files(tmp_path) == []
    now_s[0] = AGAIN_AFTER_S
    making.run_for(0.0)
    making.run_for(0.0)
    assert (len(files(tmp_path)), making.waits, making.trouble) == (1, False, "")


def test_a_worker_that_was_killed_is_replaced(archive, tmp_path):
    workers = [BrokenExecutor(), AtOnce()]
    making = SetFinalizer(tmp_path, archive, start=lambda: workers.pop(0))
    making.after_set(SetKey(SET_INDEX))
    making.run_for(0.0)
    assert files(tmp_path) == []
    making.retry_failed_sets()
    making.retry_failed_sets()
    assert (len(files(tmp_path)), making.waits) == (1, False)


def test_a_set_with_a_file_is_not_finalized_again(tmp_path):
    archive = FiledArchive(tmp_path)
    archive.store_set(make_set())
    making = SetFinalizer(tmp_path, archive, start=AtOnce)
    making.after_set(SetKey(SET_INDEX))
    making.run_for(0.0)
    assert (making.waits, making.trouble) == (False, "")


def test_a_set_with_corrupt_frames_stays_in_the_journal_and_is_reported(archive, tmp_path):
    (segment,) = (tmp_path / "journal").iterdir()
    flip(segment, segment.read_bytes().find(make_set().shots[0].waveform.counts.tobytes()) + 5)
    making = SetFinalizer(tmp_path, archive, start=AtOnce)
    for index in archive.sets():
        making.after_set(index)
    making.retry_failed_sets()
    assert (len(files(tmp_path)), making.waits) == (1, False)
    ((_, reason),) = making.damaged.items()
    assert "its frame in the journal is damaged" in reason
    archive.close()
    assert segment.exists()
