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
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePath
from xml.sax.saxutils import escape

from daq_service.corrosion_drive.remote import longest_answer_time_s
from daq_service.errors import EXIT_INTERRUPTED, UsageError
from daq_service.processes.child import PROGRAM
from daq_service.processes.data_folder import load_settings_and_folder
from daq_service.processes.heartbeat import WEB_DEADLINE_S
from daq_service.processes.printing import print_result
from daq_service.processes.supervisor import STARTING_GRACE_S
from daq_service.recording.session import compute_longest_call_s
from daq_service.settings.tree import Settings


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
    """Run `solimon service`: write the files of system services and print how to install them.

    ``manager`` "systemd" gives units in UTF-8, any other Windows tasks in UTF-16; their names start with
    ``name``. Nothing is installed; ``out`` is created and existing files are replaced. ``user`` None: who
    called sudo, otherwise the present user.

    Raises
    ------
    UsageError
        The configuration is invalid, or the folder cannot be written.
    """
    settings, folder = load_settings_and_folder(config, data_dir)
    user = user or os.environ.get("SUDO_USER") or _read_user_name()
    describe = build_systemd_units if manager == "systemd" else build_windows_tasks
    texts = describe(settings, config.absolute(), folder, user=user, name=name)
    files = [out.absolute() / file for file in texts]
    try:
        out.mkdir(parents=True, exist_ok=True)
        for file, text in zip(files, texts.values(), strict=True):
            # Windows' scheduler reads UTF-16.
            file.write_text(text, encoding="utf-8" if manager == "systemd" else "utf-16", newline="\n")
    except OSError as error:
        raise UsageError(f"cannot write to {out}: {error.strerror}; choose another --out") from error
    install = _build_install_commands(manager, files)
    result = {"manager": manager, "files": list(map(str, files)), "install": install}
    lines = [*(f"written: {file}" for file in files), "install with:", *install]
    print_result(result, lines, as_json=as_json)


def _read_user_name() -> str:
    r"""Return the name of the present user, as ``DOMAIN\user`` on Windows."""
    domain = os.environ.get("USERDOMAIN")
    return f"{domain}\\{getpass.getuser()}" if domain else getpass.getuser()


def _build_install_commands(manager: str, files: Sequence[PurePath]) -> list[str]:
    """Return the shell commands that install the service files: one for systemd, one per Windows task."""
    if manager == "systemd":
        names = " ".join(file.name for file in files)
        copy = f"sudo cp {shlex.join(map(str, files))} /etc/systemd/system/"
        return [f"{copy} && sudo systemctl daemon-reload && sudo systemctl enable --now {names}"]
    # Within an older PowerShell no && joins commands.
    return [f'schtasks /create /f /tn "{file.stem}" /xml "{file}"' for file in files]


# systemd -----------------------------------------------------------------------------------------------


def build_systemd_units(
    settings: Settings, config: PurePath, folder: PurePath, *, user: str, name: str
) -> dict[str, str]:
    """Build the systemd units of recorder, web service and supply process, as text by file name.

    Without a supply that process has no unit. Watchdog and start timeouts follow from the slowest call of the
    configured instruments.
    """
    longest_s = math.ceil(compute_longest_call_s(settings) + settings.rig.stall_timeout_s)
    supply = settings.rig.driven
    reply_s = 0 if supply is None else math.ceil(longest_answer_time_s(supply))
    values = {
        "test": _escape_percent(" ".join(settings.name.split())),
        "folder": _quote_word(str(folder)),
        "user": user,
        "at": _escape_percent(str(config.parent)),
        "wrong_configuration": UsageError.exit_code,
        "interrupted": EXIT_INTERRUPTED,
        # The supply process must be ready before the recorder looks whether it has to start one.
        "after": "" if supply is None else "Wants={0}\nAfter={0}\n".format(f"{name}-supply-process.service"),
        "longest_s": longest_s,
        "start_s": f"{longest_s + STARTING_GRACE_S:.0f}",
        "web_s": f"{WEB_DEADLINE_S:.0f}",
        "reply_s": reply_s,
        "switch_off_s": reply_s + 30,
    }
    return {
        f"{name}-{command}.service": _read_template(f"{command}.service").format(
            command=" ".join(map(_quote_word, _build_command_line(command, config, folder))), **values
        )
        for command in ("record", "serve", *(() if supply is None else ("supply-process",)))
    }


def _read_template(file: str) -> str:
    """Read the text of a service template shipped with this package."""
    return (Path(__file__).parent / "services" / file).read_text(encoding="utf-8")


def _build_command_line(command: str, config: PurePath, folder: PurePath) -> list[str]:
    """Build the argument list of a service; a recorder stays after its last set for commands."""
    linger = ["--linger"] if command == "record" else []
    return [*PROGRAM, command, str(config), "--data-dir", str(folder), *linger]


def _escape_percent(text: str) -> str:
    """Double percent signs, which systemd would expand."""
    return text.replace("%", "%%")


def _quote_word(text: str) -> str:
    """Quote a word of a command line for systemd, unless it has only letters, digits and ``/-._``.

    Quotes, backslashes, dollar and percent signs are escaped.
    """
    if text.replace("/", "").replace("-", "").replace(".", "").replace("_", "").isalnum():
        return text
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("$", "$$")
    return f'"{_escape_percent(escaped)}"'


# Windows -----------------------------------------------------------------------------------------------


def build_windows_tasks(
    settings: Settings, config: PurePath, folder: PurePath, *, user: str, name: str
) -> Mapping[str, str]:
    """Build the Windows tasks of the supervisor and of the supply process, as XML by file name.

    Without a supply there is only the first.
    """
    commands, template = {name: "run"}, _read_template("task.xml")
    if settings.rig.driven is not None:
        commands[f"{name}-supply-process"] = "supply-process"
    return {
        f"{task}.xml": template.format(
            title=escape(f"solimon {command}: {settings.name}"),
            user=escape(user),
            program=escape(sys.executable),
            arguments=escape(subprocess.list2cmdline(_build_command_line(command, config, folder)[1:])),
            at=escape(str(config.parent)),
        )
        for task, command in commands.items()
    }
