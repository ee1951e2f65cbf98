"""`solimon setup` on doubles of NI's boards: what it finds, asks, strikes, proposes and writes."""

from __future__ import annotations

import io
import json
from dataclasses import replace

import pytest
from support.command_line import solimon_here
from support.daqmx_models import running_brain
from support.daqmx_rig import CHAIN, QUICK_TWIN, board, coil_pulses_s, meet, quick_description, reach, why_no
from support.small_experiment import run
from support.stored_files import read_set, set_files
from support.waiting import happened

from daq_service.catalogue import open_catalogue
from daq_service.catalogue.rows import FeatureRow
from daq_service.cli.set_up.dialogue import Dialogue
from daq_service.cli.set_up.setup import find_boards
from daq_service.cli.set_up.wiring import parse_wiring
from daq_service.errors import BusyError
from daq_service.processes.data_folder import hold_recorder_lock, prepare_data_folder
from daq_service.settings.file import load_settings
from simulator.doubles.chassis.crosstalk import Crosstalk
from simulator.doubles.chassis.description import SLOW
from simulator.doubles.transports.library import find_unavailability_reason
from simulator.parameters.electronics import NoiseParameters

pytestmark = pytest.mark.skipif(
    bool(find_unavailability_reason()), reason=find_unavailability_reason() or "it can be built"
)

QUICK = quick_description(board(), replace(SLOW, name="Dev9"), positions="BC")
SPIKE = Crosstalk(on_v=0.3, off_v=1.0, decay_s=0.3e-3)
DESCRIPTION = replace(
    QUICK,
    transducers={
        name: replace(wiring, chain=replace(CHAIN, drop_height_m=5e-3), crosstalk=SPIKE)
        for name, wiring in QUICK.transducers.items()
    },
    twin=replace(QUICK_TWIN, noise=NoiseParameters()),
)
PULSE_S = 0.01
WIRED = ("--transducer", "B=01E16086/ai0/ctr0", "--transducer", "C=1e16086/ai1/ctr1")
SCHEDULE = {
    "SOLIMON_SCHEDULE__PHASES": '[{"until_h": 0.0001, "interval_h": 0.0001}]',
    "SOLIMON_SCHEDULE__SHOTS_PER_SET": "2",
    "SOLIMON_SCHEDULE__SHOT_INTERVAL_S": "0.1",
    "SOLIMON_BASELINE__MINIMUM_VALID_SHOTS": "2",
    "SOLIMON_ALARMS__HOLE_SHOTS": "2",
}
"""One short set: how a rig is wired and triggered stays as it was written."""


@pytest.fixture
def doubles(doubles, monkeypatch):
    happened(doubles.control.wait_until_quiet, "every striker landed")
    reach("library", doubles, monkeypatch)
    return doubles


def setup(file, *arguments, env=None):
    return solimon_here("setup", str(file), "--pulse-s", str(PULSE_S), *arguments, env=env or {})


def report(done):
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_flags_lead_to_a_file_whose_first_set_is_good(doubles, tmp_path, monkeypatch):
    file = tmp_path / "lab.toml"
    answer = report(setup(file, *WIRED, "--strike", "--json"))
    assert answer["struck"] == ["B", "C"]
    assert answer["proposal"]["taken"]
    assert answer["proposal"]["troubles"] == {}
    assert coil_pulses_s(doubles.control.record()) == [pytest.approx(PULSE_S, abs=1e-8)] * 2
    assert solimon_here("check-config", str(file), env={}).returncode == 0
    boards = load_settings(file).rig.daqmx
    assert boards is not None
    # The wave is 2.7 V high; the coil's 1 V at off needs 0.6 ms to fall to half of the level.
    assert {wiring.range_v for wiring in boards.transducers.values()} == {5.0}
    assert boards.trigger_level_v == pytest.approx(0.26, abs=0.03)
    assert boards.trigger_slope == "rising"
    assert boards.holdoff_s is not None
    assert 0.5e-3 < boards.ringing_s < boards.holdoff_s < boards.fall_s
    text = file.read_text(encoding="utf-8")
    assert "From strikes of B, C." in text
    assert "#[rig.supply]" in text, "what is not there is switched off"
    for name, value in SCHEDULE.items():
        monkeypatch.setenv(name, value)
    folder = tmp_path / "data"
    assert run(load_settings(file), folder)
    (first,) = set_files(folder).values()
    assert [shot.key.position for shot in read_set(first).shots] == ["B", "B", "C", "C"]
    with open_catalogue(folder) as catalogue:
        assert [row.n_valid for row in catalogue.rows(FeatureRow, scope="set")] == [2, 2]


@pytest.mark.skipif(bool(why_no("grpc")), reason=why_no("grpc") or "it can be reached")
def test_boards_of_another_computer_are_set_up_alike(doubles, tmp_path):
    file = tmp_path / "lab.toml"
    there = ("--transport", "grpc", "--grpc-address", doubles.grpc)
    answer = report(setup(file, *WIRED[:2], *there, "--strike", "--json"))
    assert (answer["struck"], answer["proposal"]["troubles"]) == (["B"], {})
    boards = load_settings(file).rig.daqmx
    assert boards is not None
    assert (boards.transport, boards.grpc_address) == ("grpc", doubles.grpc)


def test_without_permission_nothing_strikes_and_the_file_states_it(doubles, tmp_path):
    file = tmp_path / "lab.toml"
    answer = report(setup(file, *WIRED, "--json"))
    assert (answer["struck"], answer["proposal"]) == ([], None)
    record = doubles.control.record()
    assert coil_pulses_s(record) == []
    assert not any(event["level"] for event in record["lines"])
    assert (record["tasks"], record["reservations"]) == ([], {})
    assert "Nothing was struck" in file.read_text(encoding="utf-8")
    boards = load_settings(file).rig.daqmx
    assert boards is not None
    # For any coil: a third of the fall from 5 mm less the pre-trigger.
    assert (boards.trigger_level_v, boards.holdoff_s) == (0.25, 0.0106)


