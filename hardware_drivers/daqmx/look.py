"""Findings of `solimon doctor` on NI-DAQmx boards and their transducers, from the facts of `survey`.

Nothing strikes: the survey commits tasks, which connects the coils' outputs at their low idle level, and
starts no counter.
"""

from __future__ import annotations

import re
import socket
from collections.abc import Iterator

from hardware_drivers.daqmx.parameters import DaqmxParameters, WatchdogWiring
from hardware_drivers.daqmx.survey import survey_rig
from hardware_drivers.kinds import Finding

OLDEST_DRIVER = (20, 1)
"""NI-DAQmx below this is not supported: the first release with all of Windows and today's Linux systems."""
SERVER_TIMEOUT_S = 3.0
"""A gRPC server that does not take a connection in this time is not there."""

LARGEST_DUTY = 0.25
"""More on-time than this is what small electromagnets are usually not rated for (assumption: see yours)."""


def yield_board_findings(parameters: DaqmxParameters, *, shot_interval_s: float) -> Iterator[Finding]:
    """Yield findings on duty cycle, server, driver, boards, every transducer's wiring and the watchdogs.

    ``shot_interval_s`` is the time between two strikes. Without a connection to the gRPC server that finding
    is the last one. Nothing strikes.
    """
    if any(wiring.strikes for wiring in parameters.transducers.values()):
        yield _check_duty_cycle(parameters.pulse_s, shot_interval_s)
    if parameters.transport == "grpc":
        server = _check_grpc_server(parameters.grpc_address)
        yield server
        if server.state == "fail":
            return
    survey = survey_rig(parameters)
    if survey.driver_version:
        yield _check_driver_version(survey.driver_version)
    yield from survey.findings
    yield from (_check_watchdog(parameters, watchdog) for watchdog in parameters.all_watchdogs)
    if parameters.all_watchdogs:
        yield from _check_missing_watchdogs(parameters)


def _check_duty_cycle(pulse_s: float, shot_interval_s: float) -> Finding:
    """Return the finding on the coil's duty cycle (on-time over interval); a warning above `LARGEST_DUTY`."""
    part = pulse_s / shot_interval_s
    return Finding(
        subject="coils",
        check="duty cycle",
        state="ok" if part <= LARGEST_DUTY else "warn",
        detail=f"{part:.1%}: on for {pulse_s:g} s of {shot_interval_s:g} s (at most {LARGEST_DUTY:.0%})",
        remedy="shorten pulse_s or lengthen shot_interval_s, or measure that your coils stay cool",
        values={"duty": part, "pulse_s": pulse_s},
    )


def _check_grpc_server(address: str) -> Finding:
    """Return the finding on a connection to the server at HOST:PORT; failed if it takes none.

    It is tried for at most `SERVER_TIMEOUT_S`, which is shorter than the deadlines of calls.
    """
    host, _, port = address.rpartition(":")
    try:
        with socket.create_connection((host.strip("[]"), int(port)), timeout=SERVER_TIMEOUT_S):
            pass
    except OSError as error:
        return Finding(
            subject="gRPC server",
            check="",
            state="fail",
            detail=f"{address} does not take a connection ({error})",
            remedy="start NI's gRPC device server on the chassis computer, open its port in the firewall, or "
            "correct grpc_address in [rig.daqmx]",
        )
    return Finding(subject="gRPC server", check="", state="ok", detail=f"{address} takes a connection")


def _check_driver_version(text: str) -> Finding:
    """Return the finding on NI-DAQmx's version (``24.8.0``); failed if older than `OLDEST_DRIVER`."""
    oldest = ".".join(map(str, OLDEST_DRIVER))
    fits = tuple(int(part) for part in re.findall(r"\d+", text)) >= OLDEST_DRIVER
    return Finding(
        subject="driver",
        check="version",
        state="ok" if fits else "fail",
        detail=f"NI-DAQmx {text} (at least {oldest})",
        remedy="install a newer NI-DAQmx: docs/how-to/install-the-ni-driver.md",
        values={"driver_version": text, "oldest": oldest},
    )


def _check_watchdog(parameters: DaqmxParameters, watchdog: WatchdogWiring) -> Finding:
    """Return the finding on a watchdog; failed if the line of a coil of its board is not among its lines."""
    board = int(watchdog.board_serial, 16)
    uncovered = [
        f"{wiring.output_terminal} (position {position})"
        for position, wiring in parameters.transducers.items()
        if wiring.strikes
        and int(wiring.coil_serial, 16) == board
        and find_digital_line(wiring.output_terminal) not in watchdog.lines
    ]
    covered = f"{', '.join(watchdog.lines)} of board {board:08X} go low after {watchdog.timeout_s:g} s"
    return Finding(
        subject="watchdog" if parameters.watchdogs is None else f"watchdog of board {board:08X}",
        check="",
        state="fail" if uncovered else "ok",
        detail=f"{covered}; not covered: {', '.join(uncovered)}" if uncovered else covered,
        remedy="add their lines to [rig.daqmx.watchdog] (X Series: PFI12 is port2/line4)",
        values={"timeout_s": watchdog.timeout_s},
    )


def _check_missing_watchdogs(parameters: DaqmxParameters) -> Iterator[Finding]:
    """Return an iterator over a warning for each board that drives coils without a watchdog.

    They are in ascending order of serial number.
    """
    coils = {int(wiring.coil_serial, 16) for wiring in parameters.transducers.values() if wiring.strikes}
    return (
        Finding(
            subject=f"watchdog of board {serial:08X}",
            check="",
            state="warn",
            detail="none, though this board drives coils; the counter alone ends its pulses",
            remedy="give it its own [[rig.daqmx.watchdogs]], if it is an X Series board",
        )
        for serial in sorted(coils)
        if parameters.find_watchdog(f"{serial:X}") is None
    )


def find_digital_line(terminal: str) -> str:
    """Return the digital line of an X Series terminal ``PFIn``: ``port1/line0`` to ``port2/line7``.

    Empty for any other terminal; n is not checked to be at most 15.
    """
    match = re.fullmatch(r"PFI(\d+)", terminal)
    if match is None:
        return ""
    number = int(match[1])
    return f"port{1 + number // 8}/line{number % 8}"
