"""Export for a repository: the crate follows RO-Crate 1.2, is complete and holds nothing private."""

import hashlib
import json
import re
import shutil
from dataclasses import replace
from datetime import UTC, datetime

import h5py
import pandas as pd
import pytest
from click.testing import CliRunner
from support.filed_archive import journal_of
from support.filled_folder import FilledFolder
from support.stored_files import read_set, set_files, verify_set

from daq_service.archive.layout import build_set_image
from daq_service.catalogue import open_catalogue
from daq_service.cli.main import cli
from daq_service.cli.maintenance import ro_crate
from daq_service.errors import StorageUnavailableError
from daq_service.processes.installation import MissingExtraError
from daq_service.settings.tree import Settings

SETS = 3
SPECIFICATION = "https://w3id.org/ro/crate/1.2"
TABLES = ("sets", "features", "shot_features", "assessments", "thickness", "environment")
TABLES += ("wall", "baselines", "alarms", "annotations")
PRIVATE = ("hooks.example.org", "+39 081 555", "lab-pc-7")
POSITIONS = Settings().model_dump(mode="json")["positions"]
POSITIONS["B"]["calibration"]["certificate"] = "K-7"
SETTINGS = Settings(
    positions=POSITIONS,
    name="Tank 3 Süd",
    alarms={"contacts": {"wall": PRIVATE[1]}},
    notifications={"receivers": {"chat": {"url": f"https://{PRIVATE[0]}/T0", "secret_env": "S"}}},
)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Return a folder without a recorder; its sets name private settings and the host."""
    folder = tmp_path_factory.mktemp("finished")
    filled = FilledFolder(folder, SETTINGS, shots_per_set=2)
    for index in range(SETS):
        filled.add_set(index)
    filled.close()
    origin = {"configuration": SETTINGS.model_dump(mode="json"), "host": PRIVATE[2]}
    for path in set_files(folder).values():
        path.write_bytes(build_set_image(replace(read_set(path), provenance=origin)))
    return folder


@pytest.fixture
def folder(finished, tmp_path):
    return shutil.copytree(finished, tmp_path / "data")


def export(folder, target, *options):
    """Run the command; return the exit code and its JSON, or the error."""
    words = ["export", "--data-dir", folder, "--ro-crate", target, *options, "--json"]
    done = CliRunner().invoke(cli, list(map(str, words)))
    if hasattr(done.exception, "exit_code"):
        return done.exception.exit_code, str(done.exception)
    if not isinstance(done.exception, SystemExit | type(None)):
        raise done.exception
    return done.exit_code, json.loads(done.stdout)


def check_crate(crate):
    """Check a crate by the rules of RO-Crate 1.2, and return its entities by their identifier."""
    document = json.loads((crate / "ro-crate-metadata.json").read_text("utf-8"))
    assert document.keys() == {"@context", "@graph"}
    assert document["@context"][0] == f"{SPECIFICATION}/context"
    entities = {entity["@id"]: entity for entity in document["@graph"]}
    assert len(entities) == len(document["@graph"]), "each identifier occurs once"
    assert all(entity["@type"] and entity.get("name", "-") for entity in entities.values())
    descriptor = entities["ro-crate-metadata.json"]
    assert descriptor["@type"] == "CreativeWork"
    assert descriptor["about"] == {"@id": "./"}
    assert descriptor["conformsTo"] == {"@id": SPECIFICATION}
    root = entities["./"]
    assert root["@type"] == "Dataset"
    assert root["name"]
    assert root["description"]
    assert datetime.fromisoformat(root["datePublished"]).date() == datetime.now(UTC).date()
    parts = [part["@id"] for part in root["hasPart"]]
    on_disk = {path.relative_to(crate).as_posix() for path in crate.rglob("*") if path.is_file()}
    assert sorted(parts) == sorted(on_disk - {"ro-crate-metadata.json"})
    for part in parts:
        content = (crate / part).read_bytes()
        assert entities[part]["@type"] == "File"
        assert re.fullmatch(r"\w+/[\w.+-]+", entities[part]["encodingFormat"])
        assert entities[part]["contentSize"] == str(len(content))
        assert entities[part]["sha256"] == hashlib.sha256(content).hexdigest()
    assert root["contentSize"] == str(sum((crate / part).stat().st_size for part in parts))
    reached, waiting = set(), ["ro-crate-metadata.json"]
    while waiting:
        reached.add(name := waiting.pop())
        named = {reference["@id"] for reference in references(entities[name])} - {SPECIFICATION}
        assert named <= entities.keys(), "the graph is flat and complete"
        waiting += named - reached
    assert reached == entities.keys(), "nothing is described that the test does not refer to"
    return entities


def references(value):
    """Yield each reference within an entity."""
    if isinstance(value, list):
        for item in value:
            yield from references(item)
    elif isinstance(value, dict):
        if value.keys() == {"@id"}:
            yield value
        else:
            for item in value.values():
                yield from references(item)


def test_a_crate_describes_test_files_columns_instruments_and_software(folder, tmp_path):
    with open_catalogue(folder) as catalogue:
        uuid = catalogue.read_experiment().uuid
    options = ("--license", "CC-BY-4.0", "--author", "Ada Lovelace https://orcid.org/0000-0001-2345-6789")
    code, answer = export(folder, tmp_path / "crate", *options, "--author", "Ben")
    assert (code, answer["ok"], answer["sets"], answer["left_out"]) == (0, True, SETS, {})
    entities = check_crate(tmp_path / "crate")
    root = entities["./"]
    assert (root["name"], root["identifier"]) == (SETTINGS.name, f"urn:uuid:{uuid}")
    assert entities[root["license"]["@id"]]["name"] == "CC-BY-4.0"
    assert root["author"] == [{"@id": "https://orcid.org/0000-0001-2345-6789"}, {"@id": "#author-2"}]
    assert [entities[author["@id"]]["name"] for author in root["author"]] == ["Ada Lovelace", "Ben"]
    assert root["temporalCoverage"].startswith("2024-01-01T00:00:00")
    assert answer["n_bytes"] == int(root["contentSize"])
    tools = [entities[tool["@id"]] for tool in entities["#recording"]["instrument"]]
    assert [tool["version"] for tool in tools if tool["@type"] == "SoftwareApplication"] == ["0", "0.1.0"]
    names = [tool["name"] for tool in tools if tool["@type"] == "IndividualProduct"]
    assert names == [f"Position {name}" for name in "ABCD"]
    calibrated = entities["#position-B"]["description"]
    assert calibrated == "solitary_wave, HNSW transducer, 25.4 mm patch, certificate K-7"
    for table in TABLES:
        columns = [column["@id"] for column in entities[f"tables/{table}.csv"]["variableMeasured"]]
        header = pd.read_csv(tmp_path / f"crate/tables/{table}.csv").columns
        assert [entities[column]["name"] for column in columns] == list(header)
    assert entities["#features/tof_pp_s"]["unitText"] == "s"
    assert entities["#features/tof_pp_s"]["description"].startswith("Time of flight")
    assert "unitText" not in entities["#features/quality"]


def test_a_crate_holds_every_record_and_nothing_private(folder, tmp_path):
    assert export(folder, tmp_path / "crate")[0] == 0
    entities = check_crate(tmp_path / "crate")
    assert "license" not in entities["./"]
    assert "author" not in entities["./"]
    copies = set_files(tmp_path / "crate")
    assert copies.keys() == set(range(SETS))
    for index, path in set_files(folder).items():
        assert verify_set(copies[index]) == []
        stored, copied = read_set(path), read_set(copies[index])
        assert [shot.waveform.counts.tolist() for shot in copied.shots] == [
            shot.waveform.counts.tolist() for shot in stored.shots
        ]
        assert (copied.due_h, len(copied.echoes)) == (stored.due_h, len(stored.echoes))
        with h5py.File(copies[index]) as file:
            text = file["entry/provenance/data"].asstr()[0]
        assert [word for word in PRIVATE if word in text] == []
        assert json.loads(text)["configuration"]["schedule"]["shots_per_set"] == 10
        assert all(word in json.dumps(dict(stored.provenance)) for word in PRIVATE), "the original has them"
    others = [path for path in (tmp_path / "crate").rglob("*") if path.is_file() and path.suffix != ".h5"]
    assert len(others) == len(TABLES) + 3
    assert [path for path in others for word in PRIVATE if word.encode() in path.read_bytes()] == []


def test_missing_and_corrupt_sets_are_left_out_and_those_of_the_journal_are_not(folder, tmp_path):
    files = set_files(folder)
    record = read_set(files[1])
    files[0].unlink()
    files[1].unlink()
    files[2].write_bytes(files[2].read_bytes()[:3000])
    with journal_of(folder, record):
        code, answer = export(folder, tmp_path / "crate")
    assert (code, answer["ok"], answer["sets"]) == (4, False, 1)
    assert sorted(answer["left_out"]) == sorted(f"sets/{files[index].name}" for index in (0, 2))
    check_crate(tmp_path / "crate")
    assert set_files(tmp_path / "crate").keys() == {1}


def test_without_the_extra_report_the_rest_is_exported(folder, tmp_path, monkeypatch):
    def refuse(folder):
        raise MissingExtraError("matplotlib is not installed")

    monkeypatch.setattr(ro_crate, "build_report_page", refuse)
    code, answer = export(folder, tmp_path / "crate")
    assert (code, answer["ok"]) == (0, True)
    assert answer["left_out"] == {"report.html": "matplotlib is not installed"}
    assert "report.html" not in check_crate(tmp_path / "crate")


def test_a_crate_is_replaced_only_with_overwrite_and_a_test_never(folder, tmp_path):
    crate = tmp_path / "crate"
    assert export(folder, crate)[0] == 0
    code, message = export(folder, crate)
    assert code == 2
    assert "--overwrite" in message
    assert export(folder, crate, "--overwrite", "--license", "https://example.org/terms")[0] == 0
    assert check_crate(crate)["./"]["license"] == {"@id": "https://example.org/terms"}
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    for target in (folder, folder / "sets", folder / "sets" / "crate", tmp_path / "no" / "crate"):
        assert export(folder, target, "--overwrite")[0] == 2, target
    code, message = export(folder, tmp_path / "other", "--license", "free for all")
    assert code == 2
    assert "CC-BY-4.0" in message
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
    assert not (tmp_path / "other").exists()


def test_an_interrupted_export_has_no_metadata(folder, tmp_path, monkeypatch):
    crate = tmp_path / "crate"
    assert export(folder, crate)[0] == 0

    def fail(*arguments, **options):
        raise StorageUnavailableError("the disk is full")

    monkeypatch.setattr(ro_crate, "encode_table", fail)
    assert export(folder, crate, "--overwrite") == (4, "the disk is full")
    assert not (crate / "ro-crate-metadata.json").exists()
