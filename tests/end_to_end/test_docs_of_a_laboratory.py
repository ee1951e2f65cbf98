"""The how-tos for a laboratory: cells run, names are in the files, tables leave nothing out."""

import ast
import base64
import contextlib
import io
import re
import shlex

import h5py
import pytest
from support import notebooks
from support.command_line import solimon_here
from support.served_web import served
from support.small_experiment import run
from support.stored_files import set_files
from test_docs import ROOT, blocks

from daq_service.corrosion_drive.drive import CONDITIONS
from daq_service.errors import BusyError

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


def test_the_cells_of_jupyter_read_a_test_and_draw_it(folder, monkeypatch):
    import matplotlib as mpl
    import matplotlib.pyplot as plt

    mpl.use("agg")
    monkeypatch.chdir(folder.parent)
    *cells, of_the_page = blocks(HOW_TO / "jupyter.md", "python")
    known: dict[str, object] = {}
    try:
        for cell in cells:
            exec(cell, known)
        with served(SETTINGS, folder) as service:
            exec(of_the_page.replace("http://127.0.0.1:8750/", service.url.rstrip("/") + "/"), known)
        drawn = [
            [len(line.get_xdata()) for line in plt.figure(number).axes[0].lines]
            for number in plt.get_fignums()
        ]
    finally:
        plt.close("all")
    n_samples = 13600
    # Times of flight of B, C and D; distance and limit at B; the mean wave; then the page's trend and wave.
    assert drawn == [[SETS] * 3, [SETS] * 2, [n_samples], [SETS], [2000]]
    assert known["one"].shape == known["at_us"].shape == (n_samples,)  # type: ignore[attr-defined]
    # The incident wave of some 150 N fills half of the 5 V range; a shot scatters by some ten per cent.
    assert 1.7 < float(known["mean_wave"].max()) < 3.3  # type: ignore[attr-defined]
    assert known["trend"]["tof_pp_s"].notna().sum() == SETS  # type: ignore[index]


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
    assert len(read) > 15, "the pattern finds what the page reads"
    assert len(attributes) == 2
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
        if "Condition(" not in text:
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
            if not (isinstance(node, ast.Call) and getattr(node.func, "id", "") in {"Condition", "replace"}):
                continue
            given = [keyword.value for keyword in node.keywords if keyword.arg == "kind"]
            if not given and node.func.id == "replace":  # of something else than a kind
                continue
            (kind,) = given
            if isinstance(kind, ast.Constant):
                found.add(str(kind.value))
            elif isinstance(kind, ast.Name):
                found.add(str(texts[kind.id]))
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
        says, says_not, look, call = (cell.strip() for cell in row.split("|"))
        assert says, kind
        assert says_not, kind
        assert re.match(r"1 .+ 2 .+ 3 .+", look), kind
        assert call, kind


def test_the_limits_of_the_baseline_page_are_those_of_the_code():
    page = HOW_TO / "choose-a-baseline.md"
    (code,), (printed,) = blocks(page, "python"), blocks(page, "text")
    captured = io.StringIO()
    with contextlib.redirect_stdout(captured):
        exec(code, {})
    assert captured.getvalue() == printed
    rates = (ROOT / "tests/validation/test_false_alarm_limits.py").read_text(encoding="utf-8")
    text = page.read_text(encoding="utf-8")
    stated = re.findall(r"([\d.]+) % (?:of healthy sets beyond it\s)?at (\d+)", text)
    assert len(stated) == 3, "the pattern finds what the page says"
    for percent, n in stated:
        assert re.search(rf"\({n}, \d+, {float(percent) / 100:g}\b", rates), (percent, n)


COMMANDS = {
    "tutorial.md": ["demo", "status", "verify", "export"],
    "how-to/back-up.md": ["backup", "verify"],
    "how-to/choose-a-baseline.md": ["check-config", "simulate", "approve-baseline", "renew-baseline"],
    "how-to/respond-to-an-alarm.md": ["status"],
    "how-to/upgrade.md": ["backup", "verify", "check-config", "doctor", "run"],
}
"""Pages and the commands on separate lines there, in this order."""
TAKES_LONG = ("demo", "doctor", "run")
"""Tested as commands elsewhere; the tutorial's demo is the one that its pictures are made by."""

ORDERS = ("approve-baseline", "renew-baseline")
"""Commands that are parsed, but need a recorded test."""


@pytest.mark.parametrize("page", COMMANDS)
def test_the_commands_of_a_page_run_one_after_the_other(page, folder, tmp_path, monkeypatch):
    lines = [
        shlex.split(line)
        for block in blocks(ROOT / "docs" / page, "sh")
        for line in re.findall(r"^\s*solimon (.*)$", block, flags=re.MULTILINE)
    ]
    assert [words[0] for words in lines] == COMMANDS[page]
    monkeypatch.chdir(tmp_path)
    assert solimon_here("init", "twin", "my-test.toml", env={}).returncode == 0
    places = {"my-test-data": str(folder), "corrosion-test": str(folder), "/mnt/nas/my-test": "copy"}
    for words in lines:
        if words[0] not in TAKES_LONG:
            done = solimon_here(*(places.get(word, word) for word in words), env=COARSE)
            assert done.returncode == (BusyError.exit_code if words[0] in ORDERS else 0), (words, done.stderr)
            assert done.stdout + done.stderr
