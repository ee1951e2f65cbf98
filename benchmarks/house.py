"""Architecture in numbers: rooms, floors, circles, lines of code, `Any`s; compared with another state.

    python benchmarks/house.py                    # this checkout
    python benchmarks/house.py --against 9c4a9b9  # and how it was before

A room is a file or folder of a level, floors are the longest chain of imports between the rooms. A line of
code holds more than a comment, a docstring or nothing. An `Any` is one in an annotation or a cast.
"""

from __future__ import annotations

import argparse
import ast
import io
import json
import os
import subprocess
import sys
import tarfile
import tempfile
import tokenize
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any

PACKAGES = ("daq_service", "simulator", "analysis", "hardware_drivers")
LEVELS = (*PACKAGES, "daq_service.cli", "daq_service.web", "simulator.doubles", "simulator.plate")
ROOT = Path(__file__).resolve().parents[1]
NOT_CODE = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}


def lines_of_code(text: str) -> int:
    """Count lines with code; docstrings, also of attributes, do not count."""
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in NOT_CODE:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(text)):
        if (
            isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        ):
            lines.difference_update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return len(lines)


def anys(text: str) -> int:
    """Count uses of `typing.Any`."""
    return sum(isinstance(node, ast.Name) and node.id == "Any" for node in ast.walk(ast.parse(text)))


def bare_mappings(text: str) -> int:
    """Count ``dict[str, Any]``, whose values no type checker knows."""
    return sum(
        isinstance(node, ast.Subscript) and ast.unparse(node) == "dict[str, Any]"
        for node in ast.walk(ast.parse(text))
    )


def floors(imports: dict[str, set[str]]) -> int | None:
    """Return the longest chain of imports between rooms, None where they form a circle."""
    height: dict[str, int] = {}
    try:
        for room in TopologicalSorter(imports).static_order():
            height[room] = 1 + max((height[below] for below in imports[room]), default=0)
    except CycleError:
        return None
    return max(height.values())


def levels() -> dict[str, dict[str, int | None]]:
    """Return rooms and floors of each level of the packages that this process imports."""
    import grimp

    graph = grimp.build_graph(*PACKAGES, cache_dir=None)
    found: dict[str, dict[str, int | None]] = {}
    for level in LEVELS:
        if level not in graph.modules or not graph.find_children(level):
            continue
        rooms = graph.find_children(level)
        room_of = {module: room for room in rooms for module in {room} | graph.find_descendants(room)}
        imports = {
            room: {
                room_of[below]
                for module in {room} | graph.find_descendants(room)
                for below in graph.find_modules_directly_imported_by(module)
                if room_of.get(below, room) != room
            }
            for room in rooms
        }
        found[level] = {"rooms": len(rooms), "floors": floors(imports)}
    return found


def measure(tree: Path) -> dict[str, dict[str, int | None]]:
    """Measure the state of the code in a folder."""
    sources = {
        package: [p.read_text("utf-8") for p in (tree / package).rglob("*.py")] for package in PACKAGES
    }
    tests = [path.read_text("utf-8") for path in (tree / "tests").rglob("*.py")]
    counts: dict[str, int | None] = {
        **{package: sum(map(lines_of_code, texts)) for package, texts in sources.items()},
        "four packages": sum(lines_of_code(text) for texts in sources.values() for text in texts),
        "tests": sum(map(lines_of_code, tests)),
    }
    # In a process of its own: the packages are found by their names, not imported twice.
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tree), str(tree / "tests")])}

    def printed(*command: str, check: bool = True) -> Any:
        call = [sys.executable, *command]
        done = subprocess.run(call, cwd=tree, env=environment, capture_output=True, text=True, check=check)
        return json.loads(done.stdout or "{}")

    here = Path(__file__).resolve()
    return {
        **printed(str(here), "--levels"),
        # Nothing of a state whose tests have no line in memory.
        "strike to alarm": printed(str(here.with_name("trace_of_a_set.py")), "--json", check=False),
        "lines of code": counts,
        "Any": {package: sum(map(anys, texts)) for package, texts in sources.items()},
        "dict[str, Any]": {package: sum(map(bare_mappings, texts)) for package, texts in sources.items()},
    }


def measure_revision(revision: str) -> dict[str, dict[str, int | None]]:
    """Measure a commit, unpacked next to this checkout."""
    archive = subprocess.run(
        ["git", "archive", revision, *PACKAGES, "tests", "config"], cwd=ROOT, capture_output=True, check=True
    ).stdout
    with tempfile.TemporaryDirectory() as folder:
        with tarfile.open(fileobj=io.BytesIO(archive)) as files:
            files.extractall(folder, filter="data")
        return measure(Path(folder))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--against", metavar="REVISION", help="print that commit's numbers, too")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.add_argument("--levels", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.levels:
        print(json.dumps(levels()))
        return
    states = {"now": measure(ROOT)}
    if options.against:
        states = {options.against: measure_revision(options.against), **states}
    if options.json:
        print(json.dumps(states))
        return
    print(f"{'':<30}" + "".join(f"{name:>14}" for name in states))
    rows = [(table, key) for table, keys in states["now"].items() for key in keys]
    for table, key in rows:
        values = [state.get(table, {}).get(key, "-") for state in states.values()]
        texts = ["a circle" if value is None else str(value) for value in values]
        print(f"{table + ', ' + key:<30}" + "".join(f"{value:>14}" for value in texts))


if __name__ == "__main__":
    main()
