"""State of the recorder on each surface, also after a reboot and with a torn heartbeat."""

import json
import os
import sys
import time
from dataclasses import asdict

import pytest
from support.invented_rows import set_row
from support.new_experiment import add_events, new_catalogue

from daq_service.catalogue import SetCommit
from daq_service.cli.status.facts import describe_status
from daq_service.clock import boot_name
from daq_service.commands.send import send_command
from daq_service.errors import BusyError
from daq_service.processes.data_folder import hold_recorder_lock
from daq_service.processes.heartbeat import FILE_NAME, Beat, encode_heartbeat
from daq_service.processes.recorder_state import determine_recorder_state, read_recorder_state
from daq_service.settings.tree import Settings
from daq_service.web.context import Context
from daq_service.web.routes.health import get_health
from hardware_drivers.nanoseconds import NS_PER_S

BOOT, NOW_NS = "this boot", 1000 * NS_PER_S


def beat(age_s, *, boot=BOOT, stage=""):
    mono_ns = NOW_NS - round(age_s * NS_PER_S)
    return Beat(process=1, mono_ns=mono_ns, deadline_s=65.0, doing="waiting", boot=boot, stage=stage)


REBOOTED = "not running: this computer was started again since it was last seen waiting"


GONE = "not running: it left without a word, and its heartbeat cannot be read"


LATE = "last sign of life 66 s ago while waiting"


@pytest.mark.parametrize(
    ("owned", "found", "word", "description"),
    [
        # The lock shows whether a recorder runs, the heartbeat whether it makes progress.
        (True, beat(65.0), "running", "running, waiting"),
        (True, beat(66.0), "not_responding", f"not answering: {LATE}"),
        (True, None, "running", "running; no heartbeat of it can be read yet"),
        (True, beat(1.0, boot="another boot"), "running", "running, starting"),
        (False, beat(1.0), "not_responding", "not running: last sign of life 1 s ago while waiting"),
        (False, beat(66.0), "not_responding", f"not running: {LATE}"),
        (False, beat(1.0, boot="another boot"), "not_responding", REBOOTED),
        # The owner of the lock is unknown: the heartbeat decides.
        (None, beat(65.0), "running", "running, waiting"),
        (None, beat(66.0), "not_responding", f"not running: {LATE}"),
        (None, beat(1.0, boot="another boot"), "not_responding", REBOOTED),
        (None, beat(-1.0, boot="another boot"), "not_responding", REBOOTED),
        # An older version, or a system without boot names: only a time in the future shows it.
        (None, beat(1.0, boot=None), "running", "running, waiting"),
        (None, beat(-1.0, boot=None), "not_responding", REBOOTED),
    ],
)
@pytest.mark.parametrize(
    "kinds", [[], ["recorder_started", "set_done"], ["recorder_stopped", "recorder_started"]]
)
def test_a_recorder_state_follows_from_lock_and_heartbeat(owned, found, word, description, kinds):
    state = determine_recorder_state(found, kinds, owned=owned, boot=BOOT, mono_ns=NOW_NS)
    assert (state.status, state.description) == (word, description)
    assert state.listens == (word == "running")
    assert state.beat is found


@pytest.mark.parametrize("owned", [False, None])
@pytest.mark.parametrize(
    ("kinds", "word", "description"),
    [
        ([], "not_started", "never started here"),
        (["recorder_started"], "not_responding", GONE),
        (["recorder_stopped", "recorder_started", "set_done"], "not_responding", GONE),
    ],
)
def test_without_a_heartbeat_the_state_follows_from_the_catalogue(owned, kinds, word, description):
    state = determine_recorder_state(None, kinds, owned=owned, boot=BOOT, mono_ns=NOW_NS)
    assert (state.status, state.description, state.listens) == (word, description, False)


@pytest.mark.parametrize("farewell", ["schedule_done", "recorder_stopped", "recorder_left_alone"])
def test_a_recorder_that_starts_after_an_orderly_end_is_running(farewell):
    """The lock shows that a recorder runs, and a running one has not stopped: it waits for its rig."""

    def state(found):
        result = determine_recorder_state(found, [farewell], owned=True, boot=BOOT, mono_ns=NOW_NS)
        return result.status, result.description, result.listens

    assert state(beat(1.0, stage="opening")) == ("running", "running, waiting", False)
    assert state(beat(1.0)) == ("running", "running, waiting", True)
    assert state(None) == ("running", "running; no heartbeat of it can be read yet", True)
    # The last beat of an earlier boot is not of the recorder that has the lock now.
    after = state(beat(1.0, stage="ended", boot="another boot"))
    assert after == ("running", "running, starting", True)


