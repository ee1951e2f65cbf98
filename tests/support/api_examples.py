"""Answers of a real service for the examples of the description: one of each operation."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import httpx2

from daq_service.settings.tree import Settings
from daq_service.web.answers.vocabulary import VOCABULARY, look_up_scoped_value
from daq_service.web.app import create_app
from daq_service.web.auth.tokens import create_token
from daq_service.web.multi_test.app import create_multi_test_app
from support.filled_folder import FilledFolder
from support.served_web import served_app

FILE = Path(__file__).parents[2] / "daq_service" / "web" / "answers" / "examples.json"
LONGEST_LIST = 2
BODIES: dict[str, Any] = {
    "create_command": {"kind": "pause", "author": "ann", "arguments": {"note": "hands in the rig"}},
    "acknowledge_alarm": {"author": "ann", "note": "inspected"},
    "create_token": {"name": "bob", "role": "viewer", "days": 30},
}
ORDER = ("get_command", "list_audit", "revoke_token", "log_out")
"""These come last, since they describe the others."""
STREAM = (
    "id: 42\\nevent: sets\\n"
    'data: {"id":42,"topic":"sets","kind":"set_done","position":"B","set_index":0,"payload":{}}\\n\\n'
)
TRIAL = {"receiver": "control_room", "ok": True, "status": 204, "result": "taken", "took_s": 0.12}
TWIN = {
    "as_of": {
        "clock": "simulated",
        "last_write_wall_utc": "2026-11-28T09:08:05.896002385Z",
        "now_h": 25.0,
        "now_utc": "2024-01-02T01:00:00Z",
        "pace_h_per_s": None,
        "recorder": "running",
        "wall_age_s": 11.571349605,
    },
    "position": "B",
    "pretrigger_samples": 1000,
    "reason": None,
    "sample_rate_hz": 10000000.0,
    "set_index": 48,
    "unscheduled_index": 0,
    "voltage_v": [0.0, 0.012],
    "wall": {
        "age_h": 0.5,
        "below_minimum_probability": None,
        "curve": "solid, square 25.4 mm",
        "due_h": 24.5,
        "due_utc": "2024-01-02T00:30:00Z",
        "extractor_version": "1",
        "forecast_h": None,
        "forecast_high_m": None,
        "forecast_low_m": None,
        "forecast_m": None,
        "forecast_utc": None,
        "id": 1,
        "interval_high_m": 0.00635,
        "interval_low_m": 0.0060325,
        "loss_rate_m_per_s": 4e-09,
        "minimum_m": None,
        "position": "B",
        "quality": "good",
        "reason": None,
        "set_index": 48,
        "thickness_m": 0.00635,
        "time_to_minimum_low_s": None,
        "time_to_minimum_s": None,
        "unscheduled_index": 0,
    },
}
BY_HAND: dict[str, tuple[str, Any]] = {
    "stream_events": ("text/event-stream", STREAM),
    "get_twin_waveform": ("application/json", TWIN),  # it would need a wall and a minute
    "test_receiver": ("application/json", TRIAL),  # it would need a receiver
}


def shortened(value: Any) -> Any:
    """Cut lists to their first entries and hide tokens."""
    if isinstance(value, list):
        return [shortened(part) for part in value[:LONGEST_LIST]]
    if isinstance(value, dict):
        return {key: "told once" if key == "token" else shortened(part) for key, part in value.items()}
    return value


def asked(client: httpx2.Client, path: str, method: str, operation: dict[str, Any]) -> dict[str, Any] | None:
    """Request one example; return None where the answer is not JSON."""
    name = operation["operationId"]
    if name in BY_HAND:
        return {"status": "200", "answer": BY_HAND[name][1], "media_type": BY_HAND[name][0]}
    place = re.sub(
        r"\{(\w+)\}", lambda part: str(look_up_scoped_value(VOCABULARY.examples, name, part[1])), path
    )
    asked_for = {
        part["name"]: look_up_scoped_value(VOCABULARY.examples, name, part["name"])
        for part in operation.get("parameters", ())
        if part["in"] == "query" and (part["required"] or f"{name}.{part['name']}" in VOCABULARY.examples)
    }
    body = BODIES.get(name)
    answer = client.request(method, place, params=asked_for, json=body)
    media_type = answer.headers["content-type"].partition(";")[0]
    if media_type == "application/openmetrics-text":
        return {"status": "200", "media_type": media_type, "answer": "\n".join(answer.text.splitlines()[:6])}
    if media_type != "application/json":
        return None
    example = {
        "status": str(answer.status_code),
        "media_type": media_type,
        "answer": shortened(answer.json()),
    }
    return example | ({} if body is None else {"body": shortened(body)})


def write_examples(folder: Path, *, renew: bool) -> None:
    """Serve an invented test, request everything once, and write the answers.

    Parameters
    ----------
    anew
        False: only of operations that have none yet.
    """
    kept: dict[str, Any] = {} if renew else json.loads(FILE.read_text(encoding="utf-8"))

    def turn(call: tuple[str, str, dict[str, Any]]) -> int:
        name = call[2]["operationId"]
        return ORDER.index(name) if name in ORDER else -1

    filled = FilledFolder(folder, Settings())
    for index in range(50):
        filled.add_set(index, stored=index == 0, shown=index == 49)
    filled.add_alarm("B", 49)
    filled.add_environment(49)
    _, text = create_token(folder / "tokens.json", "ada", "admin")
    BODIES["log_in"] = {"token": text}
    answers: dict[str, Any] = {}
    for app in (create_app(Settings(), folder), create_multi_test_app([folder], Settings(), folder)):
        with served_app(app) as service, service.client(Authorization=f"Bearer {text}") as client:
            paths = app.openapi()["paths"]
            calls = [(path, method, what) for path, item in paths.items() for method, what in item.items()]
            calls.sort(key=turn)
            for path, method, operation in calls:
                example = asked(client, path, method, operation)
                if example is not None:
                    answers.setdefault(operation["operationId"], example)
    filled.close()
    answers |= {name: kept[name] for name in answers.keys() & kept.keys()}
    content = json.dumps(answers, indent=1, ensure_ascii=False, sort_keys=True)
    FILE.write_text(f"{content}\n", encoding="utf-8")
