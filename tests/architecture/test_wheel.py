"""The wheel alone, in an empty folder: an editable install would hide what is missing from it."""

import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TEMPLATES = sorted((ROOT / "daq_service/web/templates").glob("*.*"))


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    build = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--no-deps",
        "--no-build-isolation",
        "-w",
        str(folder),
        str(ROOT),
    ]
    subprocess.run(build, check=True, capture_output=True)
    (path,) = folder.glob("solimon-*.whl")
    return path


def test_the_wheel_holds_configuration_dashboard_templates_migrations_and_licence(wheel):
    archive = zipfile.ZipFile(wheel)
    names = archive.namelist()
    needed_by_doubles = ("nidaqmx.h", "niScope.h", "attributes.csv", "statuses.toml")
    for wanted in (
        *(f"simulator/doubles/vendor_api/{name}" for name in needed_by_doubles),
        "daq_service/cli/groups/commands.toml",
        "daq_service/web/answers/vocabulary.toml",
        "daq_service/web/auth/roles.toml",
        "daq_service/web/answers/problems.toml",
        "daq_service/cli/maintenance/acceptance/texts.toml",
        "daq_service/cli/reproduce/paper_values.csv",
        "daq_service/cli/reproduce/texts.toml",
        "daq_service/cli/set_up/services/record.service",
        "daq_service/cli/set_up/services/task.xml",
        "daq_service/cli/set_up/heads/setup.txt",
        "daq_service/config/simulated.toml",
        "daq_service/config/laboratory.toml",
        "daq_service/config/settings.schema.json",
        "daq_service/web/dashboard/index.html",
        *(f"daq_service/web/templates/{path.name}" for path in TEMPLATES),
        "daq_service/web/dashboard/vendor/uplot/LICENSE",
        "daq_service/alarms/guidance.toml",
        "daq_service/catalogue/earlier_names.toml",
        "daq_service/catalogue/migrations/versions/revision_0001_first_catalogue.sql",
        "simulator/doubles/chassis/boards.toml",
        "simulator/parameters/environmental_variability.toml",
        "hardware_drivers/daqmx/status_classes.toml",
        "hardware_drivers/niscope/status_classes.toml",
        "hardware_drivers/serial_port/dialects.toml",
        "hardware_drivers/conformance/test_instrument.py",
        "hardware_drivers/conformance/digitizer_contract.py",
        *(f"{package}/py.typed" for package in ("daq_service", "hardware_drivers", "analysis", "simulator")),
    ):
        assert wanted in names
    assert any(name.endswith("licenses/LICENSE") for name in names)
    (offered,) = (name for name in names if name.endswith(".dist-info/entry_points.txt"))
    assert b"[pytest11]\nsolimon = hardware_drivers.conformance.plugin\n" in archive.read(offered)
    assert not [name for name in names if name.startswith(("tests/", "benchmarks/", "docs/"))]


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_wheel_and_the_constraints_alone_make_a_whole_environment(wheel, tmp_path):
    subprocess.run([sys.executable, "-m", "venv", str(tmp_path / "fresh")], check=True)
    python = tmp_path / "fresh" / ("Scripts" if os.name == "nt" else "bin") / "python"
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}

    def run(*words):
        done = subprocess.run(
            [str(python), *words], env=environment, cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    run("-m", "pip", "install", "-q", "--no-deps", "-r", str(ROOT / "constraints.txt"), str(wheel))
    assert run("-m", "pip", "check").strip() == "No broken requirements found."
    assert "0.1.0" in run("-m", "daq_service.cli", "--version")


def take_machine_code(site):
    """Copy the compiled kernels of this checkout to identical sources: compiling takes 20 s.

    Numba believes a cache whose source has the size and the time of the one it was made from.
    """
    for source in site.rglob("*.py"):
        here = ROOT / source.relative_to(site)
        made = list((here.parent / "__pycache__").glob(f"{here.stem}.*.nb[ic]"))
        if made and here.read_bytes() == source.read_bytes():
            (source.parent / "__pycache__").mkdir(exist_ok=True)
            for file in made:
                shutil.copy(file, source.parent / "__pycache__")
            stamp = here.stat()
            os.utime(source, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))


def test_the_demo_runs_from_the_wheel_in_an_empty_folder(wheel, tmp_path):
    site, empty = tmp_path / "site", tmp_path / "empty"
    empty.mkdir()
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    take_machine_code(site)
    environment = {
        **os.environ,
        "PYTHONPATH": str(site),  # before site-packages, where the editable install would be found
        "SOLIMON_PLATE__ELEMENTS_PER_EDGE": "16",
    }
    where = "import daq_service; print(daq_service.__file__)"
    found = subprocess.run(
        [sys.executable, "-c", where], env=environment, cwd=empty, capture_output=True, text=True, check=True
    )
    assert Path(found.stdout.strip()).is_relative_to(site)
    command = [sys.executable, "-m", "daq_service.cli", "demo", "--exit", "--json", "--hours", "1"]
    done = subprocess.run(
        command, env=environment, cwd=empty, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["sets"] == 2
    (folder,) = empty.iterdir()
    assert Path(result["data_dir"]) == folder
    assert "dashboard: http://127.0.0.1:" in done.stderr
