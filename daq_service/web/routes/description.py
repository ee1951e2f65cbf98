"""OpenAPI additions: tokens and roles, descriptions of names, units, examples."""

from __future__ import annotations

import json
from collections.abc import Collection
from functools import cache
from pathlib import Path
from typing import Any

from daq_service.shared_file import read_shared
from daq_service.web.answers.models import PROBLEMS
from daq_service.web.answers.vocabulary import MEANINGS, RATIOS, VOCABULARY, look_up_scoped_value
from daq_service.web.auth.roles import OPERATIONS, ORDERS
from hardware_drivers.units import find_unit

OpenApi = dict[str, Any]
"""Document of OpenAPI, or a part of it, as FastAPI makes it."""


def describe_security(document: OpenApi) -> None:
    """Add security schemes to an OpenAPI document, and role and error answers to each operation, in place.

    An operation without an entry in `OPERATIONS` needs admin. Without a token (``{}`` in the list) a service
    on loopback accepts requests before the first token is created. Commands get ``x-role-by-kind``.
    """
    document["components"]["securitySchemes"] = VOCABULARY.schemes
    for item in document["paths"].values():
        for operation in item.values():
            role = OPERATIONS.get(operation["operationId"], "admin")
            if role is None:
                operation["security"] = [{}]
                refusals = [401, 429] if operation["operationId"] == "log_in" else []
            else:
                operation["security"] = [{"token": [role]}, {"cookie": [role]}, {}]
                refusals = [401, 403, 429]
            operation["responses"] |= {str(status): PROBLEMS[status] for status in refusals}
    orders = document["paths"].get("/api/v1/commands")
    if orders is not None:
        orders["post"]["x-role-by-kind"] = dict(ORDERS)


@cache
def load_examples() -> OpenApi:
    """Load the stored example answers by operation (`python tests/contract/test_openapi.py`). Cached.

    Raises OSError if the file cannot be read.
    """
    example_answers: OpenApi = json.loads(
        read_shared(Path(__file__).parents[1] / "answers" / "examples.json")
    )
    return example_answers


def describe_names(document: OpenApi) -> None:
    """Add tags, descriptions of names, units of numbers, and examples to an OpenAPI document, in place."""
    operations = [operation for item in document["paths"].values() for operation in item.values()]
    used = {tag for operation in operations for tag in operation.get("tags", ())}
    document["tags"] = [
        {"name": name, "description": text} for name, text in VOCABULARY.tags.items() if name in used
    ]
    for schema, documented in document["components"]["schemas"].items():
        for name, part in documented.get("properties", {}).items():
            _describe_name(part, schema, name, part)
    for operation in operations:
        for parameter in operation.get("parameters", ()):
            _describe_name(parameter, operation["operationId"], parameter["name"], parameter["schema"])
            example = look_up_scoped_value(VOCABULARY.examples, operation["operationId"], parameter["name"])
            if parameter["required"] and example is not None:
                parameter["example"] = example
        _add_example(operation)


def _describe_name(documented: OpenApi, scope: str, name: str, schema: OpenApi) -> None:
    """Add description and, for a number, unit (UDUNITS) of a name to a property or parameter, in place.

    An existing description stays; a number without a known unit gets none.
    """
    if (text := look_up_scoped_value(MEANINGS, scope, name)) is not None:
        documented.setdefault("description", text)
    if not is_numeric_schema(schema):
        return
    unit = find_unit(name) or VOCABULARY.units.get(name)
    if unit is None and (name.endswith(RATIOS) or not is_numeric_schema(schema, {"number"})):
        unit = "1"
    if unit:
        documented["x-unit"] = unit


def is_numeric_schema(schema: object, kinds: Collection[str] = ("number", "integer")) -> bool:
    """Return whether values of a JSON Schema are numbers of these kinds, or contain them."""
    if not isinstance(schema, dict):
        return False
    parts = [*schema.get("anyOf", ()), schema.get("items"), schema.get("additionalProperties")]
    return schema.get("type") in kinds or any(is_numeric_schema(part, kinds) for part in parts)


def _add_example(operation: OpenApi) -> None:
    """Add the stored example, if any, to the response and body of an operation, in place."""
    example = load_examples().get(operation["operationId"])
    if example is None:
        return
    status, media_type = example["status"], example["media_type"]
    content = operation["responses"].get(status, {}).get("content", {})
    if media_type in content:
        content[media_type]["example"] = example["answer"]
    if "body" in example and "requestBody" in operation:
        operation["requestBody"]["content"]["application/json"]["example"] = example["body"]
