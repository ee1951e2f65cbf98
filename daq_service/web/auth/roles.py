"""Roles required by each operation of the interface and each kind of command.

An operation is named by its `operationId`, a WebSocket or HEAD by its function; an unlisted one requires
admin, and `tests/contract/test_roles.py` fails. Each role may do what those before it may.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

Role = Literal["viewer", "operator", "engineer", "admin"]
ROLES: tuple[Role, ...] = get_args(Role)
CLAIMED = "claimed"
"""Replaces a role where no token is required: everything is allowed, under an unverified name."""

OPERATIONS: Mapping[str, Role | None] = {
    # Public: health checks, and login.
    "get_liveness": None,
    "get_readiness": None,
    "get_session": None,
    "log_in": None,
    "log_out": None,
    # Reading.
    "get_info": "viewer",
    "get_health": "viewer",
    "list_transducers": "viewer",
    "get_transducer": "viewer",
    "list_sets": "viewer",
    "list_shots": "viewer",
    "list_features": "viewer",
    "list_thickness": "viewer",
    "list_assessments": "viewer",
    "list_baselines": "viewer",
    "get_trend": "viewer",
    "get_fit": "viewer",
    "get_waveform": "viewer",
    "get_set_waveforms": "viewer",
    "get_waterfall": "viewer",
    "get_waveforms": "viewer",
    "get_live_waveform": "viewer",
    "live_waveforms": "viewer",
    "list_environment": "viewer",
    "get_latest_environment": "viewer",
    "list_alarms": "viewer",
    "get_alarm": "viewer",
    "get_alarm_history": "viewer",
    "list_guidance": "viewer",
    "list_annotations": "viewer",
    "stream_events": "viewer",
    "get_command": "viewer",
    "list_tables": "viewer",
    "get_table": "viewer",
    "get_file": "viewer",
    "get_report": "viewer",
    "get_metrics": "viewer",
    "get_notifications": "viewer",
    "list_deliveries": "viewer",
    # Changes of the test; each kind of command has its role below.
    "create_command": "operator",
    "acknowledge_alarm": "operator",
    "test_receiver": "engineer",
    # Tokens and audit.
    "list_tokens": "admin",
    "create_token": "admin",
    "revoke_token": "admin",
    "list_audit": "admin",
    # Service of several tests.
    "list_tests": "viewer",
}
ORDERS: Mapping[str, Role] = {
    "acknowledge_alarm": "operator",
    "shelve_alarm": "operator",
    "unshelve_alarm": "operator",
    "take_out_of_service": "engineer",
    "return_to_service": "engineer",
    "annotate": "operator",
    "withdraw_annotation": "operator",
    "pause": "operator",
    "resume": "operator",
    "strike": "operator",
    "disable": "engineer",
    "enable": "engineer",
    "approve_baseline": "engineer",
    "renew_baseline": "engineer",
    "trust_clock": "engineer",
    "finish_now": "engineer",
    "stop": "engineer",
    "supply_on": "engineer",
    "supply_off": "engineer",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Person:
    """Person of a request.

    Attributes
    ----------
    name
        Name of the token; empty where none is required.
    role
        Role of the token, or `CLAIMED`.
    """

    name: str
    role: str

    def may(self, needed: Role | None) -> bool:
        """Return whether this person's role is sufficient."""
        return needed is None or self.role == CLAIMED or ROLES.index(needed) <= _rank(self.role)

    def may_do(self) -> list[str]:
        """Return the operations and kinds of commands that this person may use."""
        return sorted({name for name, needed in {**OPERATIONS, **ORDERS}.items() if self.may(needed)})


def _rank(role: str) -> int:
    return ROLES.index(role) if role in ROLES else -1
