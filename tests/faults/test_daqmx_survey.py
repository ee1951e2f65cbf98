"""The survey of the boards by `solimon doctor`: every finding with its state, and no strike."""

from dataclasses import replace

import pytest
from support.daqmx_rig import (
    QUICK_TWIN,
    TRANSPORTS,
    board,
    functions_of,
    parameters_of,
    quick_description,
    reach,
)

from hardware_drivers.daqmx.survey import survey_rig
from simulator.doubles.chassis.description import SIMULTANEOUS_16_BIT, SLOW
from simulator.parameters.electronics import NoiseParameters

NOISE_V = 0.02
DESCRIPTION = replace(
    quick_description(board(), SLOW),
    twin=replace(QUICK_TWIN, noise=NoiseParameters(rms_v=NOISE_V, slow_rms_v=0.0)),
)
SERIAL = SIMULTANEOUS_16_BIT.serial_number


@pytest.fixture(params=TRANSPORTS)
def parameters(request, doubles, monkeypatch):
    reach(request.param, doubles, monkeypatch)
    yield parameters_of(DESCRIPTION, doubles, transport=request.param)
    doubles.control.clear_faults()
    record = doubles.control.record()
    assert record["tasks"] == []
    assert record["reservations"] == {}


def findings(found, state):
    return [finding for finding in found.findings if finding.state == state]


def finding_of(found, subject, check):
    (finding,) = (one for one in found.findings if (one.subject, one.check) == (subject, check))
    return finding


def test_a_sound_rig_is_ok_and_nothing_strikes(doubles, parameters):
    found = survey_rig(parameters)
    assert findings(found, "fail") == findings(found, "warn") == []
    assert found.driver_version == "24.8.0"
    (ours,) = (facts for facts in found.boards if facts.ours)
    assert (ours.serial, ours.product, ours.name) == (f"{SERIAL:08X}", "PXIe-6386", "PXI1Slot3")
    assert ours.max_rate_hz == pytest.approx(100e6 / 7)
    assert (-5.0, 5.0) in ours.ranges_v
    assert f"/{ours.name}/PFI12" in ours.terminals
    assert ours.calibration_temperature_c == ours.temperature_c == SIMULTANEOUS_16_BIT.temperature_c
    assert len(found.boards) == 2
    # 13,600 samples: the spread is known to 0.6 %, five times that is allowed.
    assert found.noise_rms_v == pytest.approx({"C": NOISE_V, "D": NOISE_V}, rel=0.03)
    noise = finding_of(found, "transducer C", "noise").values
    assert noise == {"noise_rms_v": found.noise_rms_v["C"], "trigger_level_v": parameters.trigger_level_v}
    assert finding_of(found, f"board {SERIAL:08X}", "calibrated").values["product"] == "PXIe-6386"
    assert finding_of(found, "transducer C", "trigger").detail == (
        "committed as asked, not started: 0.25 V rising at ai0, 1000 of 13600 samples before it"
    )
    record = doubles.control.record()
    assert record["lines"] == []
    # The two records of noise; no counter.
    assert functions_of(record).count("StartTask") == 2


def test_a_dry_run_is_surveyed_with_its_trigger(doubles, parameters):
    found = survey_rig(replace(parameters, dry_run=True))
    assert findings(found, "fail") == findings(found, "warn") == []
    assert "CfgAnlgEdgeRefTrig" in functions_of(doubles.control.record())


def test_an_unknown_temperature_is_not_compared(doubles, parameters):
    doubles.control.inject("DAQmxGetCalInfoAttribute:Cal.DevTemp", "error", code=-200077, times=0)
    found = survey_rig(parameters)
    finding = finding_of(found, f"board {SERIAL:08X}", "calibrated")
    assert (finding.state, finding.remedy) == ("ok", "")
    assert "does not report its temperature" in finding.detail


def test_noise_near_the_trigger_level_is_a_warning(parameters):
    found = survey_rig(replace(parameters, trigger_level_v=0.06))
    assert {(finding.subject, finding.check) for finding in findings(found, "warn")} == {
        ("transducer C", "noise"),
        ("transducer D", "noise"),
    }
    assert all("raise trigger_level_v" in finding.remedy for finding in findings(found, "warn"))


@pytest.mark.parametrize(
    ("changes", "check", "message"),
    [
        ({"board_serial": f"{SLOW.serial_number:08X}", "striker_serial": f"{SERIAL:08X}"},
         "board can do it", "at most 250000 Hz"),
        ({"input": "ai9"}, "trigger", "ai9"),
        ({"output_terminal": "PFI16"}, "coil's terminal", "does not exist"),
        ({"counter": "ctr7"}, "coil's counter", "ctr7"),
    ],
)  # fmt: skip
def test_wrong_wiring_fails_at_its_channel_and_the_rest_is_checked(parameters, changes, check, message):
    wrong = replace(parameters.transducers["C"], **changes)
    found = survey_rig(replace(parameters, transducers={"C": wrong, "D": parameters.transducers["D"]}))
    failed = findings(found, "fail")
    assert {finding.subject for finding in failed} == {"transducer C"}
    (finding,) = (finding for finding in failed if finding.check == check)
    assert message in finding.detail
    assert all(finding.remedy for finding in failed)
    assert "D" in found.noise_rms_v


def test_a_missing_board_is_reported_with_a_remedy(doubles, parameters):
    doubles.control.unplug(SERIAL)
    try:
        found = survey_rig(parameters)
    finally:
        doubles.control.plug(SERIAL, SIMULTANEOUS_16_BIT.name)
    (finding,) = findings(found, "fail")
    assert finding.subject == f"board {SERIAL:08X}"
    assert "power" in finding.remedy


def test_a_board_in_use_names_its_owner(doubles, parameters):
    doubles.control.occupy(f"{SERIAL}/ai", "LabVIEW on BENCH-7")
    try:
        found = survey_rig(parameters)
    finally:
        doubles.control.vacate("LabVIEW on BENCH-7")
    texts = [f"{finding.detail}; {finding.remedy}" for finding in findings(found, "fail")]
    assert len(texts) == 4  # trigger and input of both transducers
    assert all("owner: " in text and "LabVIEW on BENCH-7" in text for text in texts)
