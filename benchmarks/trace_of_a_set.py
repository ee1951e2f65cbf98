"""Modules of `daq_service` that run from the first strike of a set to its stored alarm, and their lines.

    python benchmarks/trace_of_a_set.py          # names of the modules, most lines first
    python benchmarks/trace_of_a_set.py --json   # the two sums, as `house.py` shows them

A test in memory with a probe and three transducers is recorded; the set traced is the one after which the
alarms of baselines without limits are raised.
"""

from __future__ import annotations

import json
import logging
import sys
import tempfile
from pathlib import Path
from types import FrameType
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path += [str(ROOT / "benchmarks"), str(ROOT / "tests")]

from house import lines_of_code  # noqa: E402
from support.memory_line import Line, healthy  # noqa: E402

import daq_service  # noqa: E402
from daq_service.catalogue import RecorderCatalogue  # noqa: E402

PACKAGE = Path(daq_service.__file__).parent
TRACED_SET = 7


def traced_modules() -> dict[str, int]:
    """Return the lines of code of each module that was entered."""
    entered: set[str] = set()
    commit = RecorderCatalogue.commit_set

    def enter(frame: FrameType, event: str, _: object) -> None:
        if event == "call":
            entered.add(frame.f_code.co_filename)

    def script(key: Any) -> Any:
        if key.set_index == TRACED_SET and not entered:
            sys.setprofile(enter)
        return healthy(key)

    def commit_until_alarm(catalogue: RecorderCatalogue, transaction: Any) -> Any:
        committed = commit(catalogue, transaction)
        if transaction.alarms and entered:
            sys.setprofile(None)
        return committed

    RecorderCatalogue.commit_set = commit_until_alarm  # type: ignore[method-assign]
    with tempfile.TemporaryDirectory() as folder:
        Line(Path(folder), script=script, listen_every_s=1e9).run()  # no look at commands by chance
    return {
        path.relative_to(PACKAGE).as_posix(): lines_of_code(path.read_text(encoding="utf-8"))
        for path in map(Path, sorted(entered))
        if path.is_relative_to(PACKAGE)
    }


if __name__ == "__main__":
    logging.disable(logging.CRITICAL)
    modules = traced_modules()
    if "--json" in sys.argv:
        print(json.dumps({"modules": len(modules), "lines of code": sum(modules.values())}))
    else:
        for name, lines in sorted(modules.items(), key=lambda item: -item[1]):
            print(f"{lines:>6} {name}")
        print(f"{sum(modules.values()):>6} lines of code in {len(modules)} modules")
