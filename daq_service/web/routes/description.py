"""What OpenAPI says beside the routes: tokens and roles, what names mean, units, examples."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from daq_service.shared_file import read_shared
from daq_service.web.answers.models import PROBLEMS
from daq_service.web.answers.vocabulary import EXAMPLES, OTHER_UNITS, OWN_UNIT, PURE, RATIOS, TAGS, WORDS
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
    """Write schemes, roles and refusals into a description; the table of roles says which.

    A service on loopback asks nobody before the first token was made: the empty alternative.
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
    """Answers of a real service by operation (`python tests/contract/test_openapi.py` asks for them)."""
    found: dict[str, Any] = json.loads(read_shared(Path(__file__).parents[1] / "answers" / "examples.json"))
    return found


def describe_words(document: dict[str, Any]) -> None:
    """Say what each name means that does not say so itself, each number's unit, and give examples."""
    operations = [operation for item in document["paths"].values() for operation in item.values()]
    used = {tag for operation in operations for tag in operation.get("tags", ())}
    document["tags"] = [{"name": name, "description": told} for name, told in TAGS.items() if name in used]
    for schema, described in document["components"]["schemas"].items():
        for name, part in described.get("properties", {}).items():
            _describe(part, found(WORDS, schema, name))
            _mark_unit(part, name, part)
    for operation in operations:
        for parameter in operation.get("parameters", ()):
            name = parameter["name"]
            example = found(EXAMPLES, operation["operationId"], name)
            _describe(parameter, found(WORDS, operation["operationId"], name))
            _mark_unit(parameter, name, parameter["schema"])
            if parameter["required"] and example is not None:
                parameter["example"] = example
        _give_example(operation)


def found(words: Mapping[str, Any], place: str, name: str) -> Any:
    """Look a name up: what it means at this place, else everywhere; None where nobody has said."""
    return words.get(f"{place}.{name}", words.get(name))


def _describe(described: dict[str, Any], told: str | None) -> None:
    if told is not None:
        described.setdefault("description", told)


def _mark_unit(marked: dict[str, Any], name: str, schema: dict[str, Any]) -> None:
    """Write a number's unit as UDUNITS has it; `1`: it has none, `own`: it stands beside the number."""
    if not holds_numbers(schema):
        return
    unit = unit_of(name) or OTHER_UNITS.get(name, "own" if name in OWN_UNIT else "")
    if not unit and (name in PURE or name.endswith(RATIOS) or not holds_numbers(schema, {"number"})):
        unit = "1"
    if unit:
        marked["x-unit"] = unit


def holds_numbers(schema: Any, kinds: Collection[str] = ("number", "integer")) -> bool:
    """Tell that a value of this schema is a number of these kinds, or has such in lists or by name."""
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
