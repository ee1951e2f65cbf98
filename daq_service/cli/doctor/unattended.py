"""Check for interruptions of an unattended test: sleep, restarts, scanners that lock files."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path, PureWindowsPath

from pydantic import TypeAdapter

from daq_service.cli.doctor.check import Check
from daq_service.shared_file import load_module_toml

LONGEST_ANSWER_S = 10.0
"""Timeout for programs of the system."""

Ask = Callable[[Sequence[str]], str | None]
"""Runs a program of the system and returns what it printed; None where there is none or it failed."""

SLEEP_UNITS = ("sleep.target", "suspend.target", "hibernate.target", "hybrid-sleep.target")
IDLE_ACTION = "org.freedesktop.login1 /org/freedesktop/login1 org.freedesktop.login1.Manager IdleAction"
UPGRADE, REBOOT = "APT::Periodic::Unattended-Upgrade", "Unattended-Upgrade::Automatic-Reboot"
UPDATE_POLICY = r"HKLM\SOFTWARE\Policies\Microsoft\Windows\WindowsUpdate\AU"
UPDATE_WAITS = r"HKLM\SOFTWARE\Microsoft\Windows\CurrentVersion\WindowsUpdate\Auto Update\RebootRequired"
DEFENDER = "(Get-MpComputerStatus).RealTimeProtectionEnabled; (Get-MpPreference).ExclusionPath"
SCANNERS = TypeAdapter(dict[str, str]).validate_python(load_module_toml(__file__))
"""Programs of Linux that look into files as they are opened, by the name of their process."""


def run_program(command: Sequence[str]) -> str | None:
    """Run a program without a shell and return its stripped output, also of one that ends with an error code.

    None if it cannot be started, takes longer than `LONGEST_ANSWER_S`, or prints nothing.
    """
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=LONGEST_ANSWER_S, check=False, errors="replace"
        )
    except (OSError, subprocess.TimeoutExpired):
        # No such program here, or it does not answer: the result is unknown.
        return None
    # `systemctl is-enabled` prints "masked" and ends with 1: what was printed counts.
    return done.stdout.strip() or None


def check_unattended_settings(folder: Path, ask: Ask, system: str) -> list[Check]:
    """Check sleep, updates and virus scanners; settings that cannot be read give a warning.

    ``system`` is a value of ``sys.platform``; others than Linux and Windows are not asked.
    """
    return [_check_sleep(ask, system), _check_updates(ask, system), _check_antivirus(folder, ask, system)]


def _build_machine_check(
    name: str, good: bool | None, found: str, remedy: str, **values: str | bool | None
) -> Check:
    """Create a check of area ``machine``: ok if ``good`` is True, a warning if False or None (unknown)."""
    return Check("machine", name, "ok" if good else "warn", found, remedy, values)


# Sleep ----------------------------------------------------------------------------------------------


def _check_sleep(ask: Ask, system: str) -> Check:
    """Check that sleep and hibernation are switched off; warn if not, or if it is unknown."""
    idle = None
    if system == "win32":
        source, never = "powercfg", _is_windows_sleep_disabled(ask)
        command = "powercfg /change standby-timeout-ac 0, and the same with hibernate-timeout-ac"
    elif system == "linux":
        states = [ask(["systemctl", "is-enabled", unit]) for unit in SLEEP_UNITS]
        source, never = "systemctl", None if None in states else all(state == "masked" for state in states)
        action = ask(["busctl", "get-property", *IDLE_ACTION.split()]) or ""
        idle = action.removeprefix("s ").strip('"') or None
        command = f"sudo systemctl mask {' '.join(SLEEP_UNITS)}"
    else:
        source, never, command = f"not asked on {system}", None, "caffeinate -s solimon run ..."
    texts = {True: "switched off", False: "not switched off", None: "unknown"}
    # If it can sleep: the setting that allows it. A desktop has its own settings.
    action = "" if never or idle is None else f", IdleAction of logind is {idle}"
    found = (
        f"suspend is {texts[never]} ({source}{action}); a sleeping computer strikes nothing, "
        "its sets are missed"
    )
    return _build_machine_check("sleep", never, found, command, never_sleeps=never, idle_action=idle)


def _is_windows_sleep_disabled(ask: Ask) -> bool | None:
    """Return whether sleep and hibernation are off on mains power; None if powercfg gives no answer.

    The timeout is the next-to-last hexadecimal number of each answer, in any language.
    """
    timeouts = []
    for kind in ("STANDBYIDLE", "HIBERNATEIDLE"):
        text = ask(["powercfg", "/query", "SCHEME_CURRENT", "SUB_SLEEP", kind]) or ""
        settings = re.findall(r"0x[0-9a-fA-F]{8}", text)
        if len(settings) < 2:
            return None
        timeouts.append(int(settings[-2], 16))
    return not any(timeouts)


# Updates that restart -------------------------------------------------------------------------------


def _check_updates(ask: Ask, system: str) -> Check:
    """Check that updates do not restart the computer and no restart is pending; warn if so, or if unknown."""
    waits, restarts, source = None, None, f"not asked on {system}"
    remedy = "let updates restart this computer only when a person requests it"
    if system == "linux":
        waits, restarts, source = _read_linux_updates(ask)
        remedy = f'set {REBOOT} "false"; in /etc/apt/apt.conf.d, or stop the timers of your updater'
    elif system == "win32":
        waits, restarts, source = _read_windows_updates(ask)
        remedy = "in gpedit.msc set Configure Automatic Updates to 2 (notify), or pause updates for the test"
    if waits:
        remedy = f"restart it before the test starts; then {remedy}"
    texts = {True: "restart", False: "do not restart", None: "may restart (unknown)"}
    waiting = "; one that is installed waits for a restart" if waits else ""
    found = f"updates {texts[restarts]} this computer by themselves ({source}){waiting}"
    good = restarts is False and not waits
    return _build_machine_check(
        "updates", good, found, remedy, restart_by_themselves=restarts, restart_waits=waits
    )


def _read_linux_updates(ask: Ask) -> tuple[bool | None, bool | None, str]:
    """Read on Linux whether a restart is pending, whether updates restart, and the source.

    Asks apt-config, then dnf-automatic; None where unknown.
    """
    waits = ask(["ls", "/run/reboot-required"]) is not None
    # It prints what is set, and the root of an empty tree else.
    text = ask(["apt-config", "dump"])
    if text is not None:
        settings = dict(re.findall(r'^(\S+) "(.*)";$', text, re.MULTILINE))
        on = settings.get(UPGRADE, "0") not in ("", "0")
        return waits, on and settings.get(REBOOT, "false").lower() in ("true", "1", "yes"), "apt-config"
    if (timer := ask(["systemctl", "is-enabled", "dnf-automatic.timer"])) is not None:
        return waits, None if timer == "enabled" else False, f"dnf-automatic.timer is {timer}"
    return waits, None, "neither apt-config nor dnf-automatic here"


def _read_windows_updates(ask: Ask) -> tuple[bool | None, bool | None, str]:
    """Read on Windows whether a restart is pending, whether updates restart, and the source.

    Without a policy that forbids restarts the second value is None (unknown).
    """
    waits = ask(["reg", "query", UPDATE_WAITS]) is not None
    text = ask(["reg", "query", UPDATE_POLICY]) or ""
    policy = {name: int(value, 16) for name, value in re.findall(r"(\w+)\s+REG_DWORD\s+(0x\w+)", text)}
    if policy.get("NoAutoUpdate") == 1 or policy.get("AUOptions") == 2:
        return waits, False, "policy of Windows Update"
    return waits, None, "no policy of Windows Update forbids it"


# Scanners that hold files ---------------------------------------------------------------------------


def _check_antivirus(folder: Path, ask: Ask, system: str) -> Check:
    """Check that no known virus scanner locks files of the folder; warn if one may, or if it is unknown."""
    is_excluded, finding, remedy = None, f"not asked on {system}", f"except {folder} from scanning on access"
    if system == "linux":
        processes = ask(["ps", "-e", "-o", "comm="])
        running = [name for name in (processes or "").split() if name in SCANNERS]
        if running:
            finding = f"{SCANNERS[running[0]]} ({running[0]}) runs; whether it scans {folder} is unknown"
        elif processes is not None:
            is_excluded, finding = True, "none that is known runs"
        else:
            finding = "unknown: no ps here"
    elif system == "win32":
        is_excluded, finding = _read_defender_exclusion(folder, ask)
        remedy = f'as administrator in PowerShell: Add-MpPreference -ExclusionPath "{folder}"'
    return _build_machine_check(
        "antivirus", is_excluded, f"scanner on access: {finding}", remedy, data_folder_left_alone=is_excluded
    )


def _read_defender_exclusion(folder: Path, ask: Ask) -> tuple[bool | None, str]:
    """Return whether Windows Defender leaves the folder unscanned, and a description.

    True if it is off or the folder is excluded; None if that is unknown.
    """
    text = ask(["powershell", "-NoProfile", "-NonInteractive", "-Command", DEFENDER])
    if text is None:
        return None, "unknown: Windows Defender does not answer, maybe another one is installed"
    on, *excepted = (line.strip() for line in text.splitlines())
    if on == "False":
        return True, "Windows Defender is off"
    if any(line.startswith("N/A") for line in excepted):
        return None, "Windows Defender; its exceptions are unknown: only administrators can list them"
    covered = any(PureWindowsPath(folder).is_relative_to(PureWindowsPath(line)) for line in excepted if line)
    return covered, f"Windows Defender; {folder} is {'an exception' if covered else 'no exception'}"
