"""The interface is a promise: a change of it shows as a change of `openapi.json`.

Renew the snapshots and the examples after a wanted change::

    PYTHONPATH=tests python tests/contract/test_openapi.py

Examples that are there stay as they are, but with ``--anew``.
"""

import ast
import inspect
import json
import re
import sys
import tempfile
from pathlib import Path

import pytest
from fastapi.routing import APIRoute

from daq_service.assessment.methods import METHODS
from daq_service.settings.tree import Settings
from daq_service.web.answers.models import AlarmEvidence
from daq_service.web.app import RESOURCES, create_app
from daq_service.web.multi_test.app import RESOURCES as OF_SEVERAL
from daq_service.web.multi_test.app import create_multi_test_app
from daq_service.web.routes import health, metrics
from daq_service.web.routes.description import is_numeric_schema, load_examples

SNAPSHOT = Path(__file__).with_name("openapi.json")
VERBS = ("get", "post", "put", "patch", "delete")
ROOT = Path(__file__).resolve().parents[2]


def description(folder):
    return create_app(Settings(), folder).openapi()


def description_of_several(folder):
    return create_multi_test_app([], Settings(), folder).openapi()


DESCRIPTIONS = {"a test": description, "several tests": description_of_several}
SNAPSHOTS = {"a test": SNAPSHOT, "several tests": SNAPSHOT.with_name("openapi_of_several.json")}


def as_text(document):
    return json.dumps(document, indent=1, sort_keys=True, ensure_ascii=False) + "\n"


@pytest.fixture(scope="module")
def documents(tmp_path_factory):
    return {which: made(tmp_path_factory.mktemp("empty")) for which, made in DESCRIPTIONS.items()}


@pytest.fixture(scope="module")
def document(documents):
    return documents["a test"]


@pytest.fixture(scope="module")
def operations(document):
    return [
        (path, method, item[method])
        for path, item in document["paths"].items()
        for method in VERBS
        if method in item
    ]


