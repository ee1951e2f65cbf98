"""Folders that earlier versions began: gone on with, or refused by name; never rewritten."""

import hashlib
import json
import logging
import sqlite3
from dataclasses import asdict, is_dataclass

import pytest
from support.earlier_folders import FOLDERS, unpack_folder
from support.small_experiment import rows_of, run
from support.stored_files import read_set, set_files

from daq_service.catalogue import check_owner
from daq_service.catalogue.earlier_names import derive_uuid, to_current_row
from daq_service.errors import StorageError
from daq_service.settings.file import load_settings

TRANSDUCER, PROBE_TOO = FOLDERS / "transducer.toml", FOLDERS / "transducer_and_probe.toml"
CONFIGURATION_OF = dict.fromkeys(("ab39956", "c3c2e28", "29a2d7d5"), TRANSDUCER) | {"9c4a9b9": PROBE_TOO}
EXTRACTOR_OF = {"29a2d7d5": "1.8"}
TO_THE_END = {"schedule": {"end_h": 2.0}}
SETS = 20
FINAL_TABLES = ("experiment", "sets", "shots", "features", "thickness", "baselines", "events")
"""Tables whose rows never change; an alarm follows its state, and
the assessments of a baseline's sets wait for it."""

CAME_LATER = {
    "state",
    "approved_utc_ns",
    "limits",
    "baseline_quality",
    "statistics",
    "averages",
    "mewma_statistic",
    "mewma_alarm",
    "interval_low_m",
    "interval_high_m",
    "uuid",
}
CAME_LATER |= {"diagnosis", "diagnosis_probability", "diagnosis_details"}
"""Columns of a baseline that has a chart, and of its assessments."""


@pytest.fixture
def unpack(tmp_path, monkeypatch):
    """Return a function that copies the folder of a commit, with its extractor version, by default 1.1.

    Later ones flag more and measure the same: everything else of these folders can be gone on with.
    """

    def copy(commit):
        # In this order: what is imported here for the first time must find the true version.
        for module in ("daq_service.assessment.solitary_wave", "analysis.waves.features"):
            monkeypatch.setattr(f"{module}.EXTRACTOR_VERSION", EXTRACTOR_OF.get(commit, "1.1"))
        folder = tmp_path / commit
        unpack_folder(commit, folder)
        return folder

    return copy


def settings_of(commit, **tables):
    return load_settings(CONFIGURATION_OF[commit], overrides={**TO_THE_END, **tables})


def parsed(name, value):
    """Return a stored value; a payload and limits as objects."""
    return json.loads(value) if name in ("payload", "limits") and value else value


def stored_rows(folder):
    """Return rows as stored in the file of any revision, with current names, which their checksums follow."""
    database = sqlite3.connect(folder / "catalogue.sqlite")
    database.row_factory = sqlite3.Row
    rows = {
        table: [
            to_current_row(
                table, {name: parsed(name, value) for name, value in dict(row).items() if name != "row_crc32"}
            )
            for row in database.execute(f"SELECT * FROM {table} ORDER BY rowid")
        ]
        for table in FINAL_TABLES
    }
    database.close()
    return rows


def digests(folder, pattern):
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.glob(pattern)}


def goes_on(folder, commit):
    """Continue to the end and return the rows; check that earlier rows are unchanged."""
    before, files = stored_rows(folder), digests(folder, "sets/*.h5")
    assert run(settings_of(commit), folder)
    after = stored_rows(folder)
    for table, rows in before.items():
        kept = [{name: row[name] for name in rows[0]} for row in after[table][: len(rows)]] if rows else []
        assert kept == rows, table
    assert digests(folder, "sets/*.h5").items() >= files.items()
    assert len(set_files(folder)) == SETS > len(files)
    return after


def leaves(value, *where):
    """Return every number and text of rows by its location."""
    content = asdict(value) if is_dataclass(value) and not isinstance(value, type) else value
    if isinstance(content, dict | list | tuple):
        for name, part in content.items() if isinstance(content, dict) else enumerate(content):
            yield from leaves(part, *where, name)
    else:
        yield where, content


