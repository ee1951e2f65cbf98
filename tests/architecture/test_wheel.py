"""The wheel alone, in an empty folder: an editable install would hide what is missing from it."""

import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from hatchling.builders.sdist import SdistBuilder
from hatchling.builders.wheel import WheelBuilder

from daq_service.web.documentation import SITE

ROOT = Path(__file__).parents[2]
PACKAGES = ("daq_service", "hardware_drivers", "analysis", "simulator")
FACADE = "daq_service/facade/"
KEYS_OF_A_POSITION = {
    *("first_alarm_h", "outlier_fraction_before_100_h", "outlier_fraction_after_100_h", "tof_us"),
    *("amplitude_ratio", "limit", "n_baseline", "travel_time_us", "thickness_mm"),
}


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


def test_the_wheel_holds_every_file_of_the_packages_configuration_and_licence(wheel):
    archive = zipfile.ZipFile(wheel)
    names = archive.namelist()
    listed = subprocess.run(
        ["git", "ls-files", *PACKAGES], cwd=ROOT, capture_output=True, text=True, check=True
    )
    configuration = [f"daq_service/config/{path.name}" for path in (ROOT / "config").iterdir()]
    files = [name.removeprefix(FACADE) for name in listed.stdout.split()]
    assert {*files, *configuration} - set(names) == set()
    assert "solimon/__init__.py" in names
    assert len(names) == len(set(names))
    assert any(name.endswith("licenses/LICENSE") for name in names)
    (offered,) = (name for name in names if name.endswith(".dist-info/entry_points.txt"))
    assert b"[pytest11]\nsolimon = hardware_drivers.conformance.plugin\n" in archive.read(offered)
    assert not [name for name in names if name.startswith(("tests/", "benchmarks/", "docs/", FACADE))]


@pytest.mark.parametrize("builder", [WheelBuilder, SdistBuilder])
def test_a_built_documentation_site_is_included_though_git_ignores_it(builder, tmp_path):
    for name in ("pyproject.toml", "README.md", "LICENSE", ".gitignore"):
        shutil.copy(ROOT / name, tmp_path)
    (tmp_path / "config").mkdir()
    site = tmp_path / SITE.relative_to(ROOT)
    (site / "tutorial").mkdir(parents=True)
    for name in ("index.html", "tutorial/index.html", "search.json"):
        (site / name).touch()
    included = {Path(file.path) for file in builder(str(tmp_path)).recurse_included_files()}
    assert {path for path in site.rglob("*") if path.is_file()} <= included


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
    assert run("-c", "import solimon; print(solimon.__version__)") == "0.1.0\n"


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
    assert (result["sets"], result["shots"], result["missed_sets"]) == (2, 60, 0)
    assert sum(value for name, value in result["cost"].items() if name != "sets") == pytest.approx(
        result["elapsed_s"], abs=1e-3 * len(result["cost"])
    )  # each is rounded
    positions = result["positions"]
    assert list(positions) == ["A", "B", "C", "D"]
    assert all(row.keys() >= KEYS_OF_A_POSITION for row in positions.values())
    assert all(positions["A"][key] is None for key in ("tof_us", "amplitude_ratio", "limit", "n_baseline"))
    # An hour of linear thinning to 3.8 mm at 350 h leaves 6.343 mm; a sample of 10 ns is 0.03 mm.
    assert positions["A"]["thickness_mm"] == pytest.approx(6.343, abs=0.03)
    assert (positions["D"]["limit"], positions["D"]["n_baseline"]) == (None, 2)
    assert "baseline" in positions["D"]["limit_reason"]
    (folder,) = empty.iterdir()
    assert Path(result["data_dir"]) == folder
    assert "dashboard: http://127.0.0.1:" in done.stderr
