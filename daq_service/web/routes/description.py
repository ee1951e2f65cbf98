"""OpenAPI additions: tokens and roles, descriptions of names, units, examples."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from daq_service.shared_file import read_shared
from daq_service.web.answers.models import PROBLEMS
from daq_service.web.answers.vocabulary import EXAMPLES, MEANINGS, OTHER_UNITS, OWN_UNIT, PURE, RATIOS, TAGS
from daq_service.web.auth.roles import OPERATIONS, ORDERS
from hardware_drivers.units import unit_of

SCHEMES = {
    "token": {"type": "http", "scheme": "bearer", "description": "A token of `solimon token create`"},
    "cookie": {
        "type": "apiKey",
        "in": "cookie",
        "name": "solimon",
        "description": "Of `log_in`; the name ends in a mark of the service and over TLS begins with __Host-",
    },
}


def describe_roles(document: dict[str, Any]) -> None:
    """Add security schemes, roles and refusals to an OpenAPI document.

    The empty alternative: a service on loopback requires no token before the first one is created.
    """
    document["components"]["securitySchemes"] = SCHEMES
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
def examples() -> dict[str, Any]:
    """Return example answers of a real service by operation (`python tests/contract/test_openapi.py`)."""
    example_answers: dict[str, object] = json.loads(
        read_shared(Path(__file__).parents[1] / "answers" / "examples.json")
    )
    return example_answers


def describe_names(document: dict[str, Any]) -> None:
    """Add descriptions of names, units of numbers, and examples to an OpenAPI document."""
    operations = [operation for item in document["paths"].values() for operation in item.values()]
    used = {tag for operation in operations for tag in operation.get("tags", ())}
    document["tags"] = [{"name": name, "description": text} for name, text in TAGS.items() if name in used]
    for schema, documented in document["components"]["schemas"].items():
        for name, part in documented.get("properties", {}).items():
            _describe(part, look_up(MEANINGS, schema, name))
            _mark_unit(part, name, part)
    for operation in operations:
        for parameter in operation.get("parameters", ()):
            name = parameter["name"]
            example = look_up(EXAMPLES, operation["operationId"], name)
            _describe(parameter, look_up(MEANINGS, operation["operationId"], name))
            _mark_unit(parameter, name, parameter["schema"])
            if parameter["required"] and example is not None:
                parameter["example"] = example
        _give_example(operation)


def look_up(texts: Mapping[str, Any], scope: str, name: str) -> Any:
    """Return the text of a name in a scope, or else in general; None where there is none."""
    return texts.get(f"{scope}.{name}", texts.get(name))


def _describe(documented: dict[str, Any], text: str | None) -> None:
    if text is not None:
        documented.setdefault("description", text)


def _mark_unit(documented: dict[str, object], name: str, schema: dict[str, object]) -> None:
    """Add the unit of a number as UDUNITS symbol; `1`: no unit, `own`: stated with the number."""
    if not holds_numbers(schema):
        return
    unit = unit_of(name) or OTHER_UNITS.get(name, "own" if name in OWN_UNIT else "")
    if not unit and (name in PURE or name.endswith(RATIOS) or not holds_numbers(schema, {"number"})):
        unit = "1"
    if unit:
        documented["x-unit"] = unit


def holds_numbers(schema: Any, kinds: Collection[str] = ("number", "integer")) -> bool:
    """Return whether values of a schema are numbers of these kinds, or contain them."""
    if not isinstance(schema, dict):
        return False
    parts = [*schema.get("anyOf", ()), schema.get("items"), schema.get("additionalProperties")]
    return schema.get("type") in kinds or any(holds_numbers(part, kinds) for part in parts)


def _give_example(operation: dict[str, Any]) -> None:
    example = examples().get(operation["operationId"])
    if example is None:
        return
    status, media_type = example["status"], example["media_type"]
    content = operation["responses"].get(status, {}).get("content", {})
    if media_type in content:
        content[media_type]["example"] = example["answer"]
    if "body" in example and "requestBody" in operation:
        operation["requestBody"]["content"]["application/json"]["example"] = example["body"]
