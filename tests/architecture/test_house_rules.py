"""The linters and import rules, run as a test."""

import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    "command",
    [
        ["ruff", "check", "."],
        ["ruff", "format", "--check", "."],
        pytest.param(["mypy"], marks=pytest.mark.slow),  # `.ci/run` begins with it
        ["importlinter"],
    ],
    ids=lambda command: "-".join(dict.fromkeys(command)),
)
def test_house_rules_hold(command):
    module, *arguments = command
    program = (
        [sys.executable, "-c", "from importlinter.cli import lint_imports_command as main; main()"]
        if module == "importlinter"
        else [sys.executable, "-m", module, *arguments]
    )
    done = subprocess.run(program, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_readme_s_commands_are_one_line_each():
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    assert 'python -m pip install -c constraints.txt -e ".[demo]" && solimon demo' in lines
    assert 'python -m pip install -c constraints.txt -e ".[test]" && pytest -n 4 --dist loadfile' in lines


def test_no_two_test_files_have_one_name():
    """Pytest imports them by their names alone, and fails where one is met twice."""
    names = Counter(path.name for path in (ROOT / "tests").rglob("test_*.py"))
    assert [name for name, count in names.items() if count > 1] == []
