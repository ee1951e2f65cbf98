"""Every command ends with a documented exit code and one line; every command and option has a help text."""

import os
import re
import shutil
import subprocess
import sys
from importlib import import_module
from inspect import Parameter, signature
from typing import Any

import click
import pytest
from click.testing import CliRunner
from support.command_line import command_of, solimon_here

from daq_service.archive import ArchiveWriteError
from daq_service.catalogue.errors import CatalogueBusyError, CatalogueWriteError
from daq_service.cli import run
from daq_service.cli.groups.registry import SECTIONS
from daq_service.cli.main import cli
from daq_service.cli.status import command
from daq_service.processes.supervisor import FINAL_CODES


@pytest.mark.parametrize(
    ("raised", "code", "message"),
    [
        (KeyError("thickness_m"), 1, "KeyError: 'thickness_m'"),
        (OSError(24, "Too many open files"), 1, "Too many open files"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_an_unexpected_error_is_one_line_with_its_source_line(monkeypatch, tmp_path, raised, code, message):
    def fail(folder, settings):
        raise raised

    monkeypatch.setattr(command, "describe_status", fail)
    done = solimon_here("status", "--data-dir", str(tmp_path), env={})
    (line,) = filter(None, done.stderr.splitlines())  # click moves on to a new line first
    assert (done.returncode, done.stdout) == (code, "")
    assert line.startswith("solimon: ")
    assert message in line
    assert ("command.py, line " in line or "test_main.py, line " in line) == (code == 1)


@pytest.mark.parametrize("command", ["record", "serve"])
@pytest.mark.parametrize(
    "error",
    [CatalogueBusyError("locked"), CatalogueWriteError("full"), ArchiveWriteError("read-only")],
    ids=str,
)
def test_a_write_error_ends_a_manual_start_and_retries_a_supervised_one(
    monkeypatch, tmp_path, error, command
):
    def fail(*_args, **_options):
        raise error

    monkeypatch.setattr(run, "prepare_data_folder", fail)
    by_hand = solimon_here(command, "--data-dir", str(tmp_path), env={})
    again = solimon_here(command, "--data-dir", str(tmp_path), "--restart-reason", "crashed", env={})
    assert (by_hand.returncode, again.returncode) == (4, 1)
    assert again.returncode not in FINAL_CODES
    assert f"{error}, then start again" in by_hand.stderr
    assert str(error) in again.stderr


@pytest.mark.parametrize(
    "command_line",
    [
        "status",
        "serve",
        "pause --reason why",
        "resume",
        "trust-clock",
        "disable --position B",
        "enable --position B",
        "supply --off",
    ],
)
def test_a_mistyped_folder_is_refused_and_not_made(tmp_path, command_line):
    folder = tmp_path / "solimno-data"
    done = solimon_here(*command_line.split(), "--data-dir", str(folder), env={})
    assert (done.returncode, done.stdout) == (2, "")
    assert f"there is no data folder {folder}; name the folder" in done.stderr
    assert not folder.exists()


@pytest.mark.parametrize(
    ("command_line", "asked"),
    [
        ("pause", "Pausing does not isolate energy. Why is the test paused"),
        ("pause --reason door", ""),
        ("resume", ""),
        ("renew-baseline --position B", "Why is the baseline retired"),
    ],
)
def test_at_a_terminal_a_command_asks_for_its_reason(monkeypatch, command_line, asked):
    given: list[str] = []

    def send_command(kind, *, note, **options):
        given.append(note)
        return 0

    monkeypatch.setattr("daq_service.commands.send.send_command", send_command)
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    questions: list[str] = []
    monkeypatch.setattr("click.prompt", lambda text, **options: questions.append(text) or "hands in the rig")
    assert solimon_here(*command_line.split(), env={}).returncode == 0
    assert questions == ([asked] if asked else [])
    assert given == (["hands in the rig"] if asked else ["door"] if "door" in command_line else [""])


@pytest.mark.parametrize(
    ("command_line", "code", "message"),
    [
        ("renew-baseline --position B", 2, "--reason 'sensor coupled again'"),
        ("supply", 2, "give --on or --off"),
        ("pause --reason why", 4, "no data yet"),
    ],
)
def test_an_impossible_command_is_rejected_with_what_is_missing(tmp_path, command_line, code, message):
    done = solimon_here(*command_line.split(), "--data-dir", str(tmp_path), env={})
    assert (done.returncode, done.stdout) == (code, "")
    assert message in done.stderr


def test_a_restarted_web_service_waits_for_its_folder(tmp_path):
    """Its supervisor restarted it: the disk may be available again later."""
    folder = tmp_path / "data"
    again = ("--restart-reason", "crashed")
    done = solimon_here("serve", "--data-dir", str(folder), *again, env={})
    assert done.returncode == 1
    assert "bring back the test's own folder" in done.stderr


def test_the_help_lists_the_registry_by_section(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    help_text = CliRunner().invoke(cli, ["--help"]).stdout
    assert max(len(line) for line in help_text.splitlines()) <= 80
    listed = re.split(r"^([A-Z]+):$", help_text, flags=re.MULTILINE)[1:]
    sections = {
        name.lower(): [" ".join(text.split()) for text in re.split(r"\n  (?=[a-z])", entries)[1:]]
        for name, entries in zip(listed[::2], listed[1::2], strict=True)
    }
    assert sections == {
        section: [f"{name} {text}" for name, text in commands.items()]
        for section, commands in SECTIONS.items()
    }


SUMMARIES = {name: text for commands in SECTIONS.values() for name, text in commands.items()}
NAMES = list(SUMMARIES)


def leaves(command):
    if isinstance(command, click.Group):
        return [leaf for inner in command.commands.values() for leaf in leaves(inner)]
    return [command]


@pytest.mark.parametrize("name", NAMES)
def test_a_command_has_its_summary_and_describes_its_options(name):
    command = command_of(name)
    assert (command.name, str(command.help).partition("\n")[0]) == (name, SUMMARIES[name])
    assert len(SUMMARIES[name]) <= 72
    for leaf in leaves(command):
        undescribed = [
            option.opts
            for option in leaf.params
            if isinstance(option, click.Option) and not (option.hidden or option.help)
        ]
        assert undescribed == []


def test_the_options_of_a_command_are_the_parameters_of_its_function():
    """A target is a text until the command runs."""
    checked = set()
    for leaf in [leaf for name in NAMES for leaf in leaves(command_of(name))]:
        callback: Any = leaf.callback
        module, _, function = callback.args[0].partition(":")
        parameters = signature(getattr(import_module(f"daq_service.cli.{module}"), function)).parameters
        given = {str(parameter.name) for parameter in leaf.params} | set(callback.keywords)
        rest = {key for key, value in parameters.items() if value.kind is Parameter.VAR_KEYWORD}
        assert given == set(parameters) or (rest and set(parameters) - rest <= given), leaf.name
        checked.add(leaf.name)
    assert {"run", "record", "status", "verify", "simulate", "create"} <= checked


IMPORTED = """
import sys
sys.argv = ["solimon", *sys.argv[1:]]
try:
    from daq_service.cli.main import main
    main()
except SystemExit:
    print(*sys.modules, file=sys.stderr)
"""
HEAVY = {"numpy", "scipy", "numba", "h5py", "matplotlib", "rich"}
HEAVY |= {"fastapi", "pydantic", "sqlalchemy", "uvicorn", "nidaqmx", "serial"}


@pytest.mark.parametrize(
    ("arguments", "own"),
    [
        (["--help"], set()),
        (["repair", "--help"], set()),
        (["status", "--data-dir", "nowhere"], {"status", "status.command", "terminal"}),
    ],
    ids=("help", "repair", "status"),
)
def test_a_command_imports_no_module_of_another(arguments, own, tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", IMPORTED, *arguments], capture_output=True, text=True, check=True, cwd=tmp_path
    )
    modules = done.stderr.splitlines()[-1].split()
    imported = {
        name.removeprefix("daq_service.cli.") for name in modules if name.startswith("daq_service.cli.")
    }
    shared = {"main", "groups", "groups.registry"}
    assert own | shared <= imported
    others = imported - own - shared
    assert {name.partition(".")[0] for name in others} <= {name.partition(".")[0] for name in own}
    assert "status" in own or not HEAVY & set(modules), "help answers at once"


FIRST_WORDS = """
import os, sys
from importlib.abc import MetaPathFinder

class Ends(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name == "daq_service.cli.demo":
            print(*sorted(module for module in sys.modules if "." not in module), flush=True)
            os._exit(0)

sys.meta_path.insert(0, Ends())
sys.argv = ["solimon", "demo"]
from daq_service.cli.main import main
main()
"""


def test_the_demo_prints_its_first_line_before_the_imports():
    done = subprocess.run([sys.executable, "-c", FIRST_WORDS], capture_output=True, text=True, check=True)
    assert done.stderr.startswith("solimon demo: ")
    assert not set(done.stdout.split()) & {"numba", "numpy", "pydantic", "sqlalchemy", "rich"}


OF_OTHERS = {"numba", "matplotlib", "pandas", "fastapi", "uvicorn", "rich"}
OF_OTHERS |= {"nidaqmx", "niscope", "grpc", "serial"}
OF_OTHERS |= {"scipy.linalg", "scipy.signal", "scipy.stats", "scipy.sparse"}


@pytest.mark.parametrize(
    ("module", "slow"),
    [
        ("daq_service.recording.session", OF_OTHERS),
        # Solvers that only a new plate needs.
        ("simulator.specimen", {"scipy.optimize", "scipy.sparse.linalg", "scipy.stats"}),
    ],
)
def test_recorder_and_twin_import_nothing_slow_that_they_do_not_use(module, slow):
    """A single file of unit tests answers in seconds; a restart of the recorder, too."""
    code = f"import sys, {module}; print(*sorted(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not set(done.stdout.split()) & slow


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_each_shell_gets_its_completion_script(shell):
    done = solimon_here("completion", shell, env={})
    assert done.returncode == 0
    assert f"_SOLIMON_COMPLETE={shell}_complete" in done.stdout
    help_text = CliRunner().invoke(cli, ["completion", "--help"]).stdout
    assert re.search(rf"{shell}: .*solimon completion {shell}", help_text)


@pytest.mark.skipif(shutil.which("bash") is None or os.name == "nt", reason="needs bash")
def test_bash_completes_words_and_options(tmp_path):
    program = tmp_path / "solimon"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m daq_service.cli "$@"\n')
    program.chmod(0o755)
    # As bash itself does when a person presses the key.
    script = """
        eval "$(solimon completion bash)"
        ask() { COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); COMPREPLY=(); _solimon_completion solimon; }
        ask solimon sta; echo "${COMPREPLY[@]}"
        ask solimon status --w; echo "${COMPREPLY[@]}"
    """
    # click finds the name of the variable by the name of the program.
    wrapped = program.read_text().replace(" -m daq_service.cli", f' "{tmp_path}/solimon.py"')
    program.write_text(wrapped)
    (tmp_path / "solimon.py").write_text(
        "import sys; sys.argv[0] = 'solimon'\nfrom daq_service.cli import main\nmain()\n"
    )
    path = f"{tmp_path}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "--norc", "-c", script],
        env={**os.environ, "PATH": path},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == ["status", "--watch"]
