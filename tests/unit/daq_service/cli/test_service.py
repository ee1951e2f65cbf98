"""`solimon service`: its files are checked with the system's own programs and the command line."""

import configparser
import json
import math
import shlex
import shutil
import socket
import subprocess
import sys
import threading
from contextlib import nullcontext
from pathlib import Path
from xml.etree import ElementTree

import pytest
from click.testing import CliRunner
from support.command_line import command_of, solimon_here
from support.notify_socket import notify_socket
from support.waiting import ended, until

from daq_service.cli.main import cli
from daq_service.cli.run import serve_app
from daq_service.errors import EXIT_INTERRUPTED, UsageError
from daq_service.processes.heartbeat import WEB_DEADLINE_S
from daq_service.recording.session import compute_longest_call_s
from daq_service.settings.file import load_settings
from daq_service.settings.web import WebSettings
from daq_service.web.app import create_app

SUPPLY = '[rig.supply]\nidentity = "MAKER"\n[rig.supply.line]\nport = "COM4"\n'
WITH_SUPPLY = 'name = "50 % \\"wall\\""\n[rig]\nstall_timeout_s = 180.0\n' + SUPPLY
TASKS = "{http://schemas.microsoft.com/windows/2004/02/mit/task}"


def write_service(config, manager, *options):
    arguments = [
        "service",
        manager,
        str(config),
        "--out",
        str(config.parent / "services"),
        "--json",
        *options,
    ]
    result = CliRunner().invoke(cli, arguments)
    assert result.exception is None, result.exception
    return json.loads(result.stdout)


@pytest.fixture
def config(tmp_path):
    """Return a configuration with a supply and special characters in each path."""
    folder = tmp_path / "my $HOME, 5 % 'and' \"more\""
    folder.mkdir()
    file = folder / "lab.toml"
    file.write_text(WITH_SUPPLY, encoding="utf-8")
    return file


def unit(path):
    parser = configparser.ConfigParser(interpolation=None)
    parser.optionxform = str  # type: ignore[assignment, method-assign]
    parser.read(path, encoding="utf-8")
    return parser


def units(config):
    files = write_service(config, "systemd", "--user", "ada")["files"]
    return {Path(file).stem.removeprefix("solimon-"): unit(file) for file in files}


def verify(*files):
    """Check a unit with systemd; return its messages."""
    if shutil.which("systemd-analyze") is None:
        pytest.skip("no systemd-analyze here: it comes with the package systemd")
    command = ["systemd-analyze", "verify", "--man=no", *files]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return (done.stdout + done.stderr).strip() or ("" if done.returncode == 0 else "refused without a word")


def test_systemd_verifies_the_units(config):
    assert verify(*write_service(config, "systemd", "--user", "root")["files"]) == ""


def test_a_watched_recorder_has_time_to_start_to_work_and_to_stop(config):
    recorder = units(config)["record"]["Service"]
    settings = load_settings(config)
    deadline_s = compute_longest_call_s(settings) + settings.rig.stall_timeout_s
    assert recorder["Type"] == "notify"
    assert int(recorder["WatchdogSec"]) == math.ceil(deadline_s)
    assert int(recorder["TimeoutStartSec"]) > deadline_s
    assert int(recorder["TimeoutStopSec"]) > deadline_s


def test_a_process_is_restarted_according_to_its_exit_code(config):
    for parsed in units(config).values():
        service = parsed["Service"]
        assert service["Restart"] == "always"
        assert service["RestartPreventExitStatus"] == str(UsageError.exit_code), "nothing mends it"
        assert service["SuccessExitStatus"] == str(EXIT_INTERRUPTED), "told to stop is no failure"
        assert parsed["Unit"]["StartLimitIntervalSec"] == "0"
        assert service["User"] == "ada"


def test_the_supply_s_process_is_a_service_of_its_own(config):
    """Otherwise it would end with the recorder, which it must outlive."""
    written_units = units(config)
    assert (
        written_units["record"]["Unit"]["Wants"]
        == written_units["record"]["Unit"]["After"]
        == "solimon-supply-process.service"
    )
    assert written_units["record"]["Service"]["KillMode"] == "mixed", "the recorder ends its own workers"
    assert written_units["supply-process"]["Service"]["Type"] == "notify"
    config.write_text("", encoding="utf-8")
    assert list(units(config)) == ["record", "serve"]


def test_only_the_processes_that_use_devices_may_open_them(config):
    written_units = units(config)
    assert written_units["serve"]["Service"]["WatchdogSec"] == f"{WEB_DEADLINE_S:.0f}"
    assert written_units["serve"]["Service"]["Type"] == "notify"
    assert [word for word, parsed in written_units.items() if "PrivateDevices" in parsed["Service"]] == [
        "serve"
    ]
    assert {parsed["Service"]["NoNewPrivileges"] for parsed in written_units.values()} == {"yes"}


