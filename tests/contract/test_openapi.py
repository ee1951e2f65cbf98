"""The interface is a promise: a change of it shows as a change of `openapi.json`.

Renew the snapshot after a wanted change::

    python tests/contract/test_openapi.py
"""

import json
from pathlib import Path

import pytest

from daq_service.settings.tree import Settings
from daq_service.web.app import create_app

SNAPSHOT = Path(__file__).with_name("openapi.json")
METHODS = ("get", "post", "put", "patch", "delete")


def description(folder: Path) -> dict:
    return create_app(Settings(), folder).openapi()


def as_text(document: dict) -> str:
    return json.dumps(document, indent=1, sort_keys=True, ensure_ascii=False) + "\n"


@pytest.fixture(scope="module")
def document(tmp_path_factory):
    return description(tmp_path_factory.mktemp("empty"))


@pytest.fixture(scope="module")
def operations(document):
    return [
        (path, method, item[method])
        for path, item in document["paths"].items()
        for method in METHODS
        if method in item
    ]


def test_description_is_the_snapshot(document):
    assert as_text(document) == SNAPSHOT.read_text(encoding="utf-8"), (
        "the interface changed; if that is wanted: python tests/contract/test_openapi.py"
    )


def test_version_of_the_description_language(document):
    assert document["openapi"].startswith("3.1.")


def test_operation_ids_are_written_by_hand_and_unique(operations):
    ids = [operation["operationId"] for _, _, operation in operations]
    assert len(ids) == len(set(ids))
    for name in ids:
        # FastAPI's own ids end in the path and method and change with them.
        assert not name.endswith(("_get", "_post")), name
        assert "api_v1" not in name


def test_paths_are_versioned_but_for_the_probes(document):
    unversioned = {path for path in document["paths"] if not path.startswith("/api/v1/")}
    assert unversioned == {"/healthz", "/readyz", "/metrics"}


def test_every_error_is_a_problem(operations):
    for path, _, operation in operations:
        for status, answer in operation["responses"].items():
            if status >= "400":
                assert set(answer["content"]) == {"application/problem+json"}, (path, status)


def test_every_json_answer_has_a_shape(operations):
    for path, _, operation in operations:
        for status, answer in operation["responses"].items():
            if status.startswith("2") and "application/json" in answer["content"]:
                schema = answer["content"]["application/json"]["schema"]
                assert set(references(schema)), (path, schema)


def references(node):
    if isinstance(node, dict):
        yield from ([node["$ref"]] if "$ref" in node else [])
        for part in node.values():
            yield from references(part)
    elif isinstance(node, list):
        for part in node:
            yield from references(part)


def test_every_reference_leads_somewhere(document):
    for reference in set(references(document)):
        node = document
        for part in reference.removeprefix("#/").split("/"):
            node = node[part]


def test_operations_with_parameters_document_their_422(operations):
    for path, _, operation in operations:
        if any(part["in"] in {"query", "path"} for part in operation.get("parameters", [])):
            assert "422" in operation["responses"], path


if __name__ == "__main__":
    SNAPSHOT.write_text(as_text(description(Path())), encoding="utf-8")
