"""A folder of an earlier version continues: its configuration hash has not changed."""

import pytest

from daq_service.settings.commented import uncomment_tables
from daq_service.settings.file import PLACEHOLDER, find_config_file, load_settings
from daq_service.settings.tree import Settings

BOARDS = {"transducers": {"B": {"board_serial": "01A2B3C4"}}}
OVER_GRPC = {**BOARDS, "transport": "grpc", "grpc_address": "chassis.lab:31763"}
WATCHED = {**BOARDS, "watchdog": {"board_serial": "01A2B3C4", "lines": ["port2/line4"]}}
LINE = {"line": {"port": "COM4"}, "identity": "MAKER,MODEL"}
ONE = {"positions": {"B": {"method": "solitary_wave"}}, "clock": {"kind": "wall"}}
BOTH = {**ONE, "positions": {"B": {"method": "solitary_wave"}, "A": {"method": "pulse_echo"}}}


BY_SETS = {"alarms": {"decides_by": "k_of_n"}}
"""As alarms were raised by the versions that hashed these."""


def shipped(folder, *, everything):
    text = find_config_file("laboratory.toml").read_text(encoding="utf-8")
    text = text.replace(f'name = "{PLACEHOLDER}"', f'name = "{Settings().name}"').replace(
        PLACEHOLDER, "FFFFFFFF"
    )
    path = folder / "laboratory.toml"
    path.write_text(uncomment_tables(text) if everything else text, encoding="utf-8")
    return load_settings(path, overrides=BY_SETS)


WITH_PROBE = {"kind": "daqmx", "daqmx": BOARDS, "niscope": {"probes": {"A": {"resource": "PXI1Slot4"}}}}
TDMS = {"source": "old", "format": "tdms", "tdms": {}}
RIGS = {
    "4c5c6748c413e20d": {"rig": {"kind": "simulated"}},
    "8e483ee2bff44c8d": {**ONE, "rig": {"kind": "daqmx", "daqmx": BOARDS}},
    "36abfddee2a9ed45": {**ONE, "rig": {"kind": "daqmx", "daqmx": OVER_GRPC}},
    "07b77226c64cff3a": {**ONE, "rig": {"kind": "daqmx", "daqmx": WATCHED}},
    "d838a2cb8897e3dc": {**BOTH, "rig": WITH_PROBE},
    "04c6db5c7afc691f": {"rig": {"supply": LINE, "climate": LINE}},
    "23d724a4dae73254": {"rig": {"kind": "playback", "playback": {"source": "old-test"}}},
    "cec61bcf2c99735d": {"rig": {"kind": "playback", "playback": TDMS}},
}
"""By the beginning of what 0dad455 hashed, before kinds of instruments were found by their entry points."""


@pytest.mark.parametrize("digest", RIGS)
def test_a_rig_of_each_kind_keeps_its_hash(digest):
    assert Settings(**RIGS[digest], **BY_SETS).configuration_hash().startswith(digest)


@pytest.mark.parametrize(("everything", "digest"), [(False, "f6969c269925c427"), (True, "33565d5ea9f1ef4f")])
def test_the_shipped_laboratory_keeps_its_hash(everything, digest, tmp_path):
    assert shipped(tmp_path, everything=everything).configuration_hash().startswith(digest)


def test_the_shipped_twin_keeps_its_hash():
    assert load_settings(None, overrides=BY_SETS).configuration_hash().startswith("4c5c6748c413e20d")


def test_given_windows_are_part_of_the_hash():
    place = {"method": "solitary_wave"}
    plain, given = (
        Settings(positions={"B": {**place, "waves": waves}}) for waves in ({}, {"psw_latest_s": 1e-3})
    )
    assert plain.configuration_hash() == Settings(positions={"B": place}).configuration_hash()
    assert given.configuration_hash() != plain.configuration_hash()


def test_alarm_settings_are_part_of_the_hash():
    assert Settings().configuration_hash() != Settings(**BY_SETS).configuration_hash()


def test_a_new_calibration_continues_a_folder_and_a_minimum_wall_begins_another_one():
    def hash_of(**probe):
        positions = {"A": {"method": "pulse_echo", **probe}}
        return Settings(positions=positions).configuration_hash()

    calibration = {"certificate": "7", "calibrated_on": "2026-01-15", "due_on": "2027-01-15"}
    assert hash_of(calibration=calibration) == hash_of(minimum_wall_m=None) == hash_of()
    assert hash_of(minimum_wall_m=5e-3) != hash_of()
