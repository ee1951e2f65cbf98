"""Check the computer: clocks, and settings that may interrupt an unattended test."""

from __future__ import annotations

import re
import sys
import time
from datetime import datetime
from pathlib import Path

from daq_service.cli.doctor.check import Check
from daq_service.cli.doctor.unattended import Ask, check_unattended_settings, run_program

LARGEST_STEP_S = 0.1
"""Maximum drift between wall and monotonic clock during the checks; more means the clock is being set."""


def check_machine(
    clock: str,
    folder: Path,
    *,
    ask: Ask = run_program,
    system: str = sys.platform,
    started_wall_s: float | None = None,
    started_mono_s: float | None = None,
) -> list[Check]:
    """Check the clocks, sleep settings, updates and virus scanners of this computer.

    In a test on simulated time all but monotonic clock and time zone are skipped. ``system`` is a value of
    ``sys.platform``.

    Parameters
    ----------
    clock
        The experiment's clock: ``wall`` or ``simulated``.
    folder
        The test's data folder.
    ask
        Runs a program of the system; None where it fails.
    started_wall_s, started_mono_s
        Both clocks at the start of the checks, s; the present time if None.
    """
    wall_s, mono_s = time.time(), time.monotonic()
    checks = [
        _check_monotonic_clock(
            wall_s - (wall_s if started_wall_s is None else started_wall_s),
            mono_s - (mono_s if started_mono_s is None else started_mono_s),
        ),
        _check_time_zone(),
    ]
    if clock == "wall":
        return [*checks, _check_synchronization(ask, system), *check_unattended_settings(folder, ask, system)]
    unneeded = "nothing to do: the experiment runs on simulated time"
    return checks + [
        Check("machine", name, "skipped", "not checked", unneeded)
        for name in ("clock synchronised", "sleep", "updates", "antivirus")
    ]


def _check_monotonic_clock(wall_elapsed_s: float, mono_elapsed_s: float) -> Check:
    """Check the monotonic clock and its drift against the wall clock; both elapsed times in s.

    A drift above `LARGEST_STEP_S` is a warning; a clock that is not monotonic fails.
    """
    info = time.get_clock_info("monotonic")
    drift_s = wall_elapsed_s - mono_elapsed_s
    steady = info.monotonic and mono_elapsed_s >= 0.0
    within_limit = abs(drift_s) <= LARGEST_STEP_S
    return Check(
        "machine",
        "monotonic clock",
        "fail" if not steady else "ok" if within_limit else "warn",
        f"{info.implementation}, resolution {info.resolution:.0e} s; the wall clock moved away by "
        f"{drift_s * 1e3:.0f} ms in the {mono_elapsed_s:.1f} s of this checkup",
        "let the clock be synchronised and settle, then look again"
        if steady
        else "use another computer: its monotonic clock goes backwards",
        values={
            "resolution_s": info.resolution,
            "checkup_s": mono_elapsed_s,
            "wall_against_monotonic_s": drift_s,
        },
    )


def _check_time_zone() -> Check:
    """Return a check, always ok, with the time zone of this computer and its UTC offset in s."""
    now = datetime.now().astimezone()
    offset = now.utcoffset()
    offset_s = 0.0 if offset is None else offset.total_seconds()
    found = f"{now.tzname()}, UTC{offset_s / 3600:+g} h; everything is stored in UTC"
    return Check("machine", "time zone", "ok", found, values={"utc_offset_s": offset_s})


# Synchronised to UTC --------------------------------------------------------------------------------


def _check_synchronization(ask: Ask, system: str) -> Check:
    """Check whether the clock is synchronized to UTC; warn if it is not, or if that is unknown."""
    source, answer = _query_time_service(ask, system)
    texts = {True: "synchronised", False: "not synchronised", None: "unknown whether it is synchronised"}
    command = {
        "win32": "w32tm /resync, and keep the service W32Time running",
        "darwin": "switch on Set time automatically in Date & Time",
    }.get(system, "timedatectl set-ntp true, or run chrony; check with timedatectl")
    found, values = f"{texts[answer]} ({source})", {"synchronised": answer, "asked": source}
    return Check("machine", "clock synchronised", "ok" if answer else "warn", found, command, values)


def _query_time_service(ask: Ask, system: str) -> tuple[str, bool | None]:
    """Return the name of the queried time service, and whether the clock is synchronized (None: unknown).

    Asks w32tm on Windows, timedatectl and then chronyc on Linux; other systems are not asked. If no service
    answers, a phrase that states this replaces its name.
    """
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
        # The last of chrony's values is its leap status.
        if tracking := ask(["chronyc", "-c", "tracking"]):
            return "chronyc", tracking.rpartition(",")[2] != "Not synchronised"
        return "neither timedatectl nor chronyc here", None
    return f"not asked on {system}", None
