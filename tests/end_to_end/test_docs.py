"""The runnable parts of the documentation run; its links lead to existing targets."""

import contextlib
import io
import re
import shlex
import textwrap
import time
import tomllib
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import click
import orjson
import pytest
import yaml
from click.testing import CliRunner
from support.small_experiment import run, small_settings
from support.stored_files import set_files

from daq_service.cli.groups.registry import find_command
from daq_service.cli.main import cli
from daq_service.processes.notifications.webhook import sign_body
from daq_service.settings.file import load_settings

ROOT = Path(__file__).parents[2]
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])


BLOCK = re.compile(r"^( *)```(\w*)\n(.*?)^\1```$", flags=re.DOTALL | re.MULTILINE)


def blocks(page, language):
    text = page.read_text(encoding="utf-8")
    return [textwrap.dedent(found[3]) for found in BLOCK.finditer(text) if found[2] == language]


def test_the_python_of_read_the_files_reads_the_files(tmp_path):
    assert run(small_settings(schedule={"end_h": 2.0}), tmp_path)
    first, by_xarray, of_all, second = blocks(ROOT / "docs/how-to/read-the-files.md", "python")
    output = io.StringIO()
    with contextlib.redirect_stdout(output):
        exec(first, {"path": set_files(tmp_path)[0]})
        exec(second, {"folder": tmp_path})
    waveforms, features = output.getvalue().splitlines()
    table = io.StringIO()
    with contextlib.redirect_stdout(table):
        exec(by_xarray, {"path": set_files(tmp_path)[0]})
    exported = tmp_path / "test.h5"
    made = CliRunner().invoke(cli, ["export", "--data-dir", str(tmp_path), "--hdf5", str(exported)])
    assert made.exit_code == 0, made.output
    with contextlib.redirect_stdout(output := io.StringIO()):
        exec(of_all, {"exported": exported})
    assert output.getvalue().startswith("12 shots, mean wave up to ")
    axes, _, *rows = table.getvalue().splitlines()
    assert axes.startswith("('shot_time', 'time') "), axes
    assert len(rows) == 1 + 9  # the index and its name are lines of their own
    match = re.fullmatch(r"3 shots of 13600 samples, first shot up to (\d\.\d\d) V", waveforms)
    assert match, waveforms
    # The incident wave of some 150 N fills half of the 5 V range; a shot scatters by some ten per cent.
    assert 1.7 < float(match[1]) < 3.3
    match = re.fullmatch(r"4 sets, first time of flight (\d+\.\d) us", features)
    assert match, features
    # A coarse plate: anything between the rigid wall (317 us) and a plate softer than the paper's (339).
    assert 317.0 < float(match[1]) < 360.0


def test_the_examples_of_the_sweep_page_print_what_it_says(tmp_path, monkeypatch):
    page = (ROOT / "docs/how-to/sweep-parameters.md").read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    expected = ""
    for language, text in re.findall(r"```(sh|python|text)\n(.*?)```", page, flags=re.DOTALL):
        if language == "sh":
            done = CliRunner().invoke(cli, shlex.split(text)[1:])
            assert done.exit_code == 0, done.output
            expected = done.stdout.partition("content hash")[0]
        elif language == "python":
            printed = io.StringIO()
            with contextlib.redirect_stdout(printed):
                exec(text, {})
            expected = printed.getvalue()
        else:
            assert text == expected
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        *("heights.csv", "heights.csv.json", "heights.h5", "zener.csv", "zener.csv.json")
    ]


def test_the_examples_of_the_detection_page_run(tmp_path, monkeypatch):
    page = ROOT / "docs/how-to/estimate-detection.md"
    (table,), (of_table, of_twin) = blocks(page, "text"), blocks(page, "sh")
    monkeypatch.chdir(tmp_path)
    Path("losses.csv").write_text(table, encoding="utf-8")
    done = CliRunner().invoke(cli, shlex.split(of_table)[1:])
    assert done.exit_code == 0, done.output
    assert re.search(r"^table +6 +5 .* 0 of 1 sensors", done.stdout, flags=re.MULTILINE), done.stdout
    assert Path("pod.svg").read_bytes().startswith(b"<?xml")
    *demos, pod = (shlex.split(line)[1:] for line in of_twin.splitlines())
    for seed, demo in enumerate(demos, 1):
        assert run(small_settings(twin={"seed": seed}), Path(demo[demo.index("--data-dir") + 1]))
    done = CliRunner().invoke(cli, pod)
    assert "2 sensors with a wall loss; a POD needs at least 6" in str(done.exception)


def test_the_example_of_the_design_page_writes_a_better_array(tmp_path, monkeypatch):
    (text,) = blocks(ROOT / "docs/how-to/design-an-array.md", "sh")
    monkeypatch.chdir(tmp_path)
    for line in text.splitlines():
        done = CliRunner().invoke(cli, shlex.split(line)[1:])
        assert done.exit_code == 0, done.output
    assert load_settings(Path("best.toml")).positions["B"].chain.radius_m == 14.2875e-3
    assert Path("arrays.svg").read_bytes().startswith(b"<?xml")


