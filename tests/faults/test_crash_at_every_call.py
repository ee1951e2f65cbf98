"""A process crash or power cut after any call that changes a file: a restart repairs it."""

import json
import os
import shutil
import subprocess
import sys
from collections import Counter
from random import Random

import pytest
from support.crashed_recorders import (
    SETS,
    SHOTS_PER_SET,
    crash_settings,
    faults_after_crash,
    lost_of_kept_open,
    lost_of_replaced,
    outcome,
)
from support.refusing_files import needs_a_preload, with_support
from support.small_experiment import SMALL, rows_of
from support.traced_files import (
    MARK,
    MODELS,
    Call,
    Disk,
    build,
    fast_folder,
    read_trace,
    state_of,
    states,
    tracing,
    write_state,
)

from daq_service.archive import FolderSetReader
from daq_service.archive.journal.reader import read_journal

pytestmark = needs_a_preload

CACHES = ("tiles/", "live/")
"""A third of all calls write these; a start makes them again, or goes on without."""
HOURS_S = 4 * 3600
"""Of each model: some thousand states, of a second or two with other work."""
SOME = 4
"""States of the default run."""
ALL_STATES = [pytest.mark.slow, pytest.mark.timeout(HOURS_S)]
QUICK = ("wall", "kept open", "replaced", "replaced and synced")


@pytest.fixture(scope="module")
def fast():
    """Return a folder in memory if there is one: thousands of states are written and synced."""
    with fast_folder() as folder:
        yield folder


@pytest.fixture(scope="module")
def library(fast):
    return build(fast)


@pytest.fixture(scope="module")
def trace_of(fast, library):
    """Return the folder and calls of a design; one process records those of the default run."""

    def get(design):
        if not (fast / design).exists():
            designs = QUICK if design in QUICK else [design]
            environment = with_support(tracing(library, fast / "none", fast / "none"))
            command = [sys.executable, "-m", "support.crashed_recorders", fast, *designs]
            subprocess.run(command, env=environment, check=True)
        return fast / design, read_trace(fast / f"{design}.trace", fast / design)

    return get


def test_the_traced_calls_reproduce_the_folder(trace_of):
    folder, calls = trace_of("wall")
    disk = Disk()
    for call in calls:
        disk.take(call)
    assert disk.left("kill", Random(1)) == state_of(folder)
    assert len(disk.marks) >= 100, "each shot is acknowledged by itself"
    assert any(call.kind == "u" and call.path.startswith("journal/") for call in calls), "segments go"
    files = [call.content for call in calls if call.kind == "r" and call.content.endswith(b".h5")]
    assert len(files) == SETS + 1, "files come, the last one of a set beside the plan"
    assert files[-1].endswith(b"_001.h5")
    struck = 3 * SETS * SHOTS_PER_SET + SETS + SHOTS_PER_SET
    assert len(set(disk.marks)) == struck


@pytest.mark.parametrize(
    ("design", "lost_of", "models_that_lose"),
    [
        ("kept open", lost_of_kept_open, {"kill", "torn", "pages"}),
        ("replaced", lost_of_replaced, {"nothing", "torn", "pages"}),
        ("replaced and synced", lost_of_replaced, set()),
    ],
)
def test_designs_that_lose_shots_are_detected(trace_of, tmp_path, design, lost_of, models_that_lose):
    _, calls = trace_of(design)
    losing = Counter()
    for number, (name, state, marks) in enumerate(states(calls)):
        folder = tmp_path / f"{number}"
        write_state(state, folder)
        losing[name.partition(" ")[0]] += bool(lost_of(folder, marks))
    assert {model for model, n in losing.items() if n} == models_that_lose


@pytest.mark.parametrize(
    ("design", "models", "some"),
    [
        pytest.param("wall", MODELS, SOME, id="some states"),
        *(
            pytest.param(design, (model,), None, id=f"{design}, {model}", marks=ALL_STATES)
            for design in ("wall", "simulated")
            for model in MODELS
        ),
        pytest.param("worker", MODELS, 60, id="a worker makes the files", marks=pytest.mark.slow),
    ],
)
def test_a_recorder_started_on_what_a_crash_left_loses_no_shot_and_changes_no_row(
    trace_of, fast, capsys, design, models, some
):
    left, calls = trace_of(design)
    settings = crash_settings("simulated" if design == "simulated" else "wall")
    whole, count = outcome(left, settings.clock.kind), 0
    caches = CACHES if some is None else None
    for name, state, acknowledged in states(calls, models=models, some=some, caches=caches):
        folder = fast / f"{design} {name.replace('/', '_')}"
        # Where shots are acknowledged by the group, the pages of one go to the disk in any order.
        holes = design == "simulated" and name.startswith("pages")
        lost_pages = name.startswith("pages")
        faults = faults_after_crash(
            state, acknowledged, folder, whole, settings, with_holes=holes, lost_pages=lost_pages
        )
        assert faults == [], name
        shutil.rmtree(folder)
        count += 1
    assert count >= (some or 40) - 1
    with capsys.disabled():
        if some != SOME:
            records = len(whole.counts)
            print(f"\n{design}, {'/'.join(models)}: {len(calls)} calls, {count} states, {records} records")


def solimon_record(folder, **environment):
    """Run ``solimon record`` from the command line; write its standard output to a file."""
    config = folder / "test.json"
    config.write_text(
        json.dumps({**SMALL, "schedule": {**SMALL["schedule"], "end_h": 6.0}}), encoding="utf-8"
    )
    command = [sys.executable, "-m", "daq_service.cli", "record", config, "--data-dir", folder / "data"]
    with (folder / "said").open("w") as output:
        subprocess.run([*command, "--log-json"], env={**os.environ, **environment}, stdout=output, check=True)


@pytest.mark.slow
def test_sixty_states_by_the_command(fast, library, capsys):
    folder, trace = fast / "command", fast / "command.trace"
    folder.mkdir()
    solimon_record(folder, **tracing(library, trace, folder))
    calls = [call for found in read_trace(trace, folder) for call in _seen_from_the_data(found)]
    whole = rows_of(folder / "data")
    assert len(whole["shots"]) >= 100
    count = 0
    # A fifth of those asked for come behind calls that leave nothing new, at the very end.
    for name, state, acknowledged in states(calls, some=80):
        after = fast / f"command {count}"
        write_state(state, after / "data")
        assert set(acknowledged) <= durable(after / "data"), name
        solimon_record(after)
        assert rows_of(after / "data") == whole, name
        shutil.rmtree(after)
        count += 1
    assert count >= 60
    with capsys.disabled():
        print(f"\nby the command: {count} states")


def _seen_from_the_data(call):
    """Return a call relative to the data folder; a line on standard output is an acknowledgement."""
    if call.path == "said" and call.kind == "w":
        messages = (json.loads(line) for line in call.content.splitlines())
        return [Call(kind=MARK, path="", number=line["shot_id"]) for line in messages if "shot_id" in line]
    if call.path.startswith("data/") or (call.path == "data" and call.kind == "s"):
        content = call.content.removeprefix(b"data/") if call.kind == "r" else call.content
        path = call.path.removeprefix("data").removeprefix("/")
        return [Call(kind=call.kind, path=path, number=call.number, content=content)]
    return []


def durable(folder):
    """Return the ids of the shots in files and journal."""
    reader = FolderSetReader(folder)
    stored = {item.sequence for file in reader.sets().values() for item in reader.read_set(file).records}
    return stored | {sequence for item in read_journal(folder).values() for sequence in item.shots}
