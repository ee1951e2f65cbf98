"""Wiring that cannot work is refused while the file is read, with value, limit and remedy."""

import subprocess
import sys
from dataclasses import replace

import pytest
from pydantic import TypeAdapter, ValidationError

from hardware_drivers.daqmx.coil import CAP_S
from hardware_drivers.daqmx.parameters import (
    LONGEST_PULSE_S,
    DaqmxParameters,
    TransducerWiring,
    WatchdogWiring,
)

B = TransducerWiring(board_serial="01A2B3C4")
C = TransducerWiring(board_serial="01A2B3C4", input="ai1", counter="ctr1", output_terminal="PFI13")


def parameters(**changes):
    return DaqmxParameters(**{"transducers": {"B": B, "C": C}, **changes})


def test_importing_the_package_loads_no_driver():
    code = (
        "import sys, hardware_drivers.daqmx, hardware_drivers.daqmx.parameters\n"
        "heavy = {'nidaqmx', 'grpc', 'numpy'} & set(sys.modules)\n"
        "raise SystemExit(', '.join(sorted(heavy)) or 0)"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (0, "")


@pytest.mark.parametrize("pulse_s", [LONGEST_PULSE_S * 1.001, 0.0, -1.0, float("nan"), float("inf")])
def test_a_pulse_beyond_the_cap_is_refused(pulse_s):
    with pytest.raises(ValueError, match="pulse_s"):
        parameters(pulse_s=pulse_s)


def test_the_two_caps_agree_and_are_two():
    assert parameters(pulse_s=LONGEST_PULSE_S).pulse_s == CAP_S


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"transducers": {}}, "wire at least one"),
        ({"pretrigger_samples": 13_600}, "less than record_samples"),
        ({"trigger_level_v": 5.0}, "inside the range"),
        ({"trigger_level_v": -5.0}, "inside the range"),
        ({"grpc_address": "chassis:31763"}, "transport = 'grpc'"),
        ({"transport": "grpc"}, "host:port"),
        ({"transport": "grpc", "grpc_address": "chassis"}, "host:port"),
        ({"grpc_client_name": "two words"}, "letters, digits"),
        ({"transducers": {"B": B, "C": replace(C, input="ai0")}}, "share ai0 of board 01A2B3C4"),
        ({"transducers": {"B": B, "C": replace(C, counter="ctr0")}}, "share ctr0"),
        ({"transducers": {"B": B, "C": replace(C, output_terminal="PFI12")}}, "share PFI12"),
        ({"transducers": {"B": B, "C": replace(C, board_serial="1a2b3c4", input="ai0")}}, "share ai0"),
        ({"watchdog": WatchdogWiring(board_serial="01A2B3C4", lines=("port2/line4",), timeout_s=0.2)}, "cut"),
        ({"watchdog": WatchdogWiring(board_serial="99", lines=("port2/line4",))}, "no coil"),
    ],
)
def test_settings_that_cannot_work_are_refused(change, complaint):
    with pytest.raises(ValueError, match=complaint):
        parameters(**change)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("board_serial", "Dev1"),
        ("board_serial", ""),
        ("striker_serial", "PXI1Slot2"),
        ("input", "Dev1/ai0"),
        ("counter", "ctr"),
        ("output_terminal", "/Dev1/PFI12"),
    ],
)
def test_wiring_names_no_device_and_no_nonsense(field, value):
    with pytest.raises(ValueError, match=field):
        replace(B, **{field: value})


@pytest.mark.parametrize("lines", [(), ("PFI12",)])
def test_a_watchdog_guards_digital_lines(lines):
    with pytest.raises(ValueError, match="lines"):
        WatchdogWiring(board_serial="1", lines=lines)


def test_coils_on_a_board_of_their_own_share_nothing_with_its_inputs():
    wired = parameters(transducers={"B": B, "C": replace(C, striker_serial="0F", counter="ctr0")})
    assert wired.transducers["C"].coil_serial == "0F"
    assert wired.transducers["B"].coil_serial == "01A2B3C4"


def test_times_of_a_strike():
    wired = parameters(sample_rate_hz=1e6, pretrigger_samples=500, record_samples=2000, pulse_s=0.05)
    # 5 mm at 9.81 m/s2.
    assert wired.fall_s == pytest.approx(0.031928, rel=1e-4)
    assert wired.initial_delay_s == 1e-3
    # Delay, pulse, fall, margin and the 2 ms record.
    assert wired.longest_strike_s == pytest.approx(1e-3 + 0.05 + 0.031928 + 0.1 + 2e-3, rel=1e-4)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"holdoff_s": 31.9e-3}, r"0\.0319 s; .* ringing_s = 0 s and shorter than 0\.03183 s"),
        ({"holdoff_s": 5e-3, "ringing_s": 5e-3}, r"0\.005 s; .* longer than ringing_s = 0\.005 s"),
        ({"holdoff_s": 20e-3, "drop_height_m": 1e-3}, r"shorter than 0\.01418 s, the fall from 0\.001 m"),
        (
            {"holdoff_s": 20e-3, "sample_rate_hz": 1e5, "record_samples": 4000, "pretrigger_samples": 2000},
            r"0\.02 s; .* shorter than 0\.01193 s",
        ),
        ({"ringing_s": 5e-3}, r"without a holdoff_s; set one between it and 0\.03183 s"),
        ({"ringing_s": 40e-3}, "flyback diode"),
        ({"holdoff_s": 0.0}, "holdoff_s is 0.0"),
        ({"holdoff_s": float("nan")}, "holdoff_s is nan"),
    ],
)
def test_a_holdoff_that_cannot_work_is_refused_with_both_numbers(change, complaint):
    with pytest.raises(ValueError, match=complaint):
        parameters(**change)


def test_a_whole_strike_goes_from_the_pulse_s_begin_to_the_record_s_end():
    wired = parameters(sample_rate_hz=1e6, pretrigger_samples=500, record_samples=2000, pulse_s=0.05)
    assert wired.whole_strike_samples == 50_000 + 31_928 + 100_000 + 2_000


def test_a_file_gives_the_same_and_is_held_to_the_same_bounds():
    adapter = TypeAdapter(DaqmxParameters)
    table = {"transducers": {"B": {"board_serial": "01A2B3C4"}, "C": {"board_serial": "7", "range_v": 2}}}
    read = adapter.validate_python(table)
    assert read.transducers["C"].range_v == 2.0
    assert adapter.validate_json(adapter.dump_json(read)) == read
    for wrong in (
        {**table, "pulse_s": 0.6},
        {**table, "puls_s": 0.1},
        {"transducers": {"B": {"board_serial": "01A2B3C4", "dev": "Dev1"}}},
    ):
        with pytest.raises(ValidationError):
            adapter.validate_python(wrong)
