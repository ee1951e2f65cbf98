"""``solimon service``: services of the system that run a test from the computer's start on.

Linux: units of systemd. Windows: tasks that its scheduler starts at boot. The supply's own process is a
service of its own, so that it outlives the recorder (decision 0015).
"""

from __future__ import annotations

import getpass
import math
import os
import shlex
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path, PurePath
from xml.sax.saxutils import escape

from daq_service.corrosion_drive.remote import answered_within_s
from daq_service.errors import EXIT_INTERRUPTED, UsageError
from daq_service.processes.child import PROGRAM
from daq_service.processes.data_folder import settings_and_folder
from daq_service.processes.heartbeat import WEB_DEADLINE_S
from daq_service.processes.printing import print_result
from daq_service.processes.supervisor import STARTING_GRACE_S
from daq_service.recording.session import longest_call_s
from daq_service.settings.tree import Settings

Lines = Sequence[tuple[str, str]]


def write_services(
    *,
    manager: str,
    config: Path,
    data_dir: Path | None,
    user: str | None,
    name: str,
    out: Path,
    as_json: bool,
) -> None:
    """Run the command: write the files, print how to install them."""
    settings, folder = settings_and_folder(config, data_dir)
    user = user or os.environ.get("SUDO_USER") or _this_user()
    describe = systemd_units if manager == "systemd" else windows_tasks
    texts = describe(settings, config.absolute(), folder, user=user, name=name)
    files = [out.absolute() / file for file in texts]
    try:
        out.mkdir(parents=True, exist_ok=True)
        for file, text in zip(files, texts.values(), strict=True):
            # Windows' scheduler reads UTF-16.
            file.write_text(text, encoding="utf-8" if manager == "systemd" else "utf-16", newline="\n")
    except OSError as error:
        raise UsageError(f"cannot write to {out}: {error.strerror}; choose another --out") from error
    install = _to_install(manager, files)
    result = {"manager": manager, "files": list(map(str, files)), "install": install}
    lines = [*(f"written: {file}" for file in files), "install with:", *install]
    print_result(result, lines, as_json=as_json)


def _this_user() -> str:
    domain = os.environ.get("USERDOMAIN")
    return f"{domain}\\{getpass.getuser()}" if domain else getpass.getuser()


def _to_install(manager: str, files: Sequence[PurePath]) -> list[str]:
    """Return the commands that install the files."""
    if manager == "systemd":
        names = " ".join(file.name for file in files)
        copy = f"sudo cp {shlex.join(map(str, files))} /etc/systemd/system/"
        return [f"{copy} && sudo systemctl daemon-reload && sudo systemctl enable --now {names}"]
    # Within an older PowerShell no && joins commands.
    return [f'schtasks /create /f /tn "{file.stem}" /xml "{file}"' for file in files]


# systemd -----------------------------------------------------------------------------------------------


def systemd_units(
    settings: Settings, config: PurePath, folder: PurePath, *, user: str, name: str
) -> dict[str, str]:
    """Return the units of recorder, web service and, if there is a supply, its process, by file name."""
    longest_s = math.ceil(longest_call_s(settings) + settings.rig.stall_timeout_s)
    drive, supply = f"{name}-supply-process.service", settings.rig.driven
    units: dict[str, tuple[str, Lines, Lines]] = {
        "record": (
            "recorder",
            [("Wants", drive), ("After", drive)] if supply is not None else [],
            [
                ("Type", "notify"),
                ("NotifyAccess", "main"),
                # A beat extends each of these by its own deadline: an edited configuration counts.
                ("WatchdogSec", f"{longest_s}"),
                ("TimeoutStartSec", f"{longest_s + STARTING_GRACE_S:.0f}"),
                # The strike under way ends, what was taken is stored.
                ("TimeoutStopSec", f"{longest_s + STARTING_GRACE_S:.0f}"),
                # Only the recorder gets the signal; its workers end with it, or are killed after it.
                ("KillMode", "mixed"),
                ("RestartSec", "10"),
            ],
        ),
        "serve": (
            "web service",
            [],
            [
                ("Type", "notify"),
                ("NotifyAccess", "main"),
                ("WatchdogSec", f"{WEB_DEADLINE_S:.0f}"),  # fed by the event loop itself
                ("ExecStartPre", f"mkdir -p {_quoted(str(folder))}"),
                ("RestartSec", "5"),
                ("PrivateDevices", "yes"),
            ],
        ),
    }
    if supply is not None:
        units["supply-process"] = (
            "supply process",
            [],
            [
                ("Type", "notify"),  # before the recorder looks whether it has to start one
                ("NotifyAccess", "main"),
                ("WatchdogSec", f"{math.ceil(answered_within_s(supply))}"),
                # On a stop it switches off first, which may wait for the supply.
                ("TimeoutStopSec", f"{math.ceil(answered_within_s(supply)) + 30}"),
                ("RestartSec", "5"),
            ],
        )
    return {
        f"{name}-{command}.service": _unit(
            f"solimon, {title}: {settings.name}",
            _command(command, config, folder),
            config.parent,
            folder,
            user,
            unit,
            service,
        )
        for command, (title, unit, service) in units.items()
    }


