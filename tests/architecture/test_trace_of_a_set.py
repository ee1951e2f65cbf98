"""A newcomer follows a set from strike to alarm in few files: what the trace enters does not rise."""

import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
MOST_MODULES, MOST_LINES = 10, 2467
"""Of `daq_service`; lower a number with the code. At most 2,500 lines: a newcomer reads them in a day."""


def test_the_trace_of_a_set_enters_no_further_module_and_no_further_line():
    command = [sys.executable, ROOT / "benchmarks" / "trace_of_a_set.py", "--json"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    assert found["modules"] <= MOST_MODULES
    assert found["lines of code"] <= MOST_LINES
