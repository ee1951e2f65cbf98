"""The computer's clocks, and whether it would fall asleep during a test."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from datetime import datetime

from daq_service.cli.doctor.check import Check

LONGEST_ANSWER_S = 10.0
"""Programs of the system are asked no longer than this."""
LARGEST_STEP_S = 0.1
"""Wall and monotonic clock may part by this much during a checkup: more is a clock that is being set."""

Ask = Callable[[Sequence[str]], str | None]
"""Runs a program of the system and returns what it printed; None where there is none or it failed."""

SLEEP_UNITS = ("sleep.target", "suspend.target", "hibernate.target", "hybrid-sleep.target")


def ask_system(command: Sequence[str]) -> str | None:
    """Run a program without a shell."""
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=LONGEST_ANSWER_S, check=False, errors="replace"
        )
    except (OSError, subprocess.TimeoutExpired):
        # No such program here, or it does not answer: unknown, and told as that.
        return None
    # `systemctl is-enabled` prints "masked" and ends with 1: what was printed counts.
    return done.stdout.strip() or None


def machine_checks(
    clock: str,
    *,
    ask: Ask = ask_system,
    system: str = sys.platform,
    started_wall_s: float | None = None,
    started_mono_s: float | None = None,
) -> list[Check]:
    """Look at clocks and sleep settings.

    Parameters
    ----------
    clock
        The experiment's clock: ``wall`` or ``simulated``.
    started_wall_s, started_mono_s
        Both clocks when the checkup began; the present time if None.
    """
    wall_s, mono_s = time.time(), time.monotonic()
    checks = [
        _monotonic(
            wall_s - (wall_s if started_wall_s is None else started_wall_s),
            mono_s - (mono_s if started_mono_s is None else started_mono_s),
        ),
        _time_zone(),
    ]
    if clock == "wall":
        return [*checks, _synchronised(ask, system), _sleep(ask, system)]
    unneeded = "nothing to do: the experiment runs on simulated time"
    return checks + [
        Check(area="machine", name=name, state="skipped", found="not looked at", remedy=unneeded)
        for name in ("clock synchronised", "sleep")
    ]


def _monotonic(wall_elapsed_s: float, mono_elapsed_s: float) -> Check:
    info = time.get_clock_info("monotonic")
    parted_s = wall_elapsed_s - mono_elapsed_s
    steady = info.monotonic and mono_elapsed_s >= 0.0
    kept = abs(parted_s) <= LARGEST_STEP_S
    return Check(
        area="machine",
        name="monotonic clock",
        state="fail" if not steady else "ok" if kept else "warn",
        found=f"{info.implementation}, resolution {info.resolution:.0e} s; the wall clock moved away by "
        f"{parted_s * 1e3:.0f} ms in the {mono_elapsed_s:.1f} s of this checkup",
        remedy="let the clock be synchronised and settle, then look again"
        if steady
        else "use another computer: its monotonic clock goes backwards",
        values={
            "resolution_s": info.resolution,
            "checkup_s": mono_elapsed_s,
            "wall_against_monotonic_s": parted_s,
        },
    )


def _time_zone() -> Check:
    now = datetime.now().astimezone()
    offset = now.utcoffset()
    offset_s = 0.0 if offset is None else offset.total_seconds()
    return Check(
        area="machine",
        name="time zone",
        found=f"{now.tzname()}, UTC{offset_s / 3600:+g} h; everything is stored in UTC",
        values={"utc_offset_s": offset_s},
    )


# Synchronised to UTC --------------------------------------------------------------------------------


def _synchronised(ask: Ask, system: str) -> Check:
    how, answer = _clock_source(ask, system)
    known = {True: "synchronised", False: "not synchronised", None: "unknown whether it is synchronised"}
    command = {
        "win32": "w32tm /resync, and keep the service W32Time running",
        "darwin": "switch on Set time automatically in Date & Time",
    }.get(system, "timedatectl set-ntp true, or run chrony; look at timedatectl")
    return Check(
        area="machine",
        name="clock synchronised",
        state="ok" if answer else "warn",
        found=f"{known[answer]} ({how})",
        remedy=command,
        values={"synchronised": answer, "asked": how},
    )


def _clock_source(ask: Ask, system: str) -> tuple[str, bool | None]:
    """How it was found, and whether the clock is synchronised; None: unknown."""
    if system == "win32":
        # The words are the system's language, the leap indicator's digit is not: 3 is not synchronised.
        text = ask(["w32tm", "/query", "/status"]) or ""
        indicator = re.search(r":\s*([0-3])\(", text)
        if indicator:
            return "w32tm", indicator[1] != "3"
        return "w32tm gives no answer: is its service stopped?", None
    if system == "linux":
        text = ask(["timedatectl", "show", "--property=NTPSynchronized", "--value"]) or ""
        if text in ("yes", "no"):
            return "timedatectl", text == "yes"
        return "no timedatectl here", None
    return f"not asked on {system}", None


# Sleep ----------------------------------------------------------------------------------------------


def _sleep(ask: Ask, system: str) -> Check:
    if system == "win32":
        how, never = "powercfg", _windows_never_sleeps(ask)
        command = "powercfg /change standby-timeout-ac 0, and the same with hibernate-timeout-ac"
    elif system == "linux":
        states = [ask(["systemctl", "is-enabled", unit]) for unit in SLEEP_UNITS]
        how, never = "systemctl", None if None in states else all(state == "masked" for state in states)
        command = f"sudo systemctl mask {' '.join(SLEEP_UNITS)}"
    else:
        how, never, command = f"not asked on {system}", None, "caffeinate -s solimon run ..."
    told = {True: "switched off", False: "not switched off", None: "unknown"}
    return Check(
        area="machine",
        name="sleep",
        state="ok" if never else "warn",
        found=f"suspend is {told[never]} ({how}); a sleeping computer strikes nothing, its sets are missed",
        remedy=command,
        values={"never_sleeps": never},
    )


def _windows_never_sleeps(ask: Ask) -> bool | None:
    """Read the standby timeout on mains power: the last but one number, in any language."""
    text = ask(["powercfg", "/query", "SCHEME_CURRENT", "SUB_SLEEP", "STANDBYIDLE"]) or ""
    settings = re.findall(r"0x[0-9a-fA-F]{8}", text)
    return int(settings[-2], 16) == 0 if len(settings) >= 2 else None