def test_prompts_repeat_until_the_answer_is_valid(doubles, tmp_path, monkeypatch):
    answers = [
        "Tank 3",
        "",
        "0",
        str(PULSE_S),
        "B",
        "",
        "ai9",
        "",
        "",
        "",
        "strike",
        "",
        "",
        "yes",
        "",
        "",
        "",
    ]
    monkeypatch.setattr("sys.stdin", io.StringIO("\n".join(answers) + "\n"))
    file = tmp_path / "lab.toml"
    done = solimon_here("setup", str(file), "--json", "--no-web", env={})
    answer = report(done)
    assert "0 is not within 0.001 .. 0.5" in done.stderr
    assert "'ai9' is none of ai0, ai1" in done.stderr
    assert (answer["struck"], answer["proposal"]["taken"]) == (["B"], True)
    assert answer["transducers"]["B"]["output_terminal"] == "PFI12"
    assert len(coil_pulses_s(doubles.control.record())) == 1
    settings = load_settings(file)
    assert (settings.name, settings.rig.daqmx.holdoff_s) == ("Tank 3", answer["proposal"]["holdoff_s"])


def test_a_person_s_own_values_take_the_place_of_those_proposed(doubles, tmp_path, monkeypatch):
    wiring = ["", "", str(PULSE_S), "B", "", "", "", "", "strike", "continue", ""]
    # A holdoff beyond the fall is refused, and all prompts repeat.
    own = ["no", "10", "0.4", "", "", "0.5", "10", "0.4", "", "2e-4", "0.012"]
    monkeypatch.setattr("sys.stdin", io.StringIO("\n".join([*wiring, *own, "", "", ""]) + "\n"))
    file = tmp_path / "lab.toml"
    done = solimon_here("setup", str(file), "--no-web", env={})
    assert done.returncode == 0, done.stderr
    assert "holdoff_s is 0.5 s; it must be longer than" in done.stderr
    boards = load_settings(file).rig.daqmx
    assert boards is not None
    assert boards.transducers["B"].range_v == 10.0
    assert (boards.trigger_level_v, boards.holdoff_s, boards.pretrigger_samples) == (0.4, 0.012, 2000)
    assert boards.record_samples == 14_600, "as much after the trigger as ever"


def test_strikes_are_refused_in_the_folder_of_a_recorder(doubles, tmp_path):
    usual, other = tmp_path / "solimon-data", tmp_path / "other"
    for folder, options in ((usual, ()), (other, ("--data-dir", str(other)))):
        prepare_data_folder(folder)
        with hold_recorder_lock(folder):
            done = setup(tmp_path / "lab.toml", *WIRED, "--strike", *options)
        assert done.returncode == 5
        assert f"setup is refused: another recorder owns {folder}" in done.stderr
    assert doubles.control.record()["calls"] == [], "not one call reached the driver"
    assert not (tmp_path / "lab.toml").exists()


def test_strikes_stop_when_a_recorder_has_started_meanwhile(doubles, tmp_path):
    bench = find_boards(Dialogue(), tmp_path, "library", "")
    try:
        bench.wire("B", parse_wiring(bench.boards, "01E16086/ai0/ctr0"))
        prepare_data_folder(tmp_path)
        with (
            hold_recorder_lock(tmp_path),
            pytest.raises(BusyError, match="strike is refused: another recorder"),
        ):
            bench.strike("B")
        assert coil_pulses_s(doubles.control.record()) == []
        bench.strike("B")
    finally:
        bench.close()
    assert len(coil_pulses_s(doubles.control.record())) == 1
    assert doubles.control.record()["tasks"] == []


@pytest.mark.parametrize(
    ("wiring", "refusal"),
    [
        ("B=01E16086/ai0", "write BOARD/INPUT/COUNTER"),
        ("B=0BADC0DE/ai0/ctr0", "there is no board 0BADC0DE; there are: 01E16086, 00C16021"),
        ("B=00C16021/ai0/ctr0", "PCI-6221 00C16021 has no analog trigger"),
        ("B=01E16086/ai8/ctr0", "there is no ai8"),
        ("B=01E16086/ai0/ctr7", "there is no ctr7"),
        ("01E16086/ai0/ctr0", "name the position first"),
    ],
)
def test_a_wiring_that_is_not_there_is_refused(doubles, tmp_path, wiring, refusal):
    done = setup(tmp_path / "lab.toml", "--transducer", wiring)
    assert done.returncode == 2
    assert refusal in done.stderr


def test_a_board_reserved_by_another_process_is_reported(doubles, tmp_path):
    doubles.control.occupy("PXI1Slot3/ai", "LabVIEW")
    try:
        done = setup(tmp_path / "lab.toml", *WIRED, "--strike")
    finally:
        doubles.control.vacate("LabVIEW")
    assert done.returncode == 5
    assert "LabVIEW" in done.stderr


def test_a_missing_trigger_board_is_reported_with_the_search(tmp_path, monkeypatch):
    with running_brain(replace(QUICK, boards=(SLOW,), transducers={})) as slow:
        meet(slow, monkeypatch)
        done = setup(tmp_path / "lab.toml", *WIRED)
    assert done.returncode == 3
    assert "looked for NI-DAQmx boards with an analog trigger by library" in done.stderr
    assert "none of PCI-6221 00C16021 has one" in done.stderr
    assert "install-the-ni-driver.md" in done.stderr
