"""`solimon setup --kind`: instruments of any installed kind, up to a valid file."""

import json
import re

import pytest
from click.testing import CliRunner
from support.offered_kinds import offer
from support.scripted_kinds import OFFERED, begin_script

from daq_service.cli.main import cli
from daq_service.cli.set_up.dialogue import Dialogue
from daq_service.cli.set_up.kinds import build_named_kinds
from daq_service.cli.set_up.transducers import Flags, set_up_transducers
from daq_service.errors import BusyError, RigError, UsageError
from daq_service.processes.data_folder import hold_recorder_lock, prepare_data_folder
from daq_service.settings.file import load_settings
from daq_service.settings.instruments import list_instruments

SCOPE_AND_HAMMER = ("--kind", "scripted-scope", "--kind", "scripted-hammer")
AT_B = ("--transducer", "B=scripted-scope/scripted-hammer")
NO_OTHERS = "-\n-\n"
"""Neither supply nor climate probe."""


@pytest.fixture
def script(monkeypatch, tmp_path):
    offer(monkeypatch, tmp_path / "site", OFFERED)
    return begin_script()


@pytest.fixture
def file(script, tmp_path):
    return tmp_path / "laboratory.toml"


def set_up(file, *flags, answers=""):
    return CliRunner().invoke(
        cli, ["setup", str(file), *flags, "--no-web"], input=answers, catch_exceptions=False
    )


def instruments(file):
    return {item.name: item.parameters for item in list_instruments(load_settings(file))}


def test_the_dialogue_writes_a_complete_file(file, script):
    answers = (
        "\nB\nscripted-scope.range_v=200\nscripted-scope.range_v=5\n-\nstrike\n-\ncontinue\n-\n" + NO_OTHERS
    )
    ended = set_up(file, *SCOPE_AND_HAMMER, answers=answers)
    assert ended.exit_code == 0, ended.output
    assert "range_v: Input should be less than or equal to 50 (value: 200)" in ended.output
    assert "front panel: lamp: it is dark; switch on" in ended.output, "its own checks are told"
    assert script.events.count("strike B") == 1
    assert "strike B now" in ended.output, "a person is asked to"
    assert "record: good, flags: none; incident wave 5 V (50% of the range)" in ended.output
    assert "From strikes of B." in file.read_text(encoding="utf-8")
    assert load_settings(file).name == "laboratory", "the file's, without an answer"
    assert instruments(file)["scripted-scope"].range_v == 5.0
    assert 'address = "usb"' in file.read_text(encoding="utf-8"), "the defaults are there to be seen"


def test_an_unsuitable_trigger_level_is_proposed_again(file):
    answers = "\nB\n-\nstrike\nyes\n-\ncontinue\n-\n" + NO_OTHERS
    ended = set_up(file, "--kind", "scripted-levelled", "--kind", "scripted-hammer", answers=answers)
    assert ended.exit_code == 0, ended.output
    assert "take   scripted-levelled.trigger_level_v 0.5 V, a tenth of the incident wave" in ended.output
    assert instruments(file)["scripted-levelled"].trigger_level_v == 0.5


def test_options_answer_every_question_and_strike_only_with_strike(file, script):
    given = (*SCOPE_AND_HAMMER, *AT_B, "--set", "scripted-scope.range_v=2.5", "--name", "Tank 3", "--json")
    ended = set_up(file, *given)
    assert ended.exit_code == 0, ended.output
    assert "strike B" not in script.events
    assert "Nothing was struck" in file.read_text(encoding="utf-8")
    assert json.loads(ended.stdout)["transducers"] == {
        "B": {"digitizer": "scripted-scope", "striker": "scripted-hammer"}
    }
    assert instruments(file)["scripted-scope"].range_v == 2.5
    assert load_settings(file).name == "Tank 3"
    file.unlink()
    ended = set_up(file, *given, "--strike")
    (struck,) = json.loads(ended.stdout)["struck"]
    assert struck["features"]["quality"] == "good"
    assert script.events.count("strike B") == 1


def test_a_strike_without_a_record_writes_nothing(file, script, tmp_path):
    script.comes = False
    dialogue = Dialogue()
    kinds = build_named_kinds(dialogue, ["scripted-scope", "scripted-hammer"], [], file, tmp_path / "data")
    flags = Flags(transducers={"B": "scripted-scope/scripted-hammer"}, strike=True)
    with pytest.raises(RigError, match="B gave no record"):
        set_up_transducers(dialogue, kinds, flags)
    assert any("no record (" in line and "nothing came at B" in line for line in dialogue.lines)
    assert not file.exists()


def test_no_strike_is_made_while_a_recorder_owns_the_folder(file, script, tmp_path):
    folder = tmp_path / "data"
    kinds = build_named_kinds(Dialogue(), ["scripted-scope", "scripted-hammer"], [], file, folder)
    kinds.wire("B", "scripted-scope/scripted-hammer")
    prepare_data_folder(folder)
    with hold_recorder_lock(folder), pytest.raises(BusyError, match="a strike is refused: "):
        kinds.strike("B")
    assert "strike B" not in script.events


def test_the_page_is_shown_the_newest_record_and_its_waves(file, tmp_path):
    kinds = build_named_kinds(
        Dialogue(), ["scripted-levelled", "scripted-hammer"], [], file, tmp_path / "data"
    )
    kinds.wire("B", "scripted-levelled/scripted-hammer")
    assert kinds.newest() == {"strike": None, "shot": None}
    kinds.strike_each(["B"])
    newest = kinds.newest()
    assert kinds.watch() == ("B", None)
    assert newest["level_v"] == 0.05
    assert max(newest["shot"]["highest_v"]) == kinds.trials["B"].record.volts().max()
    assert [mark["name"] for mark in newest["marks"]] == ["ISW", "PSW"]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (("--kind", "oscilloscope"), "no installed package offers the kind 'oscilloscope'"),
        (("--kind", "scripted-supply"), "scripted-supply neither digitizes nor strikes here"),
        (("--kind", "scripted-scope"), "none of scripted-scope is a striker; add one that is: "),
        ((*SCOPE_AND_HAMMER, "--set", "range_v"), "'range_v' is not INSTRUMENT.KEY=VALUE"),
        ((*SCOPE_AND_HAMMER, "--set", "scope.range_v=1"), "there is no scope; there are: scripted-scope"),
        ((*SCOPE_AND_HAMMER, "--set", "scripted-scope.rnage_v=1"), "scripted-scope has no rnage_v; it has"),
        ((*SCOPE_AND_HAMMER, "--transducer", "B=nobody/scripted-hammer"), "nobody"),
        (("--set", "scripted-scope.range_v=1", *AT_B), "--set is for --kind"),
    ],
)
def test_an_impossible_setup_is_rejected_before_any_instrument_is_opened(file, script, given, message):
    with pytest.raises(UsageError, match=re.escape(message)):
        set_up(file, *given)
    assert script.events == []
    assert not file.exists()
