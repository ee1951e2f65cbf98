"""The how-tos for a laboratory: cells run, names are in the files, tables leave nothing out."""

import ast
import base64
import contextlib
import io
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from support import notebooks
from support.command_line import solimon_here
from support.served_web import served
from support.small_experiment import run
from support.stored_files import set_files
from test_docs import ROOT, blocks

from analysis.wall.bank import FEATURES, load_bank
from daq_service.alarms import process_trouble
from daq_service.assessment.wall_bank import SHIPPED_BANK
from daq_service.corrosion_drive.drive import CONDITIONS
from daq_service.errors import EXIT_NOT_MET, BusyError, UsageError
from daq_service.processes.data_folder import CONFIGURATION_FILE
from daq_service.settings.file import load_settings

HOW_TO = ROOT / "docs/how-to"
SETS = 17
COARSE = {"SOLIMON_PLATE__ELEMENTS_PER_EDGE": "16"}
SETTINGS = notebooks.example_settings()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a test past its baseline, with limits."""
    folder = tmp_path_factory.mktemp("laboratory") / "my-test-data"
    assert run(SETTINGS, folder)
    return folder


@pytest.fixture(scope="module")
def exported(folder):
    path = folder.parent / "test.h5"
    made = solimon_here("export", "--data-dir", str(folder), "--hdf5", str(path), env={})
    assert made.returncode == 0, made.stderr
    return path


@pytest.fixture(scope="module")
def finished_demo(tmp_path_factory):
    """Return the folder of a finished demo of 24 sets."""
    folder = tmp_path_factory.mktemp("demo") / "my-test-data"
    # In a process of its own, which ends with the log files that it opens.
    command = [sys.executable, "-m", "daq_service.cli", *shlex.split("demo --exit --no-web --hours 12")]
    done = subprocess.run(
        [*command, "--data-dir", str(folder)],
        env=os.environ | COARSE,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return folder


def test_the_cells_of_jupyter_read_a_finished_demo_and_draw_it(finished_demo, monkeypatch):
    import matplotlib as mpl
    import matplotlib.pyplot as plt

    mpl.use("agg")
    monkeypatch.chdir(finished_demo.parent)
    *cells, of_the_service = blocks(HOW_TO / "jupyter.md", "python")
    known: dict[str, object] = {}
    try:
        for cell in cells:
            exec(cell, known)
        settings = load_settings(finished_demo / CONFIGURATION_FILE)
        with served(settings, finished_demo) as service:
            exec(of_the_service.replace("http://127.0.0.1:8750/", service.url), known)
        drawn = [
            [len(line.get_xdata()) for line in plt.figure(number).axes[0].lines]
            for number in plt.get_fignums()
        ]
    finally:
        plt.close("all")
    # Time of flight of B; distance and limit; the mean wave; then the service's trend from hour 2 on.
    assert drawn == [[24], [24, 24], [13600], [21]]
    # The incident wave of some 150 N fills half of the 5 V range; a shot scatters by some ten per cent.
    assert 1.7 < float(known["mean_wave"].max()) < 3.3  # type: ignore[attr-defined]
    assert known["trend"]["amplitude_ratio"].notna().sum() == 21  # type: ignore[index]


def test_the_example_notebook_gives_its_committed_outputs(folder, monkeypatch):
    """Texts to the letter; pictures differ with the version of matplotlib, so those are only there."""
    monkeypatch.chdir(folder.parent)
    committed = notebooks.read()
    done = notebooks.executed(committed, {})

    def of_cells(notebook):
        cells = [cell["outputs"] for cell in notebook["cells"] if cell["cell_type"] == "code"]
        for output in (output for outputs in cells for output in outputs):
            if "image/png" in output.get("data", {}):
                (picture,) = output["data"]["image/png"]
                assert base64.b64decode(picture).startswith(b"\x89PNG")
                output["data"]["image/png"] = "a picture"
        return cells

    expected = of_cells(committed)
    assert of_cells(done) == expected
    kinds = [output["output_type"] for outputs in expected for output in outputs]
    assert kinds.count("display_data") == 3
    assert "error" not in kinds


def test_the_names_and_shapes_of_matlab_are_those_of_the_files(folder, exported):
    text = "\n".join(blocks(HOW_TO / "matlab.md", "matlab"))
    (name,) = re.findall(r"sets/(set_\d+_\w+\.h5)", text)
    assert name == set_files(folder)[12].name
    read = set(re.findall(r"h5(?:read|info|disp)\((path|test), '([^']+)'", text))
    attributes = set(re.findall(r"h5readatt\((path|test), '([^']+)', '([^']+)'\)", text))
    assert len(read) > 12, "the pattern finds what the page reads"
    assert len(attributes) == 1
    with h5py.File(folder / "sets" / name) as path, h5py.File(exported) as test:
        files = {"path": path, "test": test}
        missing = {(file, place) for file, place in read if place not in files[file]}
        missing |= {found for found in attributes if found[2] not in files[found[0]][found[1]].attrs}
        assert missing == set()
        group = path["entry/B_waveforms"]
        # MATLAB turns the order of the axes round, and reads a scalar as 1 x 1.
        assert group["waveform"].shape == (3, group["time"].size)
        assert group["waveform_offset"].shape == group["waveform_scaling_factor"].shape == ()
        assert group["waveform"].attrs["units"] == "counts"
        assert path["entry/shots/utc_ns"].dtype == "int64"
        of_all = test["entry/B_waveforms"]
        n_shots = 3 * SETS
        assert of_all["waveform"].shape == (n_shots, of_all["time"].size)
        columns = ("due_h", "valid", "waveform_offset", "waveform_scaling_factor")
        assert {of_all[name].shape for name in columns} == {(n_shots,)}
        assert {test[f"entry/B_sets/{name}"].shape for name in ("due_h", "tof_pp_s")} == {(SETS,)}


def kinds_of_alarms():
    """Return every kind of alarm of the code: of the supply by its table, others by `Condition`."""
    found = set(CONDITIONS)
    for path in (ROOT / "daq_service").rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        if "ondition(" not in text:
            continue
        tree = ast.parse(text)
        texts = {
            target.id: node.value.value
            for node in tree.body
            if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant)
            for target in node.targets
            if isinstance(target, ast.Name)
        }
        for node in ast.walk(tree):
            called = getattr(node.func, "id", "") if isinstance(node, ast.Call) else ""
            if called == "build_reason_condition":
                found.add(getattr(process_trouble, node.args[0].id))
            if called not in {"Condition", "replace"}:
                continue
            given = [keyword.value for keyword in node.keywords if keyword.arg == "kind"]
            if not given and node.func.id == "replace":  # of something else than a kind
                continue
            (kind,) = given
            if isinstance(kind, ast.Constant):
                found.add(str(kind.value))
            elif isinstance(kind, ast.Name) and kind.id == "kind":
                assert path.stem == "process_trouble", "that of build_reason_condition"
            elif isinstance(kind, ast.Name):
                found.add(str(texts[kind.id]))
            elif isinstance(kind, ast.IfExp):
                found |= {ast.literal_eval(kind.body), ast.literal_eval(kind.orelse)}
            else:
                assert ast.unparse(kind) == "drive_condition.name", (
                    f"{path}: a kind that this test cannot read"
                )
    return found


def test_every_kind_of_alarm_has_its_row():
    text = (HOW_TO / "respond-to-an-alarm.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \|(.*)\|$", text, flags=re.MULTILINE)
    assert sorted(kind for kind, _ in rows) == sorted(kinds_of_alarms())
    for kind, row in rows:
        meaning, limitations, checks, *others = (cell.strip() for cell in row.split("|"))
        assert all((meaning, limitations, *others)), kind
        assert re.match(r"1\. .+ 2\. .+ 3\. .+", checks), kind


def test_the_limits_of_the_baseline_page_are_those_of_the_code():
    page = HOW_TO / "choose-a-baseline.md"
    (code,), (printed,) = blocks(page, "python"), blocks(page, "text")
    captured = io.StringIO()
    with contextlib.redirect_stdout(captured):
        exec(code, {})
    assert captured.getvalue() == printed
    rates = (ROOT / "tests/validation/test_false_alarm_limits.py").read_text(encoding="utf-8")
    text = page.read_text(encoding="utf-8")
    stated = re.findall(r"([\d.]+)\s%\sat\s(\d+)", text)
    assert len(stated) == 3, "the pattern finds what the page says"
    for percent, n in stated:
        assert re.search(rf"\({n}, \d+, {float(percent) / 100:g}\b", rates), (percent, n)


COMMANDS = {
    "tutorial.md": ["demo", "status", "verify", "export"],
    "how-to/acceptance-test.md": ["acceptance-report"],
    "how-to/access-remotely.md": ["token"],
    "how-to/assess-feature-tables.md": ["assess", "assess", "assess", "wall"],
    "how-to/back-up.md": ["backup", "verify"],
    "how-to/choose-a-baseline.md": ["check-config", "simulate", "approve-baseline", "renew-baseline"],
    "how-to/export-data.md": ["export", "export", "export"],
    "how-to/extract-features.md": ["features", "features"],
    "how-to/matlab.md": ["export"],
    "how-to/reassess-a-test.md": ["replay", "replay", "replay"],
    "how-to/report-a-test.md": ["report", "report"],
    "how-to/respond-to-an-alarm.md": ["status", "explain"],
    "how-to/run-a-test.md": ["init", "check-config", "run", "pause", "resume", "disable", "enable"],
    "how-to/run-as-a-service.md": ["doctor", "service", "service"],
    "how-to/serve-several-tests.md": ["serve", "token", "serve"],
    "how-to/upgrade.md": ["backup", "verify", "check-config", "doctor", "run"],
}
"""Pages and the commands on separate lines there, in this order."""
TAKES_LONG = ("demo", "doctor", "run", "serve")
"""Tested as commands elsewhere; the tutorial's demo is the one that its pictures are made by."""
TO_A_RECORDER = ("approve-baseline", "renew-baseline", "pause", "resume", "disable", "enable")
EXIT_CODES = dict.fromkeys(TO_A_RECORDER, BusyError.exit_code) | {
    "acceptance-report": EXIT_NOT_MET,  # a test of a few hours
    "explain": UsageError.exit_code,  # it has no alarm 3
}
"""Of commands that need more than a stored test; they are parsed here."""
SHORTER = {"100": "2", "101": "3", "200": "4"}
"""Hours of the pages, and those of the test that is here."""


