"""NI-DAQmx boards and the transducers wired to them, from what the driver's `survey` finds.

Nothing strikes: the survey commits tasks, which connects the coils' outputs at their low idle level, and
starts no counter.
"""

from __future__ import annotations

import re
import socket
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from daq_service.cli.doctor.check import HELD, Check, State, Value
from hardware_drivers.daqmx.parameters import DaqmxParameters, WatchdogWiring

OLDEST_DRIVER = (20, 1)
"""NI-DAQmx below this is not supported: the first release with all of Windows and today's Linux systems."""
SERVER_TIMEOUT_S = 3.0
"""A gRPC server that does not take a connection in this time is not there."""

LARGEST_DUTY = 0.25
"""More on-time than this is what small electromagnets are usually not rated for (assumption: see yours)."""

OWNED = "owner: "
"""How the driver's errors name who holds a board (`hardware_drivers.daqmx.translation`)."""

LOOK_UP = "look the message up in docs/reference/faults-daqmx.md"


class Finding(Protocol):
    """One thing the driver looked at (`hardware_drivers.daqmx.survey.Finding`)."""

    @property
    def subject(self) -> str:
        """``driver``, ``board 01E18096``, ``transducer B``."""
        ...

    @property
    def check(self) -> str:
        """What was looked at."""
        ...

    @property
    def state(self) -> State:
        """How it stands."""
        ...

    @property
    def detail(self) -> str:
        """What was found."""
        ...

    @property
    def remedy(self) -> str:
        """What to do."""
        ...


class BoardFacts(Protocol):
    """What a board says of itself (`hardware_drivers.daqmx.survey.BoardFacts`)."""

    @property
    def serial(self) -> str:
        """Eight hexadecimal digits."""
        ...

    @property
    def name(self) -> str:
        """Name given by NI MAX."""
        ...

    @property
    def product(self) -> str:
        """Its type."""
        ...

    @property
    def max_rate_hz(self) -> float:
        """Of one channel."""
        ...

    @property
    def calibration_date(self) -> str:
        """Of the last self-calibration; empty: the board has none."""
        ...

    @property
    def calibration_temperature_c(self) -> float:
        """Temperature then."""
        ...

    @property
    def temperature_c(self) -> float:
        """Temperature now."""
        ...


class Survey(Protocol):
    """Everything found (`hardware_drivers.daqmx.survey.Survey`)."""

    @property
    def driver_version(self) -> str:
        """Empty: the driver was not reached."""
        ...

    @property
    def boards(self) -> Sequence[BoardFacts]:
        """All boards of the system."""
        ...

    @property
    def noise_rms_v(self) -> Mapping[str, float]:
        """By position."""
        ...

    @property
    def findings(self) -> Sequence[Finding]:
        """In the order in which they were looked at."""
        ...


def board_checks(
    parameters: DaqmxParameters, survey: Callable[[DaqmxParameters], Survey], *, shot_interval_s: float
) -> list[Check]:
    """Look at driver, boards and every transducer's wiring."""
    checks = [_duty(parameters.pulse_s, shot_interval_s)]
    if parameters.transport == "grpc":
        checks.append(_server(parameters.grpc_address))
        if checks[-1].state == "fail":
            return checks
    found = survey(parameters)
    if found.driver_version:
        checks.append(_driver(found.driver_version))
    checks += [_told(finding, found, parameters) for finding in found.findings]
    if parameters.watchdog is not None:
        checks.append(_watchdog(parameters, parameters.watchdog))
    return checks


def _duty(pulse_s: float, shot_interval_s: float) -> Check:
    """Part of the time that a coil is on while its transducer is struck."""
    part = pulse_s / shot_interval_s
    return Check(
        area="rig",
        name="coils: duty cycle",
        state="ok" if part <= LARGEST_DUTY else "warn",
        found=f"{part:.1%}: on for {pulse_s:g} s of {shot_interval_s:g} s (at most {LARGEST_DUTY:.0%})",
        remedy=""
        if part <= LARGEST_DUTY
        else "shorten pulse_s or lengthen shot_interval_s, or measure that your coils stay cool",
        values={"duty": part, "pulse_s": pulse_s},
    )


def _server(address: str) -> Check:
    """Connect and leave: a server that is not there is told at once, not by every call's deadline."""
    host, _, port = address.rpartition(":")
    try:
        with socket.create_connection((host.strip("[]"), int(port)), timeout=SERVER_TIMEOUT_S):
            pass
    except OSError as error:
        return Check(
            area="rig",
            name="gRPC server",
            state="fail",
            found=f"{address} does not take a connection ({error})",
            remedy="start NI's gRPC device server on the chassis computer, open its port in the firewall, or "
            "correct grpc_address in [rig.daqmx]",
        )
    return Check(area="rig", name="gRPC server", state="ok", found=f"{address} takes a connection")


