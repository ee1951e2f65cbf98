"""Without the extras: each command that needs one names it, and a rig without the twin works."""

import json
import subprocess
import sys

import pytest
from support.command_line import SOLIMON
from support.missing_modules import environment_without
from support.small_experiment import rows_of, run, small_settings

from daq_service.errors import EXIT_NOT_MET
from daq_service.processes.data_folder import write_configuration

TWIN, REPORT = ("numba", "llvmlite"), ("matplotlib",)
CLIENT = ("httpx2", "pandas", "xarray")
NO_TWIN = 'numba, llvmlite are not installed: pip install "solimon[twin]"'
NO_REPORT = 'matplotlib is not installed: pip install "solimon[report]"'


@pytest.fixture(scope="module")
def light(tmp_path_factory):
    return environment_without(tmp_path_factory.mktemp("light") / "site", *TWIN, *REPORT)


def run_in(environment, folder, *arguments):
    return subprocess.run(
        [*SOLIMON, *arguments], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


MIXED = """
clock.kind = "wall"
[rig]
kind = "mixed"
[rig.instruments.twin]
kind = "simulated"
[rig.positions.A]
pulse_echo = "twin"
[rig.positions.B]
digitizer = "twin"
striker = "twin"
[rig.positions.C]
digitizer = "twin"
striker = "twin"
[rig.positions.D]
digitizer = "twin"
striker = "twin"
"""


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["demo", "--exit"], NO_TWIN),
        (["demo", "--rig", "daqmx-library"], NO_TWIN),
        (["run", "--data-dir", "data"], NO_TWIN),
        (["record", "--data-dir", "data"], NO_TWIN),
        (["run", "mixed.toml", "--data-dir", "data"], NO_TWIN),
        (["simulate"], NO_TWIN),
        (["reproduce"], 'matplotlib, numba, llvmlite are not installed: pip install "solimon[report,twin]"'),
        (["report", "."], NO_REPORT),
        (["explain", "1", "--data-dir", "."], NO_REPORT),
        (["acceptance-report", "--data-dir", ".", "--html", "page.html"], NO_REPORT),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_a_command_names_the_extra_that_it_needs_before_it_writes_anything(
    arguments, message, light, tmp_path
):
    (tmp_path / "mixed.toml").write_text(MIXED, encoding="utf-8")
    done = run_in(light, tmp_path, *arguments)
    assert (done.returncode, done.stdout, done.stderr) == (2, "", f"solimon: {message}\n")
    assert [path.name for path in tmp_path.iterdir()] == ["mixed.toml"]


IMPORTED = """
import json, sys, solimon
with solimon.open(sys.argv[1]) as test:
    rows = len(test.features("B"))
print(json.dumps([solimon.__version__, rows, sorted({"numba", "matplotlib"} & set(sys.modules))]))
"""


def test_a_rig_without_the_twin_records_and_is_read_without_its_packages(light, tmp_path):
    end = {"end_h": 1.5}
    assert run(small_settings(schedule=end), tmp_path / "recording")
    playback = {"kind": "playback", "playback": {"source": str(tmp_path / "recording")}}
    played = tmp_path / "played"
    played.mkdir()
    config = str(write_configuration(small_settings(schedule=end, rig=playback), played))
    done = run_in(light, tmp_path, "record", config, "--data-dir", "played")
    assert done.returncode == 0, done.stderr
    assert rows_of(played) == rows_of(tmp_path / "recording")
    for arguments in (["status", "--data-dir"], ["replay"], ["acceptance-report", "--data-dir"]):
        done = run_in(light, tmp_path, *arguments, "played")
        assert done.returncode in (0, EXIT_NOT_MET), (arguments, done.stderr)
    command = [sys.executable, "-c", IMPORTED, "played"]
    done = subprocess.run(command, env=light, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == ["0.1.0", 3, []]


def test_without_the_client_s_packages_the_version_is_known_and_the_extra_is_named(tmp_path):
    environment = environment_without(tmp_path / "site", *CLIENT)
    code = "import solimon; print(solimon.__version__); solimon.open('data')"
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (1, "0.1.0\n")
    assert done.stderr.endswith(
        'MissingExtraError: httpx2, pandas, xarray are not installed: pip install "solimon[client]"\n'
    )


# Files that hide a package ------------------------------------------------------------------------------

OPENED = [sys.executable, "-c", "import solimon; print(solimon.__version__)"]


@pytest.mark.parametrize("command", [[*SOLIMON, "check-config"], OPENED], ids=["command", "import"])
@pytest.mark.parametrize("hiding", ["analysis.py", "simulator.py", "hardware_drivers/__init__.py"])
def test_a_file_that_hides_a_package_is_named(hiding, command, tmp_path):
    file = tmp_path / hiding
    file.parent.mkdir(exist_ok=True)
    file.touch()
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    found = file if file.stem != "__init__" else file.parent
    message = (
        f"{found} hides the package {hiding.partition('/')[0].removesuffix('.py')!r} of solimon; "
        "rename it, or start in another folder"
    )
    assert done.returncode in (1, 2)
    assert done.stdout == ""
    assert done.stderr.splitlines()[-1].endswith(f": {message}")
    assert command is OPENED or done.stderr == f"solimon: {message}\n"


def test_a_folder_of_data_with_a_package_s_name_hides_nothing(tmp_path):
    (tmp_path / "analysis").mkdir()
    done = subprocess.run(OPENED, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout == "0.1.0\n"
