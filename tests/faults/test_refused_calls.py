"""A disk that refuses a call, some, or all until it is freed: it costs time, and no manual work."""

import errno
import itertools
import json
import re
import subprocess
import sys
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from support.refused_recorders import CALLS, DAMAGED, SETS
from support.refusing_files import build, needs_a_preload, with_support

pytestmark = needs_a_preload

ERRORS = ("ENOSPC", "EIO", "EROFS", "EMFILE")
UNTIL_FREED = 10**6
COUNTS = (1, 3, UNTIL_FREED)
REPORTED_WITHIN_S = 5.1
"""Five seconds and a pause between two tries."""
RECORDS = 10 * SETS
OF_FEW_SETS = "not_assessed"
"""Alarm of a baseline without limits, which is active for any refusal."""
SHARES = 2
"""Of the whole matrix, followed side by side: half an hour on two idle cores."""
CHANGING = re.compile(r"[0-9a-f]{32}|(?<=set_)\d+_\d+T\d+Z|\d{6}(?=\.)|(?<=\.)\d+(?=\.tmp)|(?<=/)[A-D](?=\.)")
"""What of a name is another one each time: number, process, position."""


def case(call, files, error, *, first=0, count=UNTIL_FREED):
    return {"call": call, "files": files, "first": first, "count": count, "errno": getattr(errno, error)}


SOME = [
    case("write", "/journal/*", "ENOSPC", first=5),
    case("write", "/catalogue.sqlite*", "EIO", first=50),
    case("open", "/sets/*.h5", "EMFILE", first=3, count=30),
    case("open", "/catalogue.sqlite", "ENOSPC", count=1),
    case("open", "*", "EMFILE", first=100),
    {**case("mkdir", "/quarantine", "ENOSPC"), "damaged": True},
    {"locked_s": 60.0},
    {"moved_s": 60.0},
]


@pytest.fixture(scope="module")
def followed(tmp_path_factory):
    """Return the outcome of each case; one program forks all of them."""
    library = build(tmp_path_factory.mktemp("library"))

    def follow(cases, folder):
        environment = with_support({"LD_PRELOAD": str(library)})
        command = [sys.executable, "-m", "support.refused_recorders", folder]
        lines = "".join(f"{json.dumps(case)}\n" for case in cases)
        answer = subprocess.run(
            command, input=lines, env=environment, stdout=subprocess.PIPE, text=True, check=True
        )
        return [json.loads(line) for line in answer.stdout.splitlines()]

    return follow


def wrong(outcome):
    """Return every loss that a refusal may not cause; empty if there is none."""
    if "fault" in outcome:
        return outcome["fault"]
    checks = {
        "the recorder ended in the midst": not any(end.startswith("in") for end in outcome["ends"]),
        "the test is not finished": outcome["finished"],
        "acknowledged shots are lost": not outcome["lost"],
        "sets were not struck": {(*row,) for row in outcome["sets"]}
        == {(n, "done", None) for n in range(SETS)},
        "shots are lost or double": {outcome["shots"], outcome["keys"], outcome["acknowledged"]} == {RECORDS},
        "something is left over": not outcome["left"],
        "the alarm stays": all(
            state == ("unacknowledged" if kind == "data_corrupt" else "returned_unacknowledged")
            for kind, state in outcome["alarms"]
            if kind != OF_FEW_SETS
        ),
        "it is not set aside": outcome["set_aside"] == [Path(DAMAGED).name] * bool(outcome.get("damaged")),
        "it was told late": outcome["lasted_s"] < REPORTED_WITHIN_S
        or (outcome["told_after_s"] is not None and outcome["told_after_s"] <= REPORTED_WITHIN_S),
    }
    return [what for what, is_right in checks.items() if not is_right]


@pytest.mark.timeout(900)  # half a minute on an idle machine
def test_some_refusals_cost_time_only(followed, tmp_path):
    found = followed(SOME, tmp_path)
    assert [wrong(outcome) for outcome in found] == [[]] * len(SOME), found
    assert all(outcome["refusals"] for outcome in found)
    assert [case for case, outcome in zip(SOME, found, strict=True) if not is_reported(outcome)] == []
    by_journal, by_catalogue, locked, moved = found[0], found[1], found[-2], found[-1]
    for outcome in (by_journal, by_catalogue, locked, moved):
        assert outcome["told_after_s"] <= REPORTED_WITHIN_S
        kinds = [kind for kind, _ in outcome["alarms"] if kind != OF_FEW_SETS]
        assert kinds == ["write_failed"]


def is_reported(outcome):
    return outcome["told_after_s"] is not None and outcome["told_after_s"] <= REPORTED_WITHIN_S


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_each_refused_opening_is_reported_also_where_a_second_try_helps(followed, tmp_path):
    cases = [
        case("open", files, error, count=count)
        for files in ("/catalogue.sqlite", "/history.jsonl", "/journal/*", "/sets/*")
        for error in ("EMFILE", "ENOSPC", "EROFS")
        for count in COUNTS
    ]
    found = followed(cases, tmp_path)
    assert [case_of(outcome) for outcome in found if outcome["refusals"] and not is_reported(outcome)] == []
    assert [(case_of(outcome), faults) for outcome in found if (faults := wrong(outcome))] == []


@pytest.mark.slow
@pytest.mark.timeout(4 * 3600)
def test_every_refusal_costs_time_only(followed, tmp_path, capsys):
    """Each kind of call on each kind of file: the first, a middle and the last one."""
    (whole,) = followed([{"call": CALLS}], tmp_path / "whole")
    assert whole["shots"] == RECORDS
    noted = (line.split(" ", 1) for line in whole["noted"])
    kinds = Counter((call, CHANGING.sub("*", path.removeprefix(whole["folder"]))) for call, path in noted)
    cases = [
        case(call, files, error, first=first, count=count)
        for (call, files), n in sorted(kinds.items())
        for first in sorted({0, n // 2, n - 1})
        for count in COUNTS
        for error in ERRORS
    ]
    cases += [
        {**case(call, files, error, count=count), "damaged": True}
        for call, files in (("mkdir", "/quarantine"), ("rename", "/quarantine/*"))
        for count in COUNTS
        for error in ERRORS
    ]
    with ThreadPoolExecutor(SHARES) as pool:
        shares = pool.map(lambda n: followed(cases[n::SHARES], tmp_path / f"cases {n}"), range(SHARES))
        became = list(itertools.chain.from_iterable(shares))
    # How often a file is synced differs from run to run: the last call of one may not come in another.
    not_met = [outcome for outcome in became if not outcome.get("refusals", 1)]
    faults = {json.dumps(case_of(outcome)): found for outcome in became if (found := wrong(outcome))}
    with capsys.disabled():
        print(
            f"\n{len(kinds)} kinds of calls, {len(cases)} refusals of which {len(not_met)} did not come, "
            f"{len(faults)} not outlived"
        )
    assert faults == {}
    assert all(outcome["first"] > 0 for outcome in not_met)
    assert len(not_met) <= len(cases) // 20


def case_of(outcome):
    return {name: outcome[name] for name in ("call", "files", "first", "count", "errno")}