@pytest.mark.parametrize("text", blocks(ROOT / "docs/reference/configuration.md", "toml"))
def test_the_toml_of_the_configuration_page_is_accepted(text, tmp_path):
    path = tmp_path / "example.toml"
    path.write_text(text, encoding="utf-8")
    load_settings(path)


def test_the_receiver_s_check_of_get_notified_checks_what_is_sent(tmp_path):
    page = ROOT / "docs/how-to/get-notified.md"
    (text,), given = blocks(page, "toml"), tmp_path / "example.toml"
    given.write_text(text, encoding="utf-8")
    assert set(load_settings(given).notifications.receivers) == {"duty", "mail"}
    (check,), names, now_s = blocks(page, "python"), dict[str, Any](), int(time.time())
    exec(check, names)
    sent = sign_body(b"a secret of the duty", now_s, b"{}")
    assert names["is_genuine"]("a secret of the duty", sent, b"{}")
    assert not names["is_genuine"]("a secret of the duty", sent, b"[]")
    old = sign_body(b"a secret of the duty", now_s - 400, b"{}")
    assert not names["is_genuine"]("a secret of the duty", old, b"{}")


def parse_shell(text):
    """Split each command of a shell block into words, as a shell would; continued lines are one."""
    for line in text.replace("\\\n", " ").splitlines():
        shlex.split(line, comments=True)


def parse_yaml(text):
    yaml.safe_load(textwrap.dedent(text))


PARSERS = {
    "python": lambda text: compile(text, "block", "exec"),
    "toml": tomllib.loads,
    "html": lambda text: HTMLParser().feed(text),
    "json": orjson.loads,
    "yaml": parse_yaml,
    "sh": parse_shell,
    "console": parse_shell,
    "matlab": None,  # its names are compared with files (`test_docs_of_a_laboratory.py`)
    "text": None,  # output of a command, a tree of files, or a drawing
}
"""What checks a block of a language that no other test runs."""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_block_of_code_has_a_language_and_is_valid(page):
    text = page.read_text(encoding="utf-8")
    found = list(BLOCK.finditer(text))
    assert len(re.findall(r"^ *```", text, flags=re.MULTILINE)) == 2 * len(found)
    for block in found:
        assert block[2] in PARSERS, f"a block without a known language: {block[3]}"
        if parse := PARSERS[block[2]]:
            parse(textwrap.dedent(block[3]))


def anchors(page):
    """Return the anchors of a page's headings, as GitHub and the documentation's generator make them."""
    text = BLOCK.sub("", page.read_text(encoding="utf-8"))
    titles = re.findall(r"^#+ (.+)$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_and_path_leads_somewhere(page):
    text = page.read_text(encoding="utf-8")
    for target, anchor in re.findall(r"\]\((?!https?:)([^)#]*)(?:#([^)]+))?\)", text):
        there = page.parent / target if target else page
        assert there.exists(), target
        assert not anchor or anchor in anchors(there), f"{target}#{anchor}"
    folders = "tests|benchmarks|daq_service|simulator|analysis|hardware_drivers|config"
    for target in re.findall(rf"`((?:{folders})/[\w./]+)`", text):
        assert (ROOT / target).exists(), target
    for target in re.findall(r"python (benchmarks/\w+\.py)", text):
        assert (ROOT / target).exists(), target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_and_option_exists(page):
    text = page.read_text(encoding="utf-8")
    lines = re.findall(r"`(?:[A-Z_]+=\S+ )*solimon ([a-z-]+[^`]*)`", text)
    for block in blocks(page, "sh"):
        lines += re.findall(r"\bsolimon ([a-z-]+.*)$", block, flags=re.MULTILINE)
    for line in lines:
        name, *words = line.split()
        command = cli.get_command(click.Context(cli), name)
        if isinstance(command, click.Group) and words:
            command = command.get_command(click.Context(command), words[0])
        assert command is not None, line
        known = {option for parameter in command.params for option in parameter.opts} | {"--help"}
        options = {word.partition("=")[0] for word in words if word.startswith("--")}
        assert options <= known, line


TEXTS = ("daq_service", "simulator", "hardware_drivers", "analysis", "config", "examples", "benchmarks")


@pytest.mark.parametrize("folder", TEXTS)
def test_no_text_of_the_program_names_an_unknown_command(folder):
    files = [
        path
        for suffix in ("py", "toml", "js", "html", "json", "md", "ipynb")
        for path in (ROOT / folder).rglob(f"*.{suffix}")
        if "node_modules" not in path.parts
    ]
    named = {
        name: path.name
        for path in files
        for name in re.findall(r"`solimon ([a-z][a-z-]*)", path.read_text(encoding="utf-8"))
    }
    assert {name: file for name, file in named.items() if find_command(name) is None} == {}
