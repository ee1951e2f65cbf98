"""Parameters of serial instruments refuse what could never work, or could do harm."""

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from daq_service.settings.file import load_settings
from hardware_drivers.errors import ConfigurationError
from hardware_drivers.serial_port.parameters import ClimateParameters, SerialLineParameters, SupplyParameters
from hardware_drivers.serial_port.port import open_port

LINE = SerialLineParameters(port="/dev/serial/by-id/usb-FTDI")
SUPPLY = SupplyParameters(line=LINE, identity="MAKER,MODEL")
CLIMATE = ClimateParameters(line=LINE, identity="MAKER,PROBE")
PAGE = Path(__file__).parents[3] / "docs/how-to/supply-and-climate.md"


@pytest.mark.parametrize("port", ["", "serial:", " COM4", "COM4\n", "\x00"])
def test_a_port_without_a_name_is_refused(port):
    with pytest.raises(ValueError, match="give a path, a name like COM4, or serial:"):
        replace(LINE, port=port)


@pytest.mark.parametrize(
    ("parameters", "changes", "complaint"),
    [
        (LINE, {"reconnect_first_s": 90.0}, "reconnect_longest_s is 60.0 s"),
        (LINE, {"reply_timeout_s": 0.0}, "reply_timeout_s is 0.0"),
        (LINE, {"port": "tcp:psu.lab"}, "give tcp:HOST:PORT"),
        (LINE, {"port": "tcp:psu.lab:70000"}, "give tcp:HOST:PORT"),
        (LINE, {"port": "visa:"}, "give visa: and a resource"),
        (SUPPLY, {"channel": 2}, "give INST:NSEL 2"),
        (SUPPLY, {"over_voltage_v": 9.0}, "must be above voltage_v (10.0)"),
        (SUPPLY, {"dialect": "korad", "over_voltage_v": 12.0}, "dialect korad cannot set and read back"),
        (SUPPLY, {"voltage_v": 12.5}, "at most voltage_cap_v (12.0)"),
        (SUPPLY, {"current_limit_a": 2.5}, "at most current_cap_a (2.0)"),
        (SUPPLY, {"voltage_cap_v": 61.0}, "voltage_cap_v is 61.0; it must be at most 60"),
        (SUPPLY, {"identity": ""}, "any instrument matches"),
        (SUPPLY, {"identity": ".*"}, "any instrument matches"),
        (SUPPLY, {"identity": "("}, "no regular expression"),
        (SUPPLY, {"protection_queries": ("VOLT:PROT:TRIP?;:OUTP ON",)}, "give one command"),
        (SUPPLY, {"setup_commands": ("OUTP ON",)}, "only SYST, INST and DISP"),
        (SUPPLY, {"setup_commands": ("*RST",)}, "only SYST, INST and DISP"),
        (SUPPLY, {"setup_commands": ("VOLT 10",)}, "only SYST, INST and DISP"),
        (SUPPLY, {"setup_commands": ("SYST:REM;:OUTP ON",)}, "give one command"),
        (SUPPLY, {"setup_commands": ("SYST:REM\nOUTP ON",)}, "give one command"),
        (CLIMATE, {"identity": "x?"}, "any instrument matches"),
        (CLIMATE, {"temperature_query": ""}, "temperature_query is ''"),
        (CLIMATE, {"humidity_query": "MEAS:HÜM?"}, "printable ASCII"),
        (CLIMATE, {"log_interval_s": float("nan")}, "finite"),
    ],
)
def test_settings_that_cannot_work_are_refused_with_their_value(parameters, changes, complaint):
    with pytest.raises(ValueError, match=re.escape(complaint)):
        replace(parameters, **changes)


def test_setup_commands_of_supplies_are_accepted():
    commands = ("SYST:REM", ":INST:NSEL 1", "disp:text 'solimon'")
    assert replace(SUPPLY, setup_commands=commands).setup_commands == commands


def test_a_socket_has_a_host_and_a_port():
    assert replace(LINE, port="tcp:psu.lab:5025").address == ("psu.lab", 5025)
    assert replace(LINE, port="tcp:[fe80::1]:5025").address == ("fe80::1", 5025)


@pytest.mark.parametrize(
    "module", ["hardware_drivers.serial_port.parameters", "daq_service.corrosion_drive.drive"]
)
def test_settings_and_bookkeeping_need_no_serial_port(module):
    code = f"import sys, {module}; sys.exit('serial' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_the_tables_of_the_how_to_are_accepted(tmp_path):
    (text,) = re.findall(r"```toml\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    path = tmp_path / "wired.toml"
    path.write_text(text, encoding="utf-8")
    rig = load_settings(path).rig
    assert rig.supply is not None
    assert rig.supply.line.port == "serial:FT0ABC12"
    assert rig.climate is not None


@pytest.mark.parametrize("library", ["/absent/libvisa.so", "@nothing"])
def test_a_missing_visa_library_is_not_reported_as_a_cable_fault(monkeypatch, library):
    pytest.importorskip("pyvisa", reason='needs the extra "solimon[visa]"')
    monkeypatch.setenv("PYVISA_LIBRARY", library)
    with pytest.raises(ConfigurationError, match="correct the variable PYVISA_LIBRARY"):
        open_port(replace(LINE, port="visa:TCPIP::psu.lab::5025::SOCKET"))
