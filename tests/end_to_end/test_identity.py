"""The UUID of a test: in catalogue, experiment file and set files; another one where a copy continues."""

import json
import uuid
from dataclasses import replace

import orjson
from support.small_experiment import SMALL, run, small_settings
from support.stored_files import read_set, set_files

from daq_service.catalogue import open_catalogue
from daq_service.catalogue.earlier_names import derive_uuid
from daq_service.catalogue.rows import EventRow
from daq_service.cli.maintenance.backup import back_up
from daq_service.processes.data_folder import BACKUP_FILE


def until(end_h):
    settings = small_settings(schedule={**SMALL["schedule"], "end_h": end_h})
    return settings.model_copy(update={"site": "Hall 3"})


def uuids(folder):
    """Return the UUIDs of catalogue and experiment file, and of the newest set."""
    with open_catalogue(folder) as catalogue:
        row = catalogue.read_experiment()
    file = orjson.loads((folder / "experiment.json").read_bytes())["experiment"]
    files = set_files(folder)
    newest = read_set(files[max(files)]).provenance["experiment"]
    assert {row.site, file["site"], newest["site"]} == {"Hall 3"}
    return [row.uuid, file["uuid"], newest["uuid"]]


def test_a_backup_has_the_uuid_of_its_test_until_it_continues(tmp_path):
    folder, copy = tmp_path / "data", tmp_path / "copy"
    assert run(until(0.5), folder)
    (created,) = set(uuids(folder))
    assert uuid.UUID(created).version == 4
    back_up(folder, copy)
    assert set(uuids(copy)) == {created}
    assert run(until(1.0), copy)
    (separated,) = set(uuids(copy))
    assert separated != created
    with open_catalogue(copy) as catalogue:
        (event,) = catalogue.rows(EventRow, topic="service", kind="copy_continued")
    assert event.payload == {"uuid": separated, "original_uuid": created}
    assert run(until(1.5), copy)
    assert set(uuids(copy)) == {separated}, "it is a test of its own now"
    assert run(until(1.0), folder)
    assert set(uuids(folder)) == {created}


def test_a_backup_of_an_earlier_version_is_recognised_without_a_uuid(tmp_path):
    folder, copy = tmp_path / "data", tmp_path / "copy"
    assert run(until(0.5), folder)
    with open_catalogue(folder) as catalogue:
        row = catalogue.read_experiment()
    back_up(folder, copy)
    marker = json.loads((copy / BACKUP_FILE).read_text())
    del marker["uuid"]
    (copy / BACKUP_FILE).write_text(json.dumps(marker))
    with open_catalogue(copy, writer=True) as catalogue:
        earlier = derive_uuid(row.configuration_hash, row.epoch_utc_ns)
        catalogue.restore_rows([replace(row, uuid=earlier)])
    assert run(until(1.0), copy)
    assert uuids(copy)[0] not in {row.uuid, earlier}
