"""Thirty tasks of three roles, in three clicks, commands, requests or lines of Python at most."""

import ast
import csv
import hashlib
import json
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from prometheus_client.openmetrics.parser import text_string_to_metric_families
from scipy.io import loadmat
from support.command_line import SOLIMON, solimon_here
from support.filled_folder import filled_folder
from support.labview_files import write_set
from support.served_web import served
from support.stored_files import read_set, set_files

from daq_service import client
from daq_service.cli.main import cli
from daq_service.settings.file import load_settings
from daq_service.settings.tree import Settings
from hardware_drivers.measurement import SetKey

ROOT = Path(__file__).parents[2]
MOST_STEPS = 3
OF_A_ROLE = 10
N_SETS, SHOTS = 52, 2
ENVIRONMENT = {
    "SOLIMON_PLATE__ELEMENTS_PER_EDGE": "16",
    "SOLIMON_SCHEDULE__SHOTS_PER_SET": str(SHOTS),
    "SOLIMON_BASELINE__MINIMUM_VALID_SHOTS": "2",
    "SOLIMON_ALARMS__HOLE_SHOTS": "2",
}
"""A coarse mesh, short sets."""


def read_tasks(path):
    return tomllib.loads((ROOT / path).read_text(encoding="utf-8"))["tasks"]


TASKS = read_tasks("tests/end_to_end/thirty_tasks.toml")
ON_THE_PAGE = [task for task in read_tasks("tests/browser/page_tasks.toml") if "role" in task]


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    with filled_folder(tmp_path_factory.mktemp("tasks"), Settings(), shots_per_set=SHOTS) as folder:
        for index in range(N_SETS):
            folder.add_set(index, stored=index in (0, N_SETS - 1))
        file = set_files(folder.folder)[N_SETS - 1]
        digest = hashlib.sha256(file.read_bytes()).hexdigest()
        folder.catalogue.store_digest(SetKey(N_SETS - 1), f"sets/{file.name}", digest)
        for position in "BC":
            folder.add_alarm(position, N_SETS - 1)
        yield folder


@pytest.fixture(scope="module")
def desk(filled, tmp_path_factory):
    """Yield what a person has: a folder to work in, the test's folder, its service, and LabVIEW files."""
    place = tmp_path_factory.mktemp("desk")
    write_set(place / "labview", 0, [one for one in filled.records(0) if one.key.position != "A"])
    with pytest.MonkeyPatch.context() as patch, served(filled.settings, filled.folder) as service:
        patch.chdir(place)
        with service.client() as api:
            file = set_files(filled.folder)[N_SETS - 1].name
            yield SimpleNamespace(folder=filled.folder, file=file, url=service.url, api=api, filled=filled)


def do(step, names, desk):
    """Take a step; return the answer of a request or the ended process of a command."""
    verb, _, rest = step.partition(" ")
    known = {"folder": desk.folder, "url": desk.url, "file": desk.file, "last": names.get("last")}
    if verb == "GET":
        path, *header = rest.format(**known).split(" ", 1)
        return desk.api.get(path, headers=dict(line.split(": ", 1) for line in header))
    words = shlex.split(step.format(**known)) if verb in ("solimon", "openapi-python-client") else []
    if words[:2] == ["solimon", "record"]:
        # In a process of its own, which ends with the log files that it opens.
        command = [*SOLIMON, *words[1:]]
    elif verb == "solimon":
        return solimon_here(*words[1:], env=ENVIRONMENT)
    elif words:
        command = [str(Path(sys.executable).with_name(verb)), *words[1:]]
    else:
        exec(step, names)
        return None
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    "task", [task for task in TASKS if "seen" in task], ids=lambda task: task["question"]
)
def test_a_task_takes_three_steps_at_most(task, desk):
    assert 1 <= len(task["steps"]) <= MOST_STEPS
    names = {"folder": desk.folder, "url": desk.url, "client": client}
    for step in task["steps"]:
        names["last"] = last = do(step, names, desk)
        if isinstance(last, subprocess.CompletedProcess):
            assert last.returncode == 0, (step, last.stdout, last.stderr)
    globals()[task["seen"]](SimpleNamespace(**names), desk)


# ---- what a person gets --------------------------------------------------------------------------


def times_of_b(desk):
    return [
        desk.filled.features("B", due.set_index, due.due_h)["tof_pp_s"] for due in desk.filled.due[:N_SETS]
    ]


def is_commented_and_accepted(got, desk):
    lines = Path("my-test.toml").read_text(encoding="utf-8").splitlines()
    assert sum("#" in line for line in lines) > 20
    assert load_settings(Path("my-test.toml")) == Settings()


def is_a_strike_without_flags(got, desk):
    assert "0 fail, " in got.last.stdout  # a warning may be of this computer: its disk, its clock
    (flags,) = re.findall(r"^ +flags +(.*)$", got.last.stdout, flags=re.MULTILINE)
    assert flags == "()"


def are_the_waveforms_of_the_newest_set(got, desk):
    got.test.close()
    shots = [one for one in desk.filled.records(N_SETS - 1) if one.key.position == "B"]
    np.testing.assert_array_equal(got.waves.values, [shot.waveform.volts() for shot in shots])


