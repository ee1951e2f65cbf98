"""Apply each one-line fault to a copy of the code and show that the test it names notices it.

    python tests/mutants/run.py                 # those that a unit test notices, in milliseconds
    python tests/mutants/run.py --line          # those of the whole line: doubles, processes, physics
    python tests/mutants/run.py 07 13 --json    # these two, as one JSON object

A patch's head says what is wrong (``Fault:``) and which test fails then (``Noticed by:``). The tests first
run on the code as it is: one that fails there proves nothing. Exit code 0 if every fault is noticed.
"""

from __future__ import annotations

import argparse
import importlib
import io
import json
import multiprocessing
import multiprocessing.connection
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
LOADED_ONCE = (
    "pytest",
    "hypothesis",
    "numpy",
    "scipy.stats",
    "sqlalchemy",
    "alembic",
    "pydantic",
    "h5py",
    "click",
)
"""Imported before a process is forked for each fault: they take longer than the tests."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Mutant:
    """One committed fault."""

    name: str
    patch: Path
    fault: str
    noticed_by: str


def mutants(folder: str = "") -> list[Mutant]:
    """Return every committed fault of a folder by name (here: of unit tests; ``line``: of the whole line)."""
    found = []
    for patch in sorted((HERE / folder).glob("*.patch")):
        head = dict(re.findall(r"^(Fault|Noticed by): (.+)$", patch.read_text("utf-8"), flags=re.MULTILINE))
        found.append(Mutant(name=patch.stem, patch=patch, fault=head["Fault"], noticed_by=head["Noticed by"]))
    return found


def copy_of_the_code(folder: Path) -> None:
    """Copy the files that the unit tests need; files that git ignores stay behind."""
    for name in ("daq_service", "simulator", "analysis", "hardware_drivers", "config", "tests", "benchmarks"):
        shutil.copytree(
            ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__", "*.nbi", "*.nbc")
        )
    shutil.copy(ROOT / "pyproject.toml", folder)


def apply(patch: Path, copy: Path, *options: str) -> None:
    """Apply a patch to a copy; ``--reverse`` reverts it, ``--check`` only checks whether it applies.

    Raises
    ------
    subprocess.CalledProcessError
        It does not apply; its ``stderr`` says where.
    """
    command = ["git", "apply", "--whitespace=nowarn", *options, str(patch)]
    # Outside a repository git applies to the folder it stands in.
    environment = {**os.environ, "GIT_CEILING_DIRECTORIES": str(copy.parent)}
    subprocess.run(command, cwd=copy, env=environment, check=True, capture_output=True, text=True)


def _run(copy: Path, tests: Sequence[str], results: multiprocessing.connection.Connection) -> None:
    """Run tests on the copy in a child; send the exit code of pytest, its output and processor seconds."""
    os.chdir(copy)
    sys.path[:] = [str(copy), str(copy / "tests"), *(p for p in sys.path if Path(p).resolve() != ROOT)]
    os.environ["PYTHONPATH"] = str(copy)  # what a test starts runs the copy too
    sys.dont_write_bytecode = True
    import pytest

    output = io.StringIO()
    options = ["-q", "-x", "--no-header", "-p", "no:cacheprovider", "-p", "no:xdist"]
    # What is loaded before the fork has plain asserts; they are none of ours.
    options += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]
    with redirect_stdout(output), redirect_stderr(output):
        code = pytest.main([*options, *tests])
    spent = os.times()
    results.send((int(code), output.getvalue(), sum(spent[:4])))


def run_tests(copy: Path, tests: Sequence[str]) -> tuple[int, str, float]:
    """Run tests on the copy in their own process."""
    # Elsewhere libraries do not survive a fork, or there is none: then each child imports them again.
    context = multiprocessing.get_context("fork" if sys.platform == "linux" else "spawn")
    ours, theirs = context.Pipe(duplex=False)
    child = context.Process(target=_run, args=(copy, tests, theirs))
    child.start()
    theirs.close()
    try:
        answer: tuple[int, str, float] = ours.recv()
    except EOFError:
        answer = (-1, "the process died", 0.0)
    child.join()
    return answer


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("names", nargs="*", help="numbers or names; default: all")
    parser.add_argument("--line", action="store_true", help="the faults of the whole line")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    options = parser.parse_args()
    there = mutants("line" if options.line else "")
    chosen = [one for one in there if not options.names or any(map(one.name.startswith, options.names))]
    if not chosen:
        parser.error(f"no fault is called {' or '.join(options.names)}")
    for name in LOADED_ONCE:
        importlib.import_module(name)
    with tempfile.TemporaryDirectory() as place:
        copy = Path(place)
        copy_of_the_code(copy)
        for one in chosen:
            try:
                apply(one.patch, copy, "--check")
            except subprocess.CalledProcessError as error:
                parser.error(f"{one.name} applies no more, make it anew: {error.stderr}")
        tests = sorted({one.noticed_by for one in chosen})
        code, output, cpu_s = run_tests(copy, tests)
        if code != 0:
            print(f"the tests fail on the code as it is:\n{output}", file=sys.stderr)
            return 1
        unnoticed = []
        for one in chosen:
            apply(one.patch, copy)
            code, output, _ = run_tests(copy, [one.noticed_by])
            apply(one.patch, copy, "--reverse")
            noticed = code == 1  # tests were run and failed: an import error or a missing test is none
            if not noticed:
                unnoticed.append(one.name)
            print(f"{'noticed' if noticed else 'NOT NOTICED':<12}{one.name}: {one.fault}", file=sys.stderr)
            if not noticed:
                print(f"{one.noticed_by}\n{output}", file=sys.stderr)
    facts = {
        "faults": len(chosen),
        "unnoticed": unnoticed,
        "tests": len(tests),
        "tests_cpu_s": round(cpu_s, 1),
    }
    if options.json:
        print(json.dumps(facts))
    else:
        print(
            f"{len(chosen) - len(unnoticed)} of {len(chosen)} faults noticed; "
            f"the {len(tests)} tests: {cpu_s:.1f} s of processor"
        )
    return 1 if unnoticed else 0


if __name__ == "__main__":
    sys.exit(main())
