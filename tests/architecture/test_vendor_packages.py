"""No vendor's package, driver or compiler is needed until a rig asks for it; then the remedy is named."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from support.small_experiment import SMALL

VENDORS = ("nidaqmx", "serial", "niscope", "nitclk", "grpc", "nptdms")

WITHOUT = """
import json, sys
for name in {missing!r}:
    sys.modules[name] = None  # as if it were not installed
from daq_service.cli.main import main
sys.argv = ["solimon", *{arguments!r}]
try:
    main()
finally:
    print(json.dumps(sorted(n for n in {watched!r} if sys.modules.get(n) is not None)))
"""


def solimon(
    *arguments: str, missing: tuple[str, ...], search_path: str | None = None
) -> subprocess.CompletedProcess[str]:
    program = WITHOUT.format(missing=missing, arguments=arguments, watched=VENDORS)
    environment = {**os.environ, **({} if search_path is None else {"PATH": search_path})}
    return subprocess.run(
        [sys.executable, "-c", program],
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def written(folder: Path, **tables: Any) -> str:
    path = folder / "test.json"
    path.write_text(json.dumps({**SMALL, **tables}), encoding="utf-8")
    return str(path)


def test_a_simulated_test_runs_without_any_of_them_and_without_a_compiler(tmp_path: Path) -> None:
    config = written(tmp_path, schedule={**SMALL["schedule"], "end_h": 1.0})
    done = solimon(
        "record", config, "--data-dir", str(tmp_path / "data"), missing=VENDORS, search_path=str(tmp_path)
    )
    assert done.returncode == 0, done.stderr


def test_a_simulated_test_imports_none_of_them(tmp_path: Path) -> None:
    config = written(tmp_path, schedule={**SMALL["schedule"], "end_h": 0.5})
    done = solimon("record", config, "--data-dir", str(tmp_path / "data"), missing=())
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1]) == []


WIRED = {
    name: {
        "board_serial": "1",
        "input": f"ai{index}",
        "counter": f"ctr{index}",
        "output_terminal": f"PFI{12 + index}",
    }
    for index, name in enumerate("BCD")
}
ON_BOARDS: dict[str, Any] = {"clock": {"kind": "wall"}}


def test_a_missing_extra_is_named_with_its_remedy(tmp_path: Path) -> None:
    rig = {
        "kind": "daqmx",
        "daqmx": {"transport": "grpc", "grpc_address": "localhost:1", "transducers": WIRED},
        "niscope": {"probes": {"A": {"resource": "PXI1Slot5"}}},
    }
    config = written(tmp_path, rig=rig, **ON_BOARDS)
    done = solimon("record", config, "--data-dir", str(tmp_path / "data"), missing=("grpc",))
    assert done.returncode == 3
    assert "solimon[grpc]" in done.stderr


def test_a_missing_driver_is_named_with_its_remedy(tmp_path: Path) -> None:
    rig = {"kind": "daqmx", "daqmx": {"transducers": WIRED}}
    rig["niscope"] = {"probes": {"A": {"resource": "PXI1Slot5"}}}
    config = written(tmp_path, rig=rig, **ON_BOARDS)
    # No tool of binutils on the path: ctypes finds no library, whatever is installed here.
    done = solimon(
        "record", config, "--data-dir", str(tmp_path / "data"), missing=(), search_path=str(tmp_path)
    )
    assert done.returncode == 3
    assert "NI-DAQmx" in done.stderr
    assert "install" in done.stderr


def test_a_recording_of_labview_needs_its_extra(tmp_path: Path) -> None:
    (tmp_path / "old.tdms").touch()
    config = written(tmp_path, rig={"kind": "playback", "playback": {"source": "old.tdms", "format": "tdms"}})
    done = solimon("record", config, "--data-dir", str(tmp_path / "data"), missing=("nptdms",))
    assert done.returncode == 2
    assert "solimon[tdms]" in done.stderr
