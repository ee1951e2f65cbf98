"""The code raises every type of problem of the table; `docs/reference/api.md` lists every kind of event."""

import ast
import re
from pathlib import Path
from typing import get_args

from daq_service.catalogue.rows import SetState
from daq_service.web.answers.problem import PROBLEM_TYPES
from daq_service.web.routes.stream import TOPICS

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "reference" / "api.md").read_text(encoding="utf-8")
OF_HTTP = {"bad-request", "method-not-allowed", "http-error"}
SOURCES = ("recording", "background", "assessment", "commands", "alarms", "corrosion_drive")


def trees(*rooms):
    for room in rooms:
        for path in sorted((ROOT / "daq_service" / room).rglob("*.py")):
            yield path, ast.parse(path.read_text(encoding="utf-8"))


def calls(tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            yield getattr(node.func, "attr", getattr(node.func, "id", "")), node


def texts(node, constants):
    """Yield the texts of an argument: a literal, a choice, or a named constant."""
    if isinstance(node, ast.IfExp):
        yield from texts(node.body, constants)
        yield from texts(node.orelse, constants)
    elif isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.value
    elif isinstance(node, ast.Name):
        yield from constants.get(node.id, ())
    elif isinstance(node, ast.Call):  # one of a table: `{...}.get(...)`
        for part in [part for part in ast.walk(node) if isinstance(part, ast.Constant)]:
            yield from texts(part, constants)


def constants_of(tree):
    """Return names that stand for texts: `NAME = "text"`, `A, B = "a", "b"`, `x = "a" if y else "b"`."""
    found = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign) and len(node.targets) == 1:
            pairs = [(node.targets[0], node.value)]
            if isinstance(node.targets[0], ast.Tuple) and isinstance(node.value, ast.Tuple):
                pairs = list(zip(node.targets[0].elts, node.value.elts, strict=True))
            for target, value in pairs:
                if isinstance(target, ast.Name) and isinstance(value, ast.Constant | ast.IfExp):
                    found[target.id] = list(texts(value, {}))
    return found


def test_every_type_of_problem_is_raised():
    problems = [node for _, tree in trees("web") for name, node in calls(tree) if name == "Problem"]
    names = {name for node in problems for name in texts(node.args[0], {})}
    raised = {name for name in names if re.fullmatch(r"[a-z]+(-[a-z]+)*", name)}
    assert raised | OF_HTTP == PROBLEM_TYPES.keys()


def kinds_of_the_code():
    """Return the literals where the code names the kind of an event."""
    parsed = list(trees(*SOURCES))
    constants = {}
    for _, tree in parsed:
        constants |= constants_of(tree)
    for _, tree in parsed:
        for name, node in calls(tree):
            place = None
            if name == "say":
                place = node.args[0]
            elif name == "store_annotation":
                place = node.args[1]
            elif name in {"event", "store_event"} and len(node.args) >= 2:
                first = set(texts(node.args[0], constants))
                place = node.args[1] if first & set(TOPICS) else node.args[0]
            elif name == "change_state":
                place = node.args[3]
            named = [key.value for key in node.keywords if key.arg == "event_kind"]
            if name == "change_baselines":
                named += [step.elts[1] for step in node.args if isinstance(step, ast.Tuple)]
            if name == "add_service_event":
                named += [key.value for key in node.keywords if key.arg == "kind"]
            for part in ([place] if place is not None else []) + named:
                yield from texts(part, constants)


def test_every_kind_of_event_is_listed():
    rows = re.findall(r"^\| `(\w+)` \| ((?:`\w+`(?:, )?)+) \|", PAGE, re.MULTILINE)
    listed = {kind for topic, kinds in rows if topic in TOPICS for kind in re.findall(r"\w+", kinds)}
    found = {kind for kind in kinds_of_the_code() if re.fullmatch(r"[a-z]+(_[a-z]+)*", kind)}
    found |= {f"set_{state}" for state in get_args(SetState)}
    assert {topic for topic, _ in rows} >= set(TOPICS)
    assert found - {"set"} == listed
