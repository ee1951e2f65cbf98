"""The committed faults: each still applies and names a test that is there; the slow run shows all noticed."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from mutants.run import apply, mutants

ROOT = Path(__file__).parents[2]
FAULTS = mutants()
LINE_FAULTS = mutants("line")
FEWEST = 40


def test_every_fault_is_one_change_of_code():
    assert len(FAULTS) >= FEWEST
    for one in FAULTS + LINE_FAULTS:
        lines = one.patch.read_text(encoding="utf-8").splitlines()
        added = [line for line in lines if re.match(r"\+(?!\+\+ )", line)]
        removed = [line for line in lines if re.match(r"-(?!-- )", line)]
        assert (len(added), len(removed)) in {(1, 1), (0, 1)}, one.name
        assert not any(line.startswith("diff --git a/tests") for line in lines), one.name


@pytest.mark.parametrize("fault", FAULTS + LINE_FAULTS, ids=lambda fault: fault.name)
def test_a_fault_applies_and_the_test_that_notices_it_is_there(fault):
    try:
        apply(fault.patch, ROOT, "--check")
    except subprocess.CalledProcessError as error:
        pytest.fail(f"{fault.name} applies no more, make it anew: {error.stderr}")
    file, _, test = fault.noticed_by.partition("::")
    assert file.startswith("tests/unit/") or fault in LINE_FAULTS
    name = test.partition("[")[0].rpartition("::")[2]
    (marks,) = re.findall(
        rf"^((?:[ ]*@.+\n(?:[ )\]].*\n)*)*)[ ]*def {name}\(",
        (ROOT / file).read_text(encoding="utf-8"),
        flags=re.MULTILINE,
    )
    assert "\n@pytest.mark.slow" not in f"\n{marks}", "the default run leaves this test out"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "faults"), [([], FAULTS), (["--line"], LINE_FAULTS)], ids=["unit", "line"]
)
def test_every_fault_is_noticed_by_the_test_that_it_names(options, faults):
    command = [sys.executable, ROOT / "tests" / "mutants" / "run.py", "--json", *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert (report["faults"], report["unnoticed"]) == (len(faults), [])