@pytest.mark.parametrize("commit", ["9c4a9b9", "ab39956"])
def test_a_folder_of_an_earlier_version_goes_on_under_its_own_hash(unpack, commit):
    folder = unpack(commit)
    rows = goes_on(folder, commit)
    (experiment,) = rows["experiment"]
    assert experiment["uuid"] == derive_uuid(experiment["configuration_hash"], experiment["epoch_utc_ns"])
    assert len({row["set_index"] for row in rows["sets"]}) == SETS
    # The keys that came later would give another hash; every file bears the one that began the folder.
    lacks_keys = commit != "9c4a9b9"
    assert (experiment["configuration_hash"] != settings_of(commit).configuration_hash()) == lacks_keys
    first, last = read_set(set_files(folder)[0]).provenance, read_set(set_files(folder)[SETS - 1]).provenance
    assert last["experiment"]["uuid"] == experiment["uuid"]
    assert first["configuration_hash"] == last["configuration_hash"] == experiment["configuration_hash"]
    assert last["configuration"] == settings_of(commit).model_dump(mode="json")
    assert last["versions"]["twin"] == "1"


def test_a_folder_with_a_frozen_baseline_and_stored_states_goes_on(unpack):
    rows = goes_on(unpack("29a2d7d5"), "29a2d7d5")
    (baseline,) = rows["baselines"]
    assert baseline["limits"]["mewma"] > 0.0, "the name of schema 0017"


def test_a_continued_run_has_the_rows_of_an_uninterrupted_one(unpack, tmp_path):
    folder, whole = unpack("9c4a9b9"), tmp_path / "whole"
    assert run(settings_of("9c4a9b9"), folder)
    assert run(settings_of("9c4a9b9"), whole)
    # Another processor began the folder: a count in some 10,000 is another one, sums run over other vectors,
    # and a noise that is read from bins differs by up to 8e-6 of its size. What a restart forgets or counts
    # twice changes a number by percents.
    assert [row.limits for row in rows_of(folder)["baselines"]] == [None], "frozen before there was a chart"
    # Readings of the earlier version have no interval: they count for the alarm by their thickness.
    (alarm,) = rows_of(folder)["alarms"]
    assert (alarm.kind, rows_of(whole)["alarms"]) == ("thickness_low", [])
    began, in_one_go = (
        {
            where: content
            for where, content in leaves({**rows_of(of), "alarms": []})
            if not CAME_LATER & set(where)
        }
        for of in (folder, whole)
    )
    assert began.keys() == in_one_go.keys()
    numbers = {where: content for where, content in in_one_go.items() if isinstance(content, float)}
    assert {where: began.pop(where) for where in numbers} == pytest.approx(
        numbers, rel=1e-4, abs=0.0, nan_ok=True
    )
    assert {where for where, content in began.items() if in_one_go[where] != content} <= {
        ("shots", row, "crc32") for row in range(len(rows_of(folder)["shots"]))
    }


def test_another_extractor_is_refused_before_the_catalogue_is_migrated(unpack):
    folder = unpack("c3c2e28")
    files = digests(folder, "**/*.*")
    for refused in (lambda: check_owner(settings_of("c3c2e28"), folder), lambda: goes_on(folder, "c3c2e28")):
        with pytest.raises(
            StorageError, match=r"extractor of solitary waves: started with 1\.0, is 1\.1 now"
        ):
            refused()
        assert digests(folder, "**/*.*").items() >= files.items()


def test_the_first_catalogue_is_migrated_by_the_recorder_that_goes_on(unpack, monkeypatch):
    folder = unpack("c3c2e28")
    # As if the extractor had stayed what it was: everything else of this folder can be gone on with.
    monkeypatch.setattr("analysis.waves.features.EXTRACTOR_VERSION", "1.0")
    check_owner(settings_of("c3c2e28"), folder)
    rows = goes_on(folder, "c3c2e28")
    assert {row["n_missed"] for row in rows["sets"]} == {0}


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("daq_service.catalogue.owner.TWIN_VERSION", "physics of the twin: started with 1, is 2 now"),
        ("analysis.ultrasound.thickness.EXTRACTOR_VERSION", "of pulse echoes: started with 1.1, is 2"),
        ("analysis.waves.features.EXTRACTOR_VERSION", "of solitary waves: started with 1.1, is 2"),
    ],
)
def test_a_version_that_measures_otherwise_names_what_changed(unpack, monkeypatch, name, message):
    folder = unpack("9c4a9b9")
    monkeypatch.setattr(name, "2")
    with pytest.raises(StorageError) as caught:
        check_owner(settings_of("9c4a9b9"), folder)
    assert message in str(caught.value)
    assert "with solimon 0.1.0), or choose another folder with --data-dir" in str(caught.value)
    assert caught.value.exit_code == 4


def test_a_new_package_version_alone_is_reported_and_not_refused(unpack, monkeypatch, caplog):
    monkeypatch.setattr("daq_service.recording.session.version", lambda name: "9.0.0")
    with caplog.at_level(logging.WARNING):
        goes_on(unpack("ab39956"), "ab39956")
    assert "solimon 9.0.0 continues a test that 0.1.0 started" in caplog.text
