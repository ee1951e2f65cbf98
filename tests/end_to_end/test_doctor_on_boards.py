"""`solimon doctor` and a rehearsal on doubles of NI's boards: the real driver, the unmodified `nidaqmx`."""

import json
import re
import subprocess
import sys
import textwrap
from dataclasses import asdict, replace
from pathlib import Path

import pytest
from support.daqmx_rig import (
    QUICK_PULSE_S,
    QUICK_TWIN,
    board,
    coil_pulses_s,
    parameters_of,
    quick_description,
    reach,
)

from daq_service.cli.doctor.command import run_doctor
from daq_service.processes.data_folder import prepare_data_folder
from simulator.doubles.chassis.description import SIMULTANEOUS_16_BIT, SLOW
from simulator.doubles.transports.library import find_unavailability_reason
from simulator.parameters.electronics import NoiseParameters

pytestmark = pytest.mark.skipif(
    bool(find_unavailability_reason()), reason=find_unavailability_reason() or "it can be built"
)

NOISY = replace(QUICK_TWIN, noise=NoiseParameters())
DESCRIPTION = replace(
    quick_description(board(), replace(SLOW, name="Dev9"), positions="BCD"), twin=NOISY, shots_per_set=2
)
SAFETY_PAGE = Path(__file__).parents[2] / "docs/how-to/be-safe.md"


@pytest.fixture
def doubles(doubles, monkeypatch):
    reach("library", doubles, monkeypatch)
    return doubles


def configuration(folder, doubles, description=DESCRIPTION, **changes):
    """Write the configuration file of a wall-clock test on these doubles; changes apply to [rig.daqmx]."""
    boards = asdict(replace(parameters_of(description, doubles), **changes))
    values = {
        "clock": {"kind": "wall"},
        "schedule": {
            "phases": [{"until_h": 0.0008, "interval_h": 0.0004}],
            "shots_per_set": 2,
            "shot_interval_s": 0.05,
        },
        "baseline": {"minimum_valid_shots": 2},
        "positions": {name: {"method": "solitary_wave"} for name in description.transducers},
        "rig": {"kind": "daqmx", "daqmx": boards},
    }
    path = folder / "laboratory.json"
    path.write_text(json.dumps(values), encoding="utf-8")
    return path


def doctor(capsys, config, folder, strike=None):
    """Return exit code, checks by name, and the complete report."""
    code = run_doctor(config=config, data_dir=folder, strike=strike, as_json=True)
    report = json.loads(capsys.readouterr().out)
    assert report["exit_code"] == code
    return code, {check["name"]: check for check in report["checks"]}, report


def test_a_sound_rig_is_checked_completely_and_nothing_is_energized(doubles, tmp_path, capsys):
    code, checks, report = doctor(capsys, configuration(tmp_path, doubles), tmp_path / "data")
    assert code == 0, [check for check in checks.values() if check["state"] == "fail"]
    serial = f"{SIMULTANEOUS_16_BIT.serial_number:08X}"
    assert checks["driver: version"]["found"] == "NI-DAQmx 24.8.0 (at least 20.1)"
    calibrated = checks[f"board {serial}: calibrated"]
    assert calibrated["values"]["product"] == "PXIe-6386"
    assert calibrated["values"]["temperature_c"] == SIMULTANEOUS_16_BIT.temperature_c
    for position, channel, counter in (("B", "ai0", "PFI12"), ("C", "ai1", "PFI13"), ("D", "ai2", "PFI14")):
        assert f"{channel}, +-5 V, 10 MS/s" in checks[f"transducer {position}: board can do it"]["found"]
        assert f"0.25 V rising at {channel}" in checks[f"transducer {position}: trigger"]["found"]
        assert f"to {counter}, 0.003 s" in checks[f"transducer {position}: coil's counter"]["found"]
        assert counter in checks[f"transducer {position}: coil's terminal"]["found"]
        noise = checks[f"transducer {position}: noise"]["values"]
        # White 25 mV and slow 15 mV: 29 mV; a record holds some ten correlation times of the slow part.
        assert noise["noise_rms_v"] == pytest.approx(29e-3, rel=0.2)
        assert noise["trigger_level_v"] == 0.25
    assert report["strike"] is None
    record = doubles.control.record()
    assert coil_pulses_s(record) == []
    assert not any(event["level"] for event in record["lines"]), "no line was ever high"
    assert (record["tasks"], record["reservations"]) == ([], {}), "everything is given back"
    assert not (tmp_path / "data").exists(), "no folder is made on the way"


def test_the_record_of_lines_would_show_a_strike(doubles, tmp_path, capsys):
    code, checks, report = doctor(capsys, configuration(tmp_path, doubles), tmp_path / "data", strike="C")
    assert code == 0
    assert "reflected" in checks["strike C: record"]["found"]
    assert report["strike"]["position"] == "C"
    assert report["strike"]["features"]["isw_amplitude_v"] > 0.25, "beyond its trigger level"
    # From 1 mm the wave is small against the noise, which may be flagged; it is a whole shot all the same.
    assert set(report["strike"]["features"]["flags"]) <= {"baseline", "noisy"}
    assert report["strike"]["settings"]["trigger_level_v"] == pytest.approx(0.25, abs=1e-3)
    record = doubles.control.record()
    # Two pulses of one coil, one to look at it and one shot; the double times them in whole ns.
    assert coil_pulses_s(record) == [pytest.approx(QUICK_PULSE_S, abs=1e-8)] * 2
    assert {event["position"] for event in record["lines"] if event["level"]} == {"C"}
    assert record["tasks"] == []


def test_boards_of_a_running_recorder_are_left_alone(doubles, tmp_path, capsys):
    folder, config = tmp_path / "data", configuration(tmp_path, doubles)
    prepare_data_folder(folder)
    script = (
        "import sys; from pathlib import Path\n"
        "from daq_service.processes.data_folder import hold_recorder_lock\n"
        "with hold_recorder_lock(Path(sys.argv[1])):\n    print('owned', flush=True); sys.stdin.read()"
    )
    command = [sys.executable, "-c", script, str(folder)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as owner:
        assert owner.stdout is not None
        assert owner.stdout.readline() == "owned\n"
        code, checks, _ = doctor(capsys, config, folder)
        owner.communicate("")
    assert code == 5
    assert f"process {owner.pid}" in checks["recorder"]["found"]
    assert checks["boards"]["state"] == "skipped"
    assert doubles.control.record()["calls"] == []


def test_the_power_up_states_of_the_safety_page_are_set(doubles):
    from nidaqmx.constants import PowerUpStates
    from nidaqmx.system import System

    (script,) = re.findall(r"```python\n(.*?)```", SAFETY_PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    name = SIMULTANEOUS_16_BIT.name
    exec(textwrap.dedent(script).replace("PXI1Slot2", name), {})
    states = {
        state.physical_channel: state.power_up_state
        for state in System.local().get_digital_power_up_states(name)
    }
    low = {line for line, state in states.items() if state == PowerUpStates.LOW}
    assert low == {f"{name}/port2/line{number}" for number in (4, 5, 6)}, "the coils' lines and no other"