def are_three_files_with_the_same_numbers(got, desk):
    with Path("f.csv").open(encoding="utf-8", newline="") as file:
        of_csv = [float(row["tof_pp_s"]) for row in csv.DictReader(file)]
    of_mat = loadmat("f.mat", squeeze_me=True)["features"]
    with np.load("f.npz") as of_npz:
        np.testing.assert_array_equal(of_npz["tof_pp_s"], of_csv)
    np.testing.assert_array_equal(of_mat["tof_pp_s"].item(), of_csv)
    assert of_csv == times_of_b(desk)


def is_a_figure_of_the_folder(got, desk):
    with Path("figures/fig08.csv").open(encoding="utf-8", newline="") as file:
        of_b = [float(row["tof_pp_s"]) for row in csv.DictReader(file) if row["position"] == "B"]
    assert of_b == times_of_b(desk)
    for ending in ("png", "svg"):
        assert Path(f"figures/fig08.{ending}").stat().st_size > 0


def are_the_shots_of_labview(got, desk):
    played = read_set(set_files(Path("played"))[0])
    assert played.rig_kind == "playback"
    sources = {one.key: one for one in desk.filled.records(0)}
    assert {shot.key for shot in played.shots} == {key for key in sources if key.position != "A"}
    for shot in played.shots:
        np.testing.assert_array_equal(shot.waveform.counts, sources[shot.key].waveform.counts)


def is_a_client_that_reads_alarms(got, desk):
    code = f"""
from generated import Client
from generated.api.alarms import list_alarms
print([alarm.position for alarm in list_alarms.sync(client=Client("{desk.url.rstrip("/")}")).items])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert sorted(ast.literal_eval(done.stdout)) == ["B", "C"]


def are_the_features_from_hour_2_on(got, desk):
    got.test.close()
    hours = [due.due_h for due in desk.filled.due[:N_SETS] if due.due_h >= 2.0]
    assert got.trend["due_h"].tolist() == hours


def is_the_next_event(got, desk):
    assert (got.first.kind, got.second.kind) == ("alarm_raised", "alarm_raised")
    assert [event.data["position"] for event in (got.first, got.second)] == ["B", "C"]


def are_bins_and_single_sets(got, desk):
    whole, zoomed = desk.api.get("/api/v1/trends/B?fields=tof_pp_s&points=10").json(), got.last.json()
    assert (whole["bin_sets"] > 1, zoomed["bin_sets"]) == (True, 1)
    assert len(whole["columns"]["due_h"]) <= 10
    assert zoomed["columns"]["due_h"] == [2.0, 2.5, 3.0, 3.5]


def are_metrics_with_the_active_alarms(got, desk):
    families = {family.name: family for family in text_string_to_metric_families(got.last.text)}
    assert sum(sample.value for sample in families["solimon_alarms_active"].samples) == 2


def is_not_modified(got, desk):
    assert (got.last.status_code, got.last.content) == (304, b"")


def is_a_problem_with_its_remedy(got, desk):
    problem = got.last.json()
    assert (got.last.status_code, problem["status"]) == (422, 422)
    assert "positon" in json.dumps(problem)
    assert problem["hint"]


# ---- tasks of other tests ------------------------------------------------------------------------


def steps_of(path, name):
    """Return the commands and clicks of a test with its fixtures and helpers, in order, and its options."""
    functions = {
        node.name: node
        for node in ast.walk(ast.parse((ROOT / path).read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef)
    }
    steps, options, entered = [], set(), set()

    def visit(node):
        if isinstance(node, ast.FunctionDef):
            if node.name in entered:
                return
            entered.add(node.name)
            for argument in node.args.args:
                if argument.arg in functions:
                    visit(functions[argument.arg])
        if isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            if called in functions:
                visit(functions[called])
            elif called == "run":  # of `support.small_experiment`
                steps.append("run")
            elif called.endswith(".click"):
                steps.extend(f"click {word.value.value}" for word in node.func.value.keywords)
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            if node.value in cli.list_commands(None):
                steps.append(node.value)
            elif node.value.startswith("--"):
                options.add(node.value)
        for child in ast.iter_child_nodes(node):
            visit(child)

    visit(functions[name])
    return list(dict.fromkeys(steps)), options


@pytest.mark.parametrize(
    "task", [task for task in TASKS if "test" in task], ids=lambda task: task["question"]
)
def test_a_named_test_takes_the_counted_steps(task):
    assert 1 <= len(task["steps"]) <= MOST_STEPS
    steps, options = steps_of(*task["test"].split("::"))
    if "page" in task:
        page, test = (
            (ROOT / path).read_text("utf-8") for path in (task["page"], task["test"].split("::")[0])
        )
        for step, used in zip(task["steps"], task["uses"], strict=True):
            assert step in page
            assert used in step
            assert used in test
        return
    assert steps == [re.sub(r"^solimon (\S+).*", r"\1", step) for step in task["steps"]]
    assert {word for step in task["steps"] for word in step.split() if word.startswith("--")} <= options


@pytest.mark.parametrize("role", ["researcher", "plant engineer", "developer"])
def test_each_role_has_its_ten_tasks(role):
    counted = [task["question"] for task in (*TASKS, *ON_THE_PAGE) if task["role"] == role]
    assert len(set(counted)) == OF_A_ROLE, counted
    assert all(task.get("clicks", 0) <= MOST_STEPS for task in ON_THE_PAGE)
