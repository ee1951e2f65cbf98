"""``export --ro-crate``: a folder with the data of a test and RO-Crate 1.2 metadata, for a repository.

::

    ro-crate-metadata.json   JSON-LD: the test, each file, columns with units, instruments, software
    configuration.json       the stored configuration without private keys
    report.html              absent without the extra ``report``
    sets/*.h5                a file per set, as in the data folder, with that configuration
    tables/*.csv             every table of the test
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from daq_service.archive import ArchiveError, FolderSetReader, SetReference
from daq_service.archive.layout import build_set_image
from daq_service.catalogue import Catalogue, open_catalogue
from daq_service.catalogue.connection import FILE_NAME
from daq_service.catalogue.rows import ExperimentRow, SetRow, list_columns
from daq_service.cli.maintenance.export import refuse_unsafe_target
from daq_service.clock import format_utc
from daq_service.errors import UsageError
from daq_service.processes.freshness import Freshness
from daq_service.settings.stored import remove_private_keys
from daq_service.settings.tables import Tables
from daq_service.shared_file import remove_quietly, write_output
from daq_service.web.report.make import build_report_page
from daq_service.web.tables.choice import TABLES, Choice
from daq_service.web.tables.export import encode_table

METADATA, REPORT = "ro-crate-metadata.json", "report.html"
SPECIFICATION = "https://w3id.org/ro/crate/1.2"
CONTEXT = [f"{SPECIFICATION}/context", {"sha256": "http://schema.org/sha256"}]
LICENSE = re.compile(r"[A-Za-z0-9.+-]+|https?://\S+")
HDF5, CSV, JSON, HTML = "application/x-hdf5", "text/csv", "application/json", "text/html"

Entity = dict[str, object]
"""Entity of the JSON-LD graph."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Crate:
    """Result of an export; ``left_out``: what is not in the folder, and why."""

    folder: str
    n_bytes: int
    files: int
    sets: int
    left_out: Mapping[str, str]


def export_ro_crate(
    folder: Path,
    target: Path,
    *,
    license_name: str | None = None,
    authors: Sequence[str] = (),
    overwrite: bool = False,
    progress: Callable[[int, int], None] = lambda done, planned: None,
) -> Crate:
    """Write data and metadata of a test, also of one that runs, to a folder; the metadata come last.

    Parameters
    ----------
    license_name
        SPDX identifier or URL; None: the crate names none.
    authors
        Names, each with an ORCID URL at the end if there is one.
    overwrite
        Replace the files of an earlier export; other files in the folder stay.
    progress
        Receives the numbers of sets done and in all.

    Raises
    ------
    UsageError
        There is no test; ``target`` exists, or is or would be within a test's own files; a malformed license.
    StorageError
        The catalogue cannot be read.
    StorageUnavailableError
        The disk does not take a file.
    """
    if license_name is not None and not LICENSE.fullmatch(license_name):
        raise UsageError(f"--license {license_name!r} is no SPDX identifier or URL; give one as CC-BY-4.0")
    is_replaced = overwrite and target.is_dir() and not (target / FILE_NAME).exists()
    refuse_unsafe_target(folder, target / METADATA if is_replaced else target, overwrite=overwrite)
    remove_quietly(target / METADATA)
    with open_catalogue(folder) as catalogue:
        experiment = catalogue.read_experiment()
        fresh = Freshness(folder, catalogue, experiment.clock)
        configuration = remove_private_keys(experiment.configuration)
        write_output(target / "configuration.json", json.dumps(configuration, indent=1).encode())
        graph = [_describe_file(target, "configuration.json", "Configuration of the test", JSON)]
        left_out = dict[str, str]()
        try:
            write_output(target / REPORT, build_report_page(folder))
            graph.append(_describe_file(target, REPORT, "Report of the test", HTML))
        except UsageError as error:
            left_out[REPORT] = str(error)
        sets = _write_sets(catalogue, folder, target, left_out, progress)
        graph += [*sets, *_write_tables(catalogue, fresh, target)]
        parts = [entity for entity in graph if entity["@type"] == "File"]
        started = catalogue.read_last_service_event("recorder_started")
        identity = {} if started is None else started.payload.get("rig_identity", {})
        graph += _describe_origin(experiment, fresh, configuration, identity)
        root = _describe_test(experiment, fresh, configuration, parts, len(sets))
    graph += _describe_publication(root, license_name, authors)
    descriptor = _build_entity(
        METADATA, "CreativeWork", about={"@id": "./"}, conformsTo={"@id": SPECIFICATION}
    )
    content = {"@context": CONTEXT, "@graph": [descriptor, root, *graph]}
    write_output(target / METADATA, json.dumps(content, indent=1, ensure_ascii=False).encode())
    return Crate(
        folder=str(target),
        n_bytes=int(str(root["contentSize"])),
        files=len(parts),
        sets=len(sets),
        left_out=left_out,
    )


def _write_sets(
    catalogue: Catalogue,
    folder: Path,
    target: Path,
    left_out: dict[str, str],
    progress: Callable[[int, int], None],
) -> list[Entity]:
    """Write a file of each readable set, also from the journal, and return their entities.

    Adds missing and unreadable sets with their reason to ``left_out``.
    """
    archive, entities = FolderSetReader(folder), list[Entity]()
    files = sorted({SetReference(row.file) for row in catalogue.rows(SetRow, purpose="any") if row.file})
    for number, file in enumerate(files):
        progress(number, len(files))
        try:
            record = archive.read_set(file)
        except ArchiveError as error:
            left_out[file] = str(error)
            continue
        public = {name: value for name, value in record.provenance.items() if name != "host"}
        public["configuration"] = remove_private_keys(public.get("configuration", {}))
        write_output(target / file, build_set_image(replace(record, provenance=public)))
        name = f"Set {record.set_index}, due at hour {record.due_h:g}"
        if record.unscheduled_index:
            name = f"Unscheduled set {record.unscheduled_index} after set {record.set_index}"
        entities.append(_describe_file(target, file, name, HDF5))
    progress(len(files), len(files))
    return entities


