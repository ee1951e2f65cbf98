"""Checks of supply, climate probe and ultrasonic probe by `solimon doctor`, which switches nothing."""

from dataclasses import replace

import pytest
from support.niscope_rig import description, met_brain, needs_niscope, parameters
from support.serial_rig import NO_TERMINALS, SerialRig

from daq_service.cli.doctor.check import build_finding_check, choose_exit_code
from daq_service.clock import WallClock
from hardware_drivers.kinds import Opening
from hardware_drivers.niscope.kind import KIND as NISCOPE
from hardware_drivers.niscope.parameters import ProbeWiring
from hardware_drivers.serial_port.kinds import CLIMATE, SUPPLY

on_terminals = pytest.mark.skipif(bool(NO_TERMINALS), reason=NO_TERMINALS or "there are pseudo terminals")


def run_checks(kind, parameters):
    return [build_finding_check(finding) for finding in kind.check(parameters, Opening(clock=WallClock()))]


def by_name(checks):
    return {check.name: check for check in checks}


@pytest.fixture
def rig(tmp_path):
    with SerialRig(tmp_path) as rig:
        yield rig


@on_terminals
def test_a_supply_is_queried_and_never_switched(rig):
    checks = by_name(run_checks(SUPPLY, rig.supply_parameters))
    assert {check.state for check in checks.values()} == {"ok"}
    assert "DC SUPPLY DOUBLE" in checks["supply: identity"].found
    assert checks["supply: read-back"].found.endswith("output off")
    assert checks["supply: output"].values["output_on"] is False
    assert rig.switched() == []
    assert not any(command.startswith(("OUTP ", "VOLT ", "CURR ")) for command in rig.heard())


@on_terminals
def test_a_supply_that_is_on_without_a_recorder_causes_a_warning(rig):
    rig.instruments.supply_link.do(lambda: rig.instruments.supply.press_output_key(True))
    checks = by_name(run_checks(SUPPLY, rig.supply_parameters))
    assert checks["supply: output"].state == "warn"
    assert checks["supply: output"].found.startswith("ON: ")
    assert [on for on, _ in rig.switched()] == [True], "the doctor left it as it was"


@on_terminals
def test_a_tripped_protection_fails(rig):
    rig.instruments.supply_link.do(lambda: rig.instruments.supply.trip("CURR"))
    checks = by_name(run_checks(SUPPLY, rig.supply_parameters))
    assert checks["supply: read-back"].state == "fail"
    assert "CURR:PROT:TRIP?" in checks["supply: read-back"].found


@on_terminals
def test_another_instrument_on_the_line_fails_after_one_query(rig):
    checks = run_checks(SUPPLY, replace(rig.supply_parameters, identity="KEYSIGHT,E36312A"))
    assert [(check.name, check.state) for check in checks] == [("supply: identity", "fail")]
    assert choose_exit_code(checks) == 3
    assert set(rig.heard()) == {"*IDN?"}


@on_terminals
def test_the_climate_is_read(rig):
    checks = by_name(run_checks(CLIMATE, rig.climate_parameters))
    assert "CLIMATE PROBE DOUBLE" in checks["climate probe: identity"].found
    reading = checks["climate probe: reading"].values
    assert rig.climate.read(2.0).temperature_c == pytest.approx(float(str(reading["temperature_c"])), abs=0.1)
    rig.instruments.climate_link.unplug()
    (gone,) = run_checks(CLIMATE, rig.climate_parameters)
    assert (gone.state, gone.remedy != "") == ("fail", True)


@needs_niscope
def test_a_probe_board_is_named_and_its_record_checked():
    with met_brain(description()):
        checks = by_name(run_checks(NISCOPE, parameters()))
    assert {check.state for check in checks.values()} == {"ok"}
    assert "at PXI1Slot5, channel 0" in checks["probe A: board"].found
    assert "2048 samples at 100 MS/s, mean of 16" in checks["probe A: record"].found
    # The double's echo of a half-volt back wall in a range of one volt.
    assert 0.3 < float(str(checks["probe A: record"].values["peak_v"])) < 0.7
    assert checks["probe A: self-calibration"].values["calibration_date"]


@needs_niscope
def test_an_echo_above_its_range_causes_a_warning():
    with met_brain(description()):
        checks = by_name(run_checks(NISCOPE, parameters(range_v=0.2)))
    assert checks["probe A: record"].state == "warn"
    assert checks["probe A: record"].values["clipped"] is True


@needs_niscope
def test_a_missing_board_hides_no_other():
    both = replace(
        parameters(), probes={"X": ProbeWiring(resource="PXI1Slot9"), "A": parameters().probes["A"]}
    )
    with met_brain(description()):
        checks = by_name(run_checks(NISCOPE, both))
    assert checks["probe X: board"].state == "fail"
    assert checks["probe A: record"].state == "ok"


@on_terminals
def test_a_protection_that_cannot_be_queried_causes_a_warning(tmp_path):
    with SerialRig(tmp_path, dialect="korad", way="tcp") as rig:
        checks = by_name(run_checks(SUPPLY, rig.supply_parameters))
    assert checks["supply: identity"].found.startswith("KORAD, KA3005P")
    assert checks["supply: read-back"].state == "warn"
    assert "dialect korad asks no protection" in checks["supply: read-back"].found
    assert checks["supply: read-back"].values["tripped"] == ""


@on_terminals
def test_a_refused_connection_is_distinguished_from_a_silent_instrument(tmp_path):
    with SerialRig(tmp_path, way="tcp", line={"reply_timeout_s": 0.1}) as rig:
        rig.instruments.supply_link.inject(silent=True)
        (silent,) = run_checks(SUPPLY, rig.supply_parameters)
        rig.instruments.supply_link.unplug()
        (absent,) = run_checks(SUPPLY, rig.supply_parameters)
    assert (silent.state, absent.state) == ("fail", "fail")
    assert "does not answer *IDN? within 0.1 s" in silent.found
    assert "takes no connection" in absent.found
