"""The one table of roles: what each operation of the interface and each kind of order needs.

An operation is named by its `operationId`, a WebSocket or HEAD by its function; one that is not listed is for
admins, and `tests/contract/test_roles.py` fails. Each role may do what those before it may.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

Role = Literal["viewer", "operator", "engineer", "admin"]
ROLES: tuple[Role, ...] = get_args(Role)
CLAIMED = "claimed"
"""In place of a role where the service asks for no token: everything is allowed, under a name that nobody
has checked."""

OPERATIONS: Mapping[str, Role | None] = {
    # Anybody: signs of life, and the way in.
    "get_liveness": None,
    "get_readiness": None,
    "get_session": None,
    "log_in": None,
    "log_out": None,
    # What there is to see.
    "get_info": "viewer",
    "get_health": "viewer",
    "list_transducers": "viewer",
    "get_transducer": "viewer",
    "list_sets": "viewer",
    "list_shots": "viewer",
    "list_features": "viewer",
    "list_thickness": "viewer",
    "list_verdicts": "viewer",
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
    # What changes the test; each kind of order has a role of its own below.
    "create_command": "operator",
    "acknowledge_alarm": "operator",
    "test_receiver": "engineer",
    # Who may do all this, and who did.
    "list_tokens": "admin",
    "create_token": "admin",
    "revoke_token": "admin",
    "list_audit": "admin",
    # Of a service that has several tests.
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
    "hold": "operator",
    "release": "operator",
    "confirm": "operator",
    "retire": "engineer",
    "reinstate": "engineer",
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
    """Who asks.

    Attributes
    ----------
    name
        Of the token; empty where none is asked for.
    role
        Of the token, or `CLAIMED`.
    """

    name: str
    role: str

    def may(self, needed: Role | None) -> bool:
        """Tell whether this person's role is enough."""
        return needed is None or self.role == CLAIMED or ROLES.index(needed) <= _rank(self.role)

    def may_do(self) -> list[str]:
        """Return the operations and kinds of orders that this person may ask for."""
        return sorted({name for name, needed in {**OPERATIONS, **ORDERS}.items() if self.may(needed)})


def _rank(role: str) -> int:
    return ROLES.index(role) if role in ROLES else -1