@pytest.mark.parametrize("manager", ["systemd", "windows"])
def test_the_command_lines_are_valid_commands(manager, config):
    files = write_service(config, manager)["files"]
    if manager == "systemd":
        lines = [unit(file)["Service"]["ExecStart"].replace("%%", "%").replace("$$", "$") for file in files]
        commands = [shlex.split(line) for line in lines]
    else:
        actions = [ElementTree.parse(file).find(f".//{TASKS}Exec") for file in files]
        assert all(action is not None for action in actions)
        # Backslash quotes of Windows are valid in a shell, too.
        commands = [
            [action.findtext(f"{TASKS}Command"), *shlex.split(action.findtext(f"{TASKS}Arguments"))]
            for action in actions
        ]
    recorded_commands = []
    for program, safe, dash_m, module, word, *arguments in commands:
        assert (program, dash_m, module) == (sys.executable, "-m", "daq_service.cli")
        assert safe == "-P", "no file beside the configuration is taken for a module"
        options = command_of(word).make_context(word, arguments).params
        (named,) = options["paths"] if word == "serve" else [options["config"]]
        assert (named, options["data_dir"]) == (config, config.parent / "solimon-data")
        recorded_commands.append(word)
    assert recorded_commands == (
        ["record", "serve", "supply-process"] if manager == "systemd" else ["run", "supply-process"]
    )


def test_a_task_of_windows_starts_at_boot_and_again_and_runs_for_as_long_as_it_takes(config):
    answer = write_service(config, "windows", "--user", "LAB\\ada", "--name", "wall")
    assert [Path(file).name for file in answer["files"]] == ["wall.xml", "wall-supply-process.xml"]
    assert answer["install"][0] == f'schtasks /create /f /tn "wall" /xml "{answer["files"][0]}"'
    task = ElementTree.fromstring(Path(answer["files"][0]).read_bytes())
    found = {element.tag.removeprefix(TASKS): element.text for element in task.iter()}
    assert found["Description"] == 'solimon run: 50 % "wall"'
    assert task.find(f".//{TASKS}BootTrigger/{TASKS}Repetition/{TASKS}Interval") is not None
    assert (found["UserId"], found["LogonType"]) == ("LAB\\ada", "S4U"), "whoever is logged on"
    assert (found["ExecutionTimeLimit"], found["MultipleInstancesPolicy"]) == ("PT0S", "IgnoreNew")
    assert int(found["Count"] or 0) <= 255, "the schema's unsigned byte"


def test_one_command_installs_and_starts_the_units(config):
    answer = write_service(config, "systemd")
    (line,) = answer["install"]
    names = [Path(file).name for file in answer["files"]]
    copy = [
        "sudo",
        "cp",
        *answer["files"],
        "/etc/systemd/system/",
        "&&",
        "sudo",
        "systemctl",
        "daemon-reload",
        "&&",
    ]
    assert shlex.split(line) == [*copy, "sudo", "systemctl", "enable", "--now", *names]


@pytest.mark.skipif(not hasattr(socket, "AF_UNIX"), reason="no service manager here has a Unix socket")
def test_a_recorder_notifies_its_service_manager_from_start_to_end(tmp_path, monkeypatch):
    monkeypatch.setattr("daq_service.cli.run.log_to_file", lambda path: None)  # it would log later tests, too
    config = tmp_path / "test.toml"
    config.write_text(
        "[schedule]\nend_h = 0.5\nshots_per_set = 1\n[baseline]\nminimum_valid_shots = 1\n"
        "[plate]\nelements_per_edge = 16\n",
        encoding="utf-8",
    )
    with notify_socket(tmp_path) as (environment, heard):
        done = solimon_here("record", str(config), env=environment)
    assert done.returncode == 0, done.stderr
    opening, *_, stopping = heard
    assert opening[0] == "WATCHDOG=1", "not ready yet"
    assert opening[-1] == "STATUS=opening the rig"
    ready = heard.index(["READY=1"])
    assert all(lines[0] == "WATCHDOG=1" for lines in heard[:ready])
    assert stopping == ["STOPPING=1", "STATUS=stopping"]


@pytest.mark.skipif(not hasattr(socket, "AF_UNIX"), reason="no service manager here has a Unix socket")
def test_the_event_loop_of_a_web_service_feeds_the_watchdog_of_its_manager(tmp_path, monkeypatch):
    monkeypatch.setattr("daq_service.web.server.TICKS_OF_A_BEAT", 1)
    monkeypatch.setattr("daq_service.web.server.reduce_garbage_collection", lambda: None)
    app = create_app(load_settings(None), tmp_path)
    with notify_socket(tmp_path) as (environment, heard):
        monkeypatch.setenv("NOTIFY_SOCKET", environment["NOTIFY_SOCKET"])
        stop = threading.Event()
        monkeypatch.setattr("daq_service.cli.run.stop_on_signals", lambda: nullcontext(stop))
        serving = threading.Thread(target=serve_app, args=(app, WebSettings(), 0))
        serving.start()
        until(lambda: len(heard) >= 3, "three beats")
        stop.set()
        ended(serving, "the service")
    assert heard[0] == heard[-1] == ["READY=1", "WATCHDOG=1"]
