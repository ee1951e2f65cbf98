"""A recorded test, played back through the recorder, gives the same test again."""

import re
from dataclasses import replace
from pathlib import Path

import pytest
from support.archived_sets import assert_same_records
from support.small_experiment import disturbed_rig, rows_of, run
from support.small_experiment import small_settings as half_a_day
from support.stored_files import read_set, set_files

from daq_service.clock import parse_utc
from daq_service.settings.file import load_settings
from hardware_drivers.errors import AcquisitionTimeoutError

END_H, SHORT_H, LAST = 8.0, 1.5, 15
"""After the baseline of 7.5 h there are assessments; what concerns single shots is seen in less."""


def small_settings(**tables):
    """Return settings of a probe and two transducers, without confirmation sets by default."""
    alarms = {"hole_shots": 2, "confirmation_sets_a_day": 0} | tables.pop("alarms", {})
    settings = half_a_day(baseline={"hours": 7.5}, alarms=alarms, **tables)
    kept = {name: place for name, place in settings.positions.items() if name != "D"}
    return settings.model_copy(update={"positions": kept})


def played_back(source, end_h=END_H, **tables):
    """Return settings of the same test on a recording."""
    playback = {"source": str(source)}
    return small_settings(schedule={"end_h": end_h}, rig={"kind": "playback", "playback": playback}, **tables)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Record a short test on the twin; its last set is above the limit at B."""

    def disturb(key, acquired):
        if (key.position, key.set_index) != ("B", LAST):
            return acquired
        wave = acquired.waveform
        return replace(acquired, waveform=replace(wave, counts=wave.counts // 2))

    folder = tmp_path_factory.mktemp("recorded")
    assert run(small_settings(schedule={"end_h": END_H}), folder, rig=disturbed_rig(disturb))
    return folder


def assert_same_sets(played, recorded):
    assert list(set_files(played)) == list(set_files(recorded))
    for one, other in zip(set_files(played).values(), set_files(recorded).values(), strict=True):
        assert_same_records(read_set(one), read_set(other))


def test_an_archive_played_back_in_two_parts_is_the_same_test_to_the_last_bit(recording, tmp_path):
    asking = {"alarms": {"confirmation_sets_a_day": 2}}
    assert run(played_back(recording, SHORT_H, **asking), tmp_path)
    assert run(played_back(recording, **asking), tmp_path)
    assert_same_sets(tmp_path, recording)
    rows, recorded = rows_of(tmp_path), rows_of(recording)
    # The recording has no unscheduled set: it is reported as missed, without other consequences.
    (unscheduled,) = [row for row in rows["sets"] if row.purpose == "confirmation"]
    assert (unscheduled.position, str(unscheduled.set_key), unscheduled.state) == ("B", f"{LAST}.1", "missed")
    assert "the recording has no attempt 0 at shot 0" in unscheduled.reason
    assert rows | {"sets": [row for row in rows["sets"] if row is not unscheduled]} == recorded
    assert [row.outlier for row in recorded["assessments"] if row.set_index == LAST] == [True, False]
    assert recorded["alarms"] == []
    found = read_set(set_files(tmp_path)[0])
    assert found.rig_kind == "playback"
    assert found.provenance["rig_identity"]["recording"] == str(recording)


PAGE = Path(__file__).parents[2] / "docs/how-to/play-back-recorded-shots.md"


@pytest.mark.parametrize("text", re.findall(r"```toml\n(.*?)```", PAGE.read_text("utf-8"), flags=re.DOTALL))
def test_the_toml_of_the_page_is_accepted(text, tmp_path):
    path = tmp_path / "playback.toml"
    path.write_text(text, encoding="utf-8")
    assert load_settings(path).rig.kind == "playback"


def test_the_python_of_the_page_prints_hour_0(recording, capsys):
    (text,) = re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), flags=re.DOTALL)
    exec(text, {"path": set_files(recording)[3]})
    assert int(capsys.readouterr().out) == parse_utc("2024-01-01T00:00:00Z")


def test_a_recording_without_quality_checks_is_not_restruck(tmp_path):
    """A re-strike that no recording holds would count as missed and move every strike after it."""

    def missing(key, acquired):
        if (key.position, key.set_index, key.shot_index) == ("B", 2, 1):
            raise AcquisitionTimeoutError("no trigger")
        return acquired

    old, new = tmp_path / "old", tmp_path / "new"
    settings = small_settings(schedule={"end_h": SHORT_H}, quality={"restrikes_per_set": 0})
    assert run(settings, old, rig=disturbed_rig(missing))
    assert run(played_back(old, SHORT_H), new)
    assert_same_sets(new, old)
    row = next(row for row in rows_of(new)["sets"] if (row.position, row.set_index) == ("B", 2))
    assert (row.n_taken, row.n_missed, row.n_restrikes) == (2, 1, 0)