@pytest.mark.parametrize(
    ("kinds", "word", "listens"),
    [
        (["recorder_started", "set_done", "schedule_done"], "finished", True),
        (["schedule_done", "alarm_acknowledged", "pause"], "finished", True),
        (["recorder_started", "recorder_stopped"], "stopped", False),
        (["recorder_started", "recorder_left_alone"], "stopped", False),
    ],
)
def test_an_ended_recorder_reports_its_end_and_may_accept_commands(kinds, word, listens):
    last_beat = beat(1.0, stage="ended")
    state = determine_recorder_state(last_beat, kinds, owned=True, boot=BOOT, mono_ns=NOW_NS)
    assert (state.status, state.listens) == (word, listens)
    assert state.description.startswith(word)
    assert ("its supervisor was gone" in state.description) == (kinds[-1] == "recorder_left_alone")
    late = determine_recorder_state(beat(66.0, stage="ended"), kinds, owned=True, boot=BOOT, mono_ns=NOW_NS)
    gone = determine_recorder_state(last_beat, kinds, owned=False, boot=BOOT, mono_ns=NOW_NS)
    assert [(item.status, item.listens) for item in (late, gone)] == [(word, False)] * 2


def test_the_age_of_a_beat_is_known_only_within_its_boot():
    def age(found):
        return determine_recorder_state(found, [], owned=True, boot=BOOT, mono_ns=NOW_NS).beat_age_s

    assert age(beat(3.0)) == 3.0
    assert age(beat(3.0, boot="another boot")) is None


@pytest.fixture
def folder(tmp_path):
    with new_catalogue(tmp_path) as catalogue:
        add_events(catalogue, "recorder_started")
        stored_set(catalogue)
        yield tmp_path


def stored_set(catalogue):
    """Store a gap: before the first row the web has no data."""
    gap = set_row(state="missed", reason="why")
    catalogue.commit_set(SetCommit(sets=[gap]))


def as_text(found):
    return json.dumps(asdict(found))


def after_a_reboot():
    """Return a beat of the future: this boot is younger than the one before was."""
    return as_text(Beat(process=1, mono_ns=2**62, deadline_s=65.0, doing="waiting", boot="another boot"))


def after_a_reboot_of_an_older_version():
    fields = asdict(Beat(process=1, mono_ns=2**62, deadline_s=65.0, doing="waiting"))
    return json.dumps({name: value for name, value in fields.items() if name != "boot"})


def after_a_short_boot():
    """Return a beat of the past of this boot."""
    now_ns = time.monotonic_ns()
    return as_text(Beat(process=1, mono_ns=now_ns, deadline_s=65.0, doing="waiting", boot="another boot"))


def empty():
    return ""


def torn():
    return after_a_reboot()[:30]


def foreign():
    return '["no", "heartbeat"]'


@pytest.mark.parametrize(
    "last_beat",
    [after_a_reboot, after_a_reboot_of_an_older_version, after_a_short_boot, empty, torn, foreign],
)
def test_status_commands_and_web_agree_that_no_recorder_runs(folder, last_beat):
    if last_beat is after_a_short_boot and boot_name() is None:
        pytest.skip("this system names no boot")
    (folder / FILE_NAME).write_text(last_beat(), encoding="utf-8")
    assert describe_status(folder, Settings())["recorder"] in (REBOOTED, GONE)
    for kind in ("pause", "supply_off"):
        with pytest.raises(BusyError, match="no recorder runs"):
            send_command(
                kind, config=None, data_dir=folder, note="hands in the rig", author="ann", as_json=False
            )
    context = Context(Settings(), folder)
    health = json.loads(bytes(get_health(context).body))
    context.catalogue_access.close()
    assert health["recorder"]["state"] == health["as_of"]["recorder"]
    assert health["recorder"]["state"] == "not_responding"
    assert health["recorder"]["description"] in (REBOOTED, GONE)
    assert health["recorder"]["beat_age_s"] is None


def test_a_new_recorder_is_distinguished_from_the_stopped_one(folder):
    kinds = ["recorder_stopped"]
    now_ns = time.monotonic_ns()

    def look(process):
        last = Beat(
            process=process, mono_ns=now_ns, deadline_s=1e6, doing="leaving", boot=boot_name(), stage="ended"
        )
        (folder / FILE_NAME).write_bytes(encode_heartbeat(last))
        state = read_recorder_state(folder, kinds)
        return state.status, state.description

    with hold_recorder_lock(folder):
        assert look(os.getpid())[0] == "stopped"
        assert look(os.getpid() + 1) == ("running", "running; no heartbeat of it can be read yet")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows renames no folder in which files are open")
def test_the_recorder_of_a_moved_folder_is_silent(folder):
    context = Context(Settings(), folder)
    context.catalogue()
    folder.rename(folder.with_name("elsewhere"))
    health = json.loads(bytes(get_health(context).body))["recorder"]
    context.catalogue_access.close()
    assert health["state"] == "not_responding"
    assert f"{folder} is missing" in health["description"]
    assert "keeps what it takes in memory" in health["description"]
    assert read_recorder_state(folder, []).status == "not_started", (
        "of a test that has not begun there is no folder"
    )