def write_inputs(to, folder):
    """Write the configurations, feature tables and waveforms that the pages take as input."""
    for name in ("my-lab.toml", "service.toml"):
        assert solimon_here("init", "twin", str(to / name), env={}).returncode == 0
    random = np.random.default_rng(1)
    (to / "sensors").mkdir()
    for name in ("sensor", "B", "C", *(f"sensors/{number}" for number in range(4))):
        rows = [",".join(map(str, row)) for row in random.normal((340e-6, 0.5), (1e-6, 0.01), (250, 2))]
        text = "\n".join(f"{row},{'healthy' if n < 50 else 'later'}" for n, row in enumerate(rows))
        (to / f"{name}.csv").write_text(f"tof_pp_s,amplitude_ratio,phase\n{text}\n", encoding="utf-8")
    logs = load_bank(SHIPPED_BANK).sound + random.normal(0.0, 0.01, (60, 5))
    table = np.column_stack([0.5 * np.arange(60), np.exp(logs)])
    header = ",".join(("due_h", *FEATURES))
    np.savetxt(to / "features.csv", table, delimiter=",", header=header, comments="")
    with h5py.File(set_files(folder)[0]) as file:
        group = file["entry/B_waveforms"]
        counts = group["waveform"][()]
        volts = (counts + group["waveform_offset"][()]) * group["waveform_scaling_factor"][()]
    np.save(to / "shots.npy", volts)
    np.save(to / "a.npy", counts // 16)
    np.savetxt(to / "b.csv", counts // 16, fmt="%d", delimiter=",")


@pytest.mark.parametrize("page", COMMANDS)
def test_the_commands_of_a_page_run_one_after_the_other(page, folder, tmp_path, monkeypatch):
    lines = [
        shlex.split(line)
        for block in blocks(ROOT / "docs" / page, "sh")
        for line in re.findall(r"^solimon (.*)$", block, flags=re.MULTILINE)
    ]
    assert [words[0] for words in lines] == COMMANDS[page]
    monkeypatch.chdir(tmp_path)
    write_inputs(tmp_path, folder)
    if lines[0][0] != "init":
        assert solimon_here("init", "twin", "my-test.toml", env={}).returncode == 0
    places = SHORTER | dict.fromkeys(("my-test-data", "corrosion-test", "trial"), str(folder))
    places["/mnt/nas/my-test"] = "copy"
    for words in lines:
        if words[0] not in TAKES_LONG:
            expanded = [sorted(map(str, Path().glob(word))) if "*" in word else [word] for word in words]
            given = [places.get(name, name) for names in expanded for name in names]
            done = solimon_here(*given, env={} if words[0] == "wall" else COARSE)  # its bank is shipped
            assert done.returncode == EXIT_CODES.get(words[0], 0), (words, done.stdout, done.stderr)
            assert done.stdout + done.stderr