def _driver(text: str) -> Check:
    oldest = ".".join(map(str, OLDEST_DRIVER))
    fits = tuple(int(part) for part in re.findall(r"\d+", text)) >= OLDEST_DRIVER
    return Check(
        area="rig",
        name="driver: version",
        state="ok" if fits else "fail",
        found=f"NI-DAQmx {text} (at least {oldest})",
        remedy="" if fits else "install a newer NI-DAQmx: docs/how-to/install-the-ni-driver.md",
        values={"driver_version": text, "oldest": oldest},
    )


def _told(finding: Finding, found: Survey, parameters: DaqmxParameters) -> Check:
    state, remedy = finding.state, finding.remedy
    owned = state == "fail" and OWNED in f"{finding.detail}; {finding.remedy}"
    kind, _, which = finding.subject.partition(" ")
    if state == "fail" and kind == "board" and int(which, 16) not in _wanted(parameters):
        state = "warn"  # somebody else's board
    values: dict[str, Value] = {}
    detail = finding.detail
    if kind == "transducer":
        if "as asked" in detail:
            detail = f"{detail}: {_asked(parameters, which, finding.check)}"
        if finding.check == "noise":
            level_v = parameters.trigger_level_v
            values = {"noise_rms_v": found.noise_rms_v.get(which), "trigger_level_v": level_v}
    if kind == "board":
        values = _facts(next((board for board in found.boards if board.serial == which), None))
    if owned:
        detail, remedy = f"{detail}; {remedy}", HELD  # the owner may stand in either
    return Check(
        # Whoever holds the boards stands where a recorder does.
        area="recorder" if owned else "rig",
        name=f"{finding.subject}: {finding.check}",
        state=state,
        found=detail,
        remedy="" if state == "ok" else remedy or LOOK_UP,
        values=values,
    )


def _wanted(parameters: DaqmxParameters) -> set[int]:
    """Collect the serial numbers of our boards."""
    wirings = parameters.transducers.values()
    return {int(serial, 16) for wiring in wirings for serial in (wiring.board_serial, wiring.coil_serial)}


def _facts(board: BoardFacts | None) -> dict[str, Value]:
    if board is None:
        return {}
    return {
        "serial": board.serial,
        "name": board.name,
        "product": board.product,
        "max_rate_hz": board.max_rate_hz,
        "temperature_c": board.temperature_c,
        "calibration_date": board.calibration_date,
        "calibration_temperature_c": board.calibration_temperature_c,
    }


def _asked(parameters: DaqmxParameters, position: str, check: str) -> str:
    """Say in words what the board agreed to."""
    wiring = parameters.transducers[position]
    if check == "trigger":
        return (
            f"{parameters.trigger_level_v:g} V {parameters.trigger_slope} at {wiring.input}, "
            f"{parameters.pretrigger_samples} of {parameters.record_samples} samples before it"
        )
    if check == "coil's counter":
        return f"{wiring.counter} to {wiring.output_terminal}, {parameters.pulse_s:g} s, low when idle"
    return f"{wiring.input}, +-{wiring.range_v:g} V, {parameters.sample_rate_hz / 1e6:g} MS/s"


def _watchdog(parameters: DaqmxParameters, watchdog: WatchdogWiring) -> Check:
    """Each coil of the board must be among the lines that the watchdog pulls low."""
    board = int(watchdog.board_serial, 16)
    uncovered = [
        f"{wiring.output_terminal} (position {position})"
        for position, wiring in parameters.transducers.items()
        if int(wiring.coil_serial, 16) == board and digital_name(wiring.output_terminal) not in watchdog.lines
    ]
    covered = f"{', '.join(watchdog.lines)} of board {board:08X} go low after {watchdog.timeout_s:g} s"
    return Check(
        area="rig",
        name="watchdog",
        state="fail" if uncovered else "ok",
        found=f"{covered}; not covered: {', '.join(uncovered)}" if uncovered else covered,
        remedy="add their lines to [rig.daqmx.watchdog] (X Series: PFI12 is port2/line4)"
        if uncovered
        else "",
        values={"timeout_s": watchdog.timeout_s},
    )


def digital_name(terminal: str) -> str:
    """Digital name of an X Series terminal: PFI 0..7 are port 1, PFI 8..15 port 2; empty for others."""
    match = re.fullmatch(r"PFI(\d+)", terminal)
    if match is None:
        return ""
    number = int(match[1])
    return f"port{1 + number // 8}/line{number % 8}"
