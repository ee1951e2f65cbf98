"""The tools that guard the house, run as a test so that nobody can forget them."""

import subprocess
import sys
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
def test_the_house_is_in_order(command: list[str]) -> None:
    module, *arguments = command
    program = (
        [sys.executable, "-c", "from importlinter.cli import lint_imports_command as main; main()"]
        if module == "importlinter"
        else [sys.executable, "-m", module, *arguments]
    )
    done = subprocess.run(program, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_readme_s_commands_are_one_line_each() -> None:
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    assert "python -m pip install -c constraints.txt -e . && solimon demo" in lines
    assert 'python -m pip install -c constraints.txt -e ".[test]" && pytest -n 3 --dist loadfile' in lines
