"""What OpenAPI says of tokens: how one is sent, and which role each operation needs."""

from __future__ import annotations

from typing import Any

from daq_service.web.answers.models import PROBLEMS
from daq_service.web.doors.roles import OPERATIONS, ORDERS

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