def _write_tables(catalogue: Catalogue, fresh: Freshness, target: Path) -> list[Entity]:
    """Write every table as CSV, with unscheduled sets; return the entities of files and columns."""
    entities = list[Entity]()
    for table, kind in TABLES.items():
        choice = Choice(table=table, purpose="any" if kind.unscheduled_set else "planned")
        path = f"tables/{table}.csv"
        write_output(target / path, encode_table(catalogue, fresh, choice, "csv"))
        descriptions = {column.published_name: column.description for column in list_columns(kind.row)}
        columns = [
            _build_entity(
                *(f"#{table}/{column.name}", "PropertyValue", column.name),
                description=descriptions.get(column.name),
                unitText=column.unit,
            )
            for column in choice.columns
        ]
        entities.append(_describe_file(target, path, kind.description, CSV))
        entities[-1]["variableMeasured"] = _refer(columns)
        entities += columns
    return entities


def _describe_file(target: Path, path: str, name: str, media_type: str) -> Entity:
    """Return the entity of a written file: size in bytes and SHA-256 as read from the disk."""
    with (target / path).open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    n_bytes = str((target / path).stat().st_size)
    return _build_entity(path, "File", name, encodingFormat=media_type, contentSize=n_bytes, sha256=digest)


def _describe_test(
    experiment: ExperimentRow, fresh: Freshness, configuration: Tables, parts: Sequence[Entity], n_sets: int
) -> Entity:
    """Return the root data entity: what was tested when and where, and its files."""
    kind = configuration["rig"]["kind"]
    description = (
        f"{n_sets} sets at the positions {', '.join(configuration['positions'])}, hours 0 to "
        f"{fresh.now_h:.1f} of a test with highly nonlinear solitary waves (rig: {kind}). sets/ holds the "
        "waveforms, tables/ features, assessments and alarms. The column file_sha256 of tables/sets.csv is "
        "that of the original file, which also held private settings."
    )
    times = [format_utc(time_ns) for time_ns in (experiment.epoch_utc_ns, fresh.now_utc_ns)]
    return _build_entity(
        *("./", "Dataset", experiment.name),
        description=description,
        identifier=f"urn:uuid:{experiment.uuid}" if experiment.uuid else None,
        datePublished=datetime.now(UTC).date().isoformat(),
        temporalCoverage="/".join(times),
        contentLocation={"@id": "#site"} if experiment.site else None,
        contentSize=str(sum(int(str(file["contentSize"])) for file in parts)),
        hasPart=_refer(parts),
        mentions={"@id": "#recording"},
    )


def _describe_origin(
    experiment: ExperimentRow, fresh: Freshness, configuration: Tables, identity: Mapping[str, str]
) -> list[Entity]:
    """Return the entities of site, software, instruments, and of the recording that used them.

    ``identity`` is that of the rig: its boards, or the twin, with their versions.
    """
    versions = dict.fromkeys((experiment.solimon_version, version("solimon")))
    tools = [
        _build_entity(f"#solimon-{text}", "SoftwareApplication", "solimon", version=text) for text in versions
    ]
    tools += [
        _build_entity(
            *(f"#position-{name}", "IndividualProduct", f"Position {name}"),
            description=", ".join(
                [
                    *filter(None, (place["method"], place.get("label"))),
                    *(f"{key} {value}" for key, value in place.get("calibration", {}).items() if value),
                ]
            ),
            serialNumber=place.get("serial_number"),
        )
        for name, place in configuration["positions"].items()
    ]
    rig = ", ".join(f"{name}: {text}" for name, text in identity.items())
    recording = _build_entity(
        *("#recording", "CreateAction", "Recording of the test"),
        description=rig or configuration["rig"]["kind"],
        startTime=format_utc(experiment.epoch_utc_ns),
        endTime=format_utc(fresh.now_utc_ns),
        instrument=_refer(tools),
        object={"@id": "configuration.json"},
        result={"@id": "./"},
    )
    site = [_build_entity("#site", "Place", experiment.site)] if experiment.site else []
    return [recording, *tools, *site]


def _describe_publication(root: Entity, license_name: str | None, authors: Sequence[str]) -> list[Entity]:
    """Return the entities of license and authors, and refer to them in the root entity."""
    entities = list[Entity]()
    for number, author in enumerate(authors, 1):
        name, _, url = author.rpartition(" ") if "https://" in author else (author, "", f"#author-{number}")
        entities.append(_build_entity(url, "Person", name or author))
    if entities:
        root["author"] = _refer(entities)
    if license_name is not None:
        is_url = license_name.startswith("http")
        url = license_name if is_url else f"https://spdx.org/licenses/{license_name}"
        entities.append(_build_entity(url, "CreativeWork", license_name))
        root["license"] = {"@id": url}
    return entities


def _refer(entities: Sequence[Entity]) -> list[Entity]:
    """Return the references to entities."""
    return [{"@id": entity["@id"]} for entity in entities]


def _build_entity(entity_id: str, kind: str, name: str | None = None, **values: object) -> Entity:
    """Return an entity of the graph without values that are None or empty."""
    entity = {"@id": entity_id, "@type": kind, "name": name, **values}
    return {key: value for key, value in entity.items() if value not in (None, "")}
