"""Every operation of the OpenAPI document against every role: the table of roles is what the service does."""

import json
import re
from pathlib import Path

import pytest
from support.filled_folder import filled_folder
from support.served_web import served

from daq_service.commands.registry import KINDS
from daq_service.settings.tree import Settings
from daq_service.web.app import RESOURCES
from daq_service.web.auth.roles import OPERATIONS, ORDERS, ROLES
from daq_service.web.auth.tokens import create_token, revoke_token
from daq_service.web.multi_test.app import RESOURCES as OF_SEVERAL
from daq_service.web.routes import report

DOCUMENT = json.loads(Path(__file__).with_name("openapi.json").read_text(encoding="utf-8"))
CALLS = {
    operation["operationId"]: (method, path)
    for path, item in DOCUMENT["paths"].items()
    for method, operation in item.items()
}
SAMPLES = {"position": "B", "name": "nobody"}
ALARM, POSITION = {"alarm_id": 1}, {"position": "B"}
ARGUMENTS = {
    "acknowledge_alarm": ALARM,
    "annotate": {"from_h": 1.0, "text": "a note"},
    "withdraw_annotation": {"annotation_id": 7},
    "shelve_alarm": {**ALARM, "for_h": 8.0, "reason": "known"},
    "unshelve_alarm": ALARM,
    "take_out_of_service": {**ALARM, "reason": "sensor is being repaired"},
    "return_to_service": ALARM,
    "strike": POSITION,
    "disable": POSITION,
    "enable": POSITION,
    "approve_baseline": POSITION,
    "renew_baseline": {**POSITION, "note": "coupled anew"},
    "pause": {"note": "why"},
}


@pytest.fixture(scope="module")
def clients(tmp_path_factory):
    """Return a client of each role, and clients with a wrong, a revoked and no token."""
    folder = tmp_path_factory.mktemp("data")
    with filled_folder(folder, sets=1):
        path = folder / "tokens.json"
        tokens = {role: create_token(path, f"the-{role}", role)[1] for role in ROLES}
        revoked = create_token(path, "gone", "admin")[1]
        revoke_token(path, "gone")
        with served(Settings(), folder) as service:
            made = {
                name: service.client(Authorization=f"Bearer {text}")
                for name, text in {**tokens, "wrong": "x" * 43, "revoked": revoked}.items()
            }
            made["nobody"] = service.client()
            yield made
            for client in made.values():
                client.close()


def status(client, method, path, body=None):
    """Return the status from the response head: streams do not end."""
    json_body = {"json": {} if body is None else body} if method == "post" else {}
    with client.stream(method, path, **json_body) as answer:
        return answer.status_code


def filled_in(path):
    for name, value in SAMPLES.items():
        path = path.replace(f"{{{name}}}", value)
    return re.sub(r"\{\w+\}", "0" if "set_index" in path else "1", path)


def test_every_operation_and_every_kind_of_order_has_a_role():
    """A new one is one line of `daq_service/web/auth/roles.toml`."""
    resources = (*RESOURCES, *OF_SEVERAL)
    routes = {route.name for resource in resources for route in resource.router.routes}
    assert (CALLS.keys() | routes) - OPERATIONS.keys() == set()
    assert OPERATIONS.keys() - (CALLS.keys() | routes) == set()
    assert KINDS.keys() == ORDERS.keys()


@pytest.mark.parametrize("operation", CALLS)
def test_an_operation_is_allowed_for_its_role_and_higher_roles_only(clients, operation):
    method, path = CALLS[operation]
    needed = OPERATIONS[operation]
    with report._making:  # who may have a report hears that one is being made: each would take seconds
        answers = {name: status(client, method, filled_in(path)) for name, client in clients.items()}
    if needed is None:
        assert {answers[role] for role in ROLES} & {401, 403, 429} == set()
        return
    assert answers["nobody"] == 401
    assert {answers["wrong"], answers["revoked"]} <= {401, 429}
    rank = ROLES.index(needed)
    assert [answers[role] for role in ROLES[:rank]] == [403] * rank
    assert {answers[role] for role in ROLES[rank:]} & {401, 403, 429} == set()


@pytest.mark.parametrize("kind", KINDS)
def test_a_command_is_accepted_from_its_role_and_higher_roles(clients, kind):
    order = {"kind": kind, "author": "somebody else", "arguments": ARGUMENTS.get(kind, {})}
    answers = {name: status(client, "post", "/api/v1/commands", order) for name, client in clients.items()}
    assert answers["nobody"] == 401
    assert {answers["wrong"], answers["revoked"]} <= {401, 429}
    rank = ROLES.index(ORDERS[kind])
    assert [answers[role] for role in ROLES[:rank]] == [403] * rank
    assert {answers[role] for role in ROLES[rank:]} <= {202, 404, 409}


def test_the_document_states_the_role_of_each_operation():
    for operation, (method, path) in CALLS.items():
        described = DOCUMENT["paths"][path][method]
        needed = OPERATIONS[operation]
        if needed is None:
            assert described["security"] == [{}]
        else:
            assert described["security"] == [{"token": [needed]}, {"cookie": [needed]}, {}]
            assert {"401", "403", "429"} <= described["responses"].keys()
    assert DOCUMENT["paths"]["/api/v1/commands"]["post"]["x-role-by-kind"] == dict(ORDERS)