def _unit(
    title: str, command: Iterable[str], at: PurePath, folder: PurePath, user: str, unit: Lines, service: Lines
) -> str:
    """Return the text of a systemd unit."""
    sections: dict[str, Lines] = {
        "Unit": [
            ("Description", _plain(" ".join(title.split()))),
            ("RequiresMountsFor", _quoted(str(folder))),
            ("StartLimitIntervalSec", "0"),  # a person cannot be expected to reset it
            *unit,
        ],
        "Service": [
            ("User", user),
            ("WorkingDirectory", _plain(str(at))),
            ("ExecStart", " ".join(map(_quoted, command))),
            # Any exit code may be that of a driver or a vendor's library, so none ends a test but that of a
            # configuration, which needs a person; `systemctl stop` is no restart.
            ("Restart", "always"),
            ("RestartPreventExitStatus", f"{UsageError.exit_code}"),
            ("SuccessExitStatus", f"{EXIT_INTERRUPTED}"),
            *service,
            ("NoNewPrivileges", "yes"),
            ("ProtectSystem", "full"),
            ("ProtectControlGroups", "yes"),
            ("ProtectKernelModules", "yes"),
            ("ProtectKernelTunables", "yes"),
            ("RestrictSUIDSGID", "yes"),
            ("LockPersonality", "yes"),
        ],
        "Install": [("WantedBy", "multi-user.target")],
    }
    return "\n\n".join(
        "\n".join([f"[{name}]", *(f"{key}={value}" for key, value in lines)])
        for name, lines in sections.items()
    ).join(["", "\n"])


def _command(command: str, config: PurePath, folder: PurePath) -> list[str]:
    """Return the command line of a service; a recorder stays after its last set for commands."""
    linger = ["--linger"] if command == "record" else []
    return [*PROGRAM, command, str(config), "--data-dir", str(folder), *linger]


def _plain(text: str) -> str:
    return text.replace("%", "%%")


def _quoted(text: str) -> str:
    """Quote a word of a command line for systemd."""
    if text.replace("/", "").replace("-", "").replace(".", "").replace("_", "").isalnum():
        return text
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("$", "$$")
    return f'"{_plain(escaped)}"'


# Windows -----------------------------------------------------------------------------------------------

TASK = """<?xml version="1.0" encoding="UTF-16"?>
<Task version="1.2" xmlns="http://schemas.microsoft.com/windows/2004/02/mit/task">
  <RegistrationInfo><Description>{title}</Description></RegistrationInfo>
  <Triggers>
    <BootTrigger>
      <Repetition><Interval>PT5M</Interval><StopAtDurationEnd>false</StopAtDurationEnd></Repetition>
    </BootTrigger>
  </Triggers>
  <Principals>
    <Principal id="Author">
      <UserId>{user}</UserId>
      <LogonType>S4U</LogonType>
      <RunLevel>LeastPrivilege</RunLevel>
    </Principal>
  </Principals>
  <Settings>
    <MultipleInstancesPolicy>IgnoreNew</MultipleInstancesPolicy>
    <DisallowStartIfOnBatteries>false</DisallowStartIfOnBatteries>
    <StopIfGoingOnBatteries>false</StopIfGoingOnBatteries>
    <StartWhenAvailable>true</StartWhenAvailable>
    <IdleSettings><StopOnIdleEnd>false</StopOnIdleEnd><RestartOnIdle>false</RestartOnIdle></IdleSettings>
    <ExecutionTimeLimit>PT0S</ExecutionTimeLimit>
    <Priority>4</Priority>
    <RestartOnFailure><Interval>PT1M</Interval><Count>255</Count></RestartOnFailure>
  </Settings>
  <Actions Context="Author">
    <Exec>
      <Command>{program}</Command>
      <Arguments>{arguments}</Arguments>
      <WorkingDirectory>{at}</WorkingDirectory>
    </Exec>
  </Actions>
</Task>
"""
"""Starts at boot without a login (S4U: no password is stored) and every 5 min if it has ended; normal
priority, which is not the scheduler's default; no time limit."""


def windows_tasks(
    settings: Settings, config: PurePath, folder: PurePath, *, user: str, name: str
) -> Mapping[str, str]:
    """Return the tasks of the supervisor and, if there is a supply, its process, by file name."""
    commands = {name: "run"}
    if settings.rig.driven is not None:
        commands[f"{name}-supply-process"] = "supply-process"
    return {
        f"{task}.xml": TASK.format(
            title=escape(f"solimon {command}: {settings.name}"),
            user=escape(user),
            program=escape(sys.executable),
            arguments=escape(subprocess.list2cmdline(_command(command, config, folder)[1:])),
            at=escape(str(config.parent)),
        )
        for task, command in commands.items()
    }