@pytest.mark.parametrize("which", DESCRIPTIONS)
def test_description_is_the_snapshot(documents, which):
    assert as_text(documents[which]) == SNAPSHOTS[which].read_text(encoding="utf-8"), (
        "the interface changed; if that is wanted: PYTHONPATH=tests python tests/contract/test_openapi.py"
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
            if status.startswith("2") and "application/json" in answer.get("content", {}):
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


def described(document):
    """Yield every item that needs a description, with its location."""
    schemas = document["components"]["schemas"]
    for schema, its in schemas.items():
        for name, description in its.get("properties", {}).items():
            yield f"schema {schema}, property {name}", description, description
    for path, item in document["paths"].items():
        for method, operation in item.items():
            for description in operation.get("parameters", ()):
                yield f"{method} {path}, parameter {description['name']}", description, description["schema"]


@pytest.mark.parametrize("which", DESCRIPTIONS)
def test_every_name_is_described_and_every_number_has_its_unit(documents, which):
    """A newcomer says it in `Field(description=...)`, or once for all in `web/answers/words.py`."""
    lacking = []
    for place, description, schema in described(documents[which]):
        if not description.get("description"):
            lacking.append(f"{place}: what is it? describe it")
        if is_numeric_schema(schema) and "x-unit" not in description:
            lacking.append(f"{place}: unit? end the name in it, or put the name into PURE of words.py")
        if (
            is_numeric_schema(schema)
            and description.get("x-unit") == "own"
            and "unit" not in description["description"]
        ):
            lacking.append(f"{place}: say where its unit stands")
    assert not lacking, "\n".join(lacking)


@pytest.mark.parametrize("which", DESCRIPTIONS)
def test_every_operation_has_a_description_a_tag_its_problems_and_an_example(documents, which):
    document = documents[which]
    tags = {tag["name"]: tag["description"] for tag in document["tags"]}
    lacking = []
    for path, item in document["paths"].items():
        for method, operation in item.items():
            place = f"{method} {path}"
            if not operation.get("description"):
                lacking.append(f"{place}: what does it do? write a docstring")
            if not operation.get("tags") or not set(operation["tags"]) <= tags.keys():
                lacking.append(f"{place}: vocabulary.toml describes its tag")
            if operation["security"] != [{}] and not {"401", "403", "429"} <= operation["responses"].keys():
                lacking.append(f"{place}: its refusals are missing")
            needs = [p for p in operation.get("parameters", ()) if p["required"]]
            if any("example" not in p for p in needs):
                lacking.append(f"{place}: an example of a parameter is missing (examples of vocabulary.toml)")
            answers = (its for status, its in operation["responses"].items() if status < "300")
            content = next(answers).get("content", {})
            readable = [kind for kind in content if re.search("json|event-stream|openmetrics", kind)]
            if any("example" not in content[kind] for kind in readable) or not content:
                lacking.append(f"{place}: an example of its answer is missing; run this file")
            body = operation.get("requestBody")
            if body is not None and "example" not in body["content"]["application/json"]:
                lacking.append(f"{place}: a body is missing (BODIES of support/api_examples.py)")
    assert not lacking, "\n".join(lacking)


def api_routes():
    routers = [resource.router for resource in (*RESOURCES, *OF_SEVERAL)]
    routers += [module.probes for module in (health, metrics)]
    return [route for router in routers for route in router.routes if isinstance(route, APIRoute)]


def test_no_dependency_of_an_operation_stands_in_line_for_a_thread():
    """FastAPI hands plain functions to its forty threads, which a thousand streams would all hold."""
    waiting, calls = [route.dependant for route in api_routes()], set()
    while waiting:
        below = waiting.pop().dependencies
        calls |= {one.call for one in below}
        waiting += below
    assert len(calls) >= 3  # test, person, who gives an order
    assert [call for call in calls if not inspect.iscoroutinefunction(call)] == []


def test_every_example_is_an_answer_of_its_operation():
    models = {route.name: route.response_model for route in api_routes()}
    held = [name for name, model in models.items() if model is not None and name in load_examples()]
    for name in held:
        models[name].model_validate(load_examples()[name]["answer"])
    assert len(held) > 25


def test_every_part_of_the_evidence_is_described():
    """Where conditions are built; `AlarmEvidence` has a field for each key of their evidence."""
    keys = set()
    for path in (ROOT / "daq_service").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            named = isinstance(node, ast.keyword) and node.arg == "evidence"
            kept = isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "evidence"
            if (named or kept) and isinstance(node.value, ast.Dict):
                keys |= {key.value for key in node.value.keys if key is not None}  # None: **other
    assert {"rule", "consecutive_poor_sets"} <= keys
    assert keys - AlarmEvidence.model_fields.keys() == set()


def test_fields_of_a_trend_are_an_array_of_known_names_and_its_columns_have_types(document):
    parameters = document["paths"]["/api/v1/trends/{position}"]["get"]["parameters"]
    (fields,) = (part for part in parameters if part["name"] == "fields")
    array = next(part for part in fields["schema"]["anyOf"] if part.get("type") == "array")
    columns = document["components"]["schemas"]["TrendColumns"]["properties"]
    assert set(array["items"]["enum"]) < columns.keys()
    assert {*METHODS["solitary_wave"].value_names, *METHODS["pulse_echo"].value_names} < set(
        array["items"]["enum"]
    )
    assert columns["tof_pp_s"]["items"]["anyOf"][0] == {"type": "number"}
    assert columns["outlier"]["items"]["anyOf"][0] == {"type": "boolean"}


if __name__ == "__main__":
    from support.api_examples import write_examples

    with tempfile.TemporaryDirectory() as folder:
        write_examples(Path(folder), renew="--anew" in sys.argv)
    load_examples.cache_clear()
    for which, snapshot in SNAPSHOTS.items():
        snapshot.write_text(as_text(DESCRIPTIONS[which](Path())), encoding="utf-8")
