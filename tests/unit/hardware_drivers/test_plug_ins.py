"""Kinds of instruments are found by the metadata of installed packages; a refusal names who is to blame."""

import json
import subprocess
import sys
from importlib.metadata import version

import pytest
from support.offered_kinds import offer
from support.scripted_kinds import OFFERED, SCOPE

from hardware_drivers.errors import ConfigurationError
from hardware_drivers.kinds import Kind
from hardware_drivers.plug_ins import find_kind, find_offers

OURS = {
    "simulated": ("digitizer", "striker", "pulse_echo"),
    "daqmx": ("digitizer", "striker"),
    "niscope": ("pulse_echo",),
    "playback": ("digitizer", "striker", "pulse_echo"),
    "text-supply": ("supply",),
    "text-climate": ("climate",),
}


def test_built_in_kinds_are_found_by_the_same_entry_points():
    found = find_offers()
    assert {name: found[name].roles for name in OURS} == OURS
    assert {found[name].distributions for name in OURS} == {(f"solimon {version('solimon')}",)}
    assert all(isinstance(found[name].load(), Kind) for name in OURS)


def test_a_kind_of_another_package_is_found_without_installing_it(tmp_path, monkeypatch):
    offer(monkeypatch, tmp_path, OFFERED)
    kind, offered = find_kind("scripted-scope")
    assert kind is SCOPE
    assert (offered.roles, offered.distributions) == (("digitizer",), ("lab-drivers 1.2",))


def test_an_unknown_name_is_refused_with_those_that_are_there(tmp_path, monkeypatch):
    offer(monkeypatch, tmp_path, OFFERED)
    with pytest.raises(ConfigurationError) as refusal:
        find_kind("picoscope")
    text = str(refusal.value)
    assert text.startswith("no installed package offers the kind 'picoscope'; there are: daqmx, liar (lab-")
    assert "python -m pip install" in text


@pytest.mark.parametrize("error", ["OSError('libps5000.so: not found')", "SystemExit(0)"])
def test_a_package_that_does_not_import_is_named_with_its_error(error, tmp_path, monkeypatch):
    (tmp_path / "broken_scope.py").write_text(f"raise {error}\n", encoding="utf-8")
    offer(monkeypatch, tmp_path, {"scope": {"digitizer": "broken_scope:KIND"}})
    message = r"lab-drivers 1.2 offers broken_scope:KIND .*(OSError: libps5000.so: not found|SystemExit: 0)"
    with pytest.raises(ConfigurationError, match=message):
        find_kind("scope")
    assert find_kind("daqmx"), "it hinders no other"


def test_an_object_that_is_no_kind_is_refused(tmp_path, monkeypatch):
    offer(monkeypatch, tmp_path, {"word": {"striker": "support.scripted_kinds:NOT_A_KIND"}})
    with pytest.raises(ConfigurationError, match=r"lab-drivers 1.2 .*'word', which is a str, not a hardware"):
        find_kind("word")


def test_two_packages_with_one_name_are_both_named(tmp_path, monkeypatch):
    offer(monkeypatch, tmp_path / "one", OFFERED)
    offer(monkeypatch, tmp_path / "other", OFFERED, distribution="their-drivers")
    with pytest.raises(ConfigurationError, match=r"offered by lab-drivers 1.2 and by their-dr"):
        find_kind("liar")


def test_one_name_is_one_object(tmp_path, monkeypatch):
    two = {"digitizer": "support.scripted_kinds:SCOPE", "striker": "support.scripted_kinds:HAMMER"}
    offer(monkeypatch, tmp_path, {"both": two})
    with pytest.raises(ConfigurationError, match="different objects as 'both' for the roles digit"):
        find_kind("both")


PROGRAM = """
import json, sys
from hardware_drivers.plug_ins import find_offers
for offer in find_offers().values():
    offer.load()
print(json.dumps(sorted({name.partition('.')[0] for name in sys.modules})))
"""


def test_naming_every_kind_imports_nothing_of_a_vendor_and_no_compiler():
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True)
    heavy = {"nidaqmx", "niscope", "serial", "pyvisa", "nptdms", "grpc", "numba", "matplotlib", "scipy"}
    assert heavy.isdisjoint(json.loads(done.stdout))
