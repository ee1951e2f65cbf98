"""Survey of the boards for `solimon doctor`: nothing strikes, nothing is changed, each result has a state."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.metadata import version
from typing import Any, Literal

import numpy as np

from hardware_drivers.daqmx.acquisition import Acquisition, commit_acquisition
from hardware_drivers.daqmx.boards import Board, check_board, describe, installed, same_serial
from hardware_drivers.daqmx.chassis import ROLES
from hardware_drivers.daqmx.client_lock import ClientLock
from hardware_drivers.daqmx.coil import Coil, commit_coil
from hardware_drivers.daqmx.connection import Connection, client_name
from hardware_drivers.daqmx.parameters import DaqmxParameters, TransducerWiring
from hardware_drivers.daqmx.translation import metadata, vendor_call
from hardware_drivers.errors import ConnectionLostError, InstrumentError
from hardware_drivers.kinds import Finding, State

log = logging.getLogger(__name__)

NOISE_TO_LEVEL = 0.2
"""Noise above this part of the trigger level will now and then trigger by itself (5 sigma)."""

WARMED_K = 5.0
"""A board further than this from its calibration's temperature drifts out of it (NI's own advice)."""

READ_TIMEOUT_S = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardFacts:
    """Facts about one board of the system, configured or not."""

    serial: str
    name: str
    product: str
    simulated: bool
    ours: bool
    max_rate_hz: float
    ranges_v: tuple[tuple[float, float], ...]
    inputs: tuple[str, ...]
    analog_trigger: bool
    terminals: tuple[str, ...]
    counters: tuple[str, ...]
    calibrates_itself: bool
    calibration_date: str
    calibration_temperature_c: float
    temperature_c: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Survey:
    """Result of a survey.

    Attributes
    ----------
    noise_rms_v
        By position: noise at the input over one record, without a strike.
    """

    package_version: str
    driver_version: str = ""
    boards: tuple[BoardFacts, ...] = ()
    noise_rms_v: Mapping[str, float] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()

    @property
    def state(self) -> State:
        """Return the worst state of all findings."""
        states = {finding.state for finding in self.findings}
        return "fail" if "fail" in states else "warn" if "warn" in states else "ok"


def survey_boards(transport: Literal["library", "grpc"] = "library", grpc_address: str = "") -> Survey:
    """Survey driver and boards before anything is wired; errors become findings."""
    no_wiring = {"": TransducerWiring(board_serial="0")}
    visit = _BoardSurvey(
        DaqmxParameters(transducers=no_wiring, transport=transport, grpc_address=grpc_address)
    )
    connection = visit.reached()
    if connection is not None:
        try:
            visit.at_installed(connection)
        finally:
            connection.close()
    visit.end()
    return visit.result()


def survey_rig(parameters: DaqmxParameters) -> Survey:
    """Survey driver, boards and every transducer's wiring without a strike; errors become findings."""
    visit = _BoardSurvey(parameters)
    connection = visit.reached()
    if connection is not None:
        try:
            visit.at_boards(connection)
            for position in parameters.transducers:
                visit.at_transducer(connection, position)
        finally:
            connection.close()
    visit.end()
    return visit.result()


class _BoardSurvey:
    """Survey in progress: collects the findings."""

    def __init__(self, parameters: DaqmxParameters) -> None:
        # A rehearsal's settings would leave the trigger unchecked.
        self._parameters, self._rehearsal = replace(parameters, dry_run=False), parameters.dry_run
        self._findings: list[Finding] = []
        self._facts: list[BoardFacts] = []
        self._boards: dict[str, Board] = {}
        self._noise_rms_v: dict[str, float] = {}
        self._driver_version = ""
        self._lock: ClientLock | None = None

    def reached(self) -> Connection | None:
        """Connect to the driver, on a server under this rig's own name."""
        parameters = self._parameters
        connections: list[Connection] = []

        def reach() -> str:
            if parameters.transport == "grpc":
                self._lock = ClientLock(parameters.grpc_address, client_name(parameters))
            connection = Connection(parameters)
            connections.append(connection)
            connection.clear_leftovers(ROLES)
            self._driver_version = connection.driver_version()
            return f"NI-DAQmx {self._driver_version} by {parameters.transport}"

        if self._checked("driver", "reachable", reach):
            return connections[0]
        for connection in connections:
            connection.close()
        return None

    def at_boards(self, connection: Connection) -> None:
        """Survey all boards, the configured ones in detail."""
        ours = {same_serial(wiring.board_serial) for wiring in self._parameters.transducers.values()}
        ours |= {same_serial(wiring.coil_serial) for wiring in self._parameters.transducers.values()}
        boards = self.at_installed(connection, ours)
        for serial in sorted(ours - set(boards)):
            self._add(
                f"board {serial}",
                "present",
                "fail",
                f"no board with this serial number; there are: {', '.join(boards) or 'none'}",
                "check its power, seating and cable, and board_serial in [rig.daqmx.transducers]",
            )
        for facts in self._facts:
            if facts.ours:
                self._assess_board(facts)

    def at_installed(self, connection: Connection, ours: Collection[str] = ()) -> dict[str, Any]:
        """Survey each board that the driver knows, by serial number."""
        boards: dict[str, Any] = {}
        self._checked("driver", "lists its boards", lambda: boards.update(installed(connection)))
        for serial, device in boards.items():
            subject = f"board {serial}"
            self._checked(subject, "answers", partial(self._describe, serial, device, serial in ours))
        return boards

    def _describe(self, serial: str, device: Any, ours: bool) -> str:
        board = describe(serial, device)
        with vendor_call(f"reading what {board.label} can do"):
            ends_v = [float(value) for value in device.ai_voltage_rngs]
            facts = BoardFacts(
                serial=serial,
                name=board.name,
                product=board.product,
                simulated=board.simulated,
                ours=ours,
                max_rate_hz=float(device.ai_max_single_chan_rate),
                ranges_v=tuple(zip(ends_v[::2], ends_v[1::2], strict=False)),
                inputs=tuple(channel.name for channel in device.ai_physical_chans),
                analog_trigger=bool(device.anlg_trig_supported),
                terminals=tuple(device.terminals),
                counters=tuple(channel.name for channel in device.co_physical_chans),
                calibrates_itself=board.calibrates_itself,
                calibration_date=board.calibration_date,
                calibration_temperature_c=board.calibration_temperature_c,
                temperature_c=metadata(
                    lambda: float(device.cal_dev_temp), math.nan, f"how warm {board.label} is"
                ),
            )
        self._boards[serial] = board
        self._facts.append(facts)
        return f"{board.product} as {board.name}, up to {facts.max_rate_hz:.10g} Hz a channel"

    def _assess_board(self, facts: BoardFacts) -> None:
        subject = f"board {facts.serial}"
        if facts.simulated:
            refused = facts.ours and not self._rehearsal
            self._add(
                subject,
                "real",
                "fail" if refused else "warn",
                "a device simulated by NI's driver: its records are made up",
                "use it for a rehearsal only: dry_run = true in [rig.daqmx]",
            )
        if not facts.calibrates_itself:
            self._add(
                subject, "calibrated", "warn", "cannot calibrate itself", "follow its external interval"
            )
            return
        if not facts.calibration_date:
            self._add(
                subject,
                "calibrated",
                "warn",
                "the driver does not say when it last calibrated itself",
                "self-calibrate it in NI MAX; a device that NI's driver simulates has no such date",
            )
            return
        away_k = abs(facts.temperature_c - facts.calibration_temperature_c)
        if math.isnan(away_k):
            self._add(
                subject,
                "calibrated",
                "ok",
                f"on {facts.calibration_date}; the driver does not say how warm it was or is",
            )
            return
        self._add(
            subject,
            "calibrated",
            "ok" if away_k <= WARMED_K else "warn",
            f"on {facts.calibration_date} at {facts.calibration_temperature_c:.1f} C; it is at "
            f"{facts.temperature_c:.1f} C now (at most {WARMED_K:g} K apart)",
            "" if away_k <= WARMED_K else "warm the chassis up for half an hour, then self-calibrate",
        )

    def at_transducer(self, connection: Connection, position: str) -> None:
        """Survey input, trigger, coil and noise of one transducer."""
        parameters, wiring = self._parameters, self._parameters.transducers[position]
        board = self._boards.get(same_serial(wiring.board_serial))
        coil_board = self._boards.get(same_serial(wiring.coil_serial))
        if board is None or coil_board is None:
            return  # told with the board
        subject = f"transducer {position}"
        if wiring.digitizes:
            self._look_at_trigger(connection, position, board, coil_board)
        if wiring.strikes:
            self._look_at_terminal(subject, position, coil_board)
            # Committed, the output is connected and low; the counter is not started.
            self._checked(
                subject,
                "coil's counter",
                lambda: _released(commit_coil(connection, parameters, position, coil_board)),
            )
        if wiring.digitizes:
            self._look_at_noise(connection, position, board, coil_board)

    def _look_at_trigger(
        self, connection: Connection, position: str, board: Board, coil_board: Board
    ) -> None:
        parameters, subject = self._parameters, f"transducer {position}"
        wiring = parameters.transducers[position]
        self._checked(subject, "board can do it", lambda: check_board(board, wiring, parameters))
        self._checked(
            subject,
            "trigger",
            lambda: _released(
                commit_acquisition(connection, parameters, position, board, coil_board, record="shot")
            ),
        )

    def _look_at_noise(self, connection: Connection, position: str, board: Board, coil_board: Board) -> None:
        parameters, subject = self._parameters, f"transducer {position}"
        self._checked(
            subject, "input read", lambda: self._measure_noise(connection, position, board, coil_board)
        )
        noise_v = self._noise_rms_v.get(position)
        if noise_v is not None and board.simulated:
            self._add(subject, "noise", "warn", f"{noise_v:.3g} V rms, made up by NI's driver")
        elif noise_v is not None:
            level_v = abs(parameters.trigger_level_v)
            quiet = noise_v <= NOISE_TO_LEVEL * level_v
            self._add(
                subject,
                "noise",
                "ok" if quiet else "warn",
                f"{noise_v:.3g} V rms; the trigger level is {level_v:g} V",
                "" if quiet else "check cable and screen, or raise trigger_level_v to five times the noise",
            )

    def _look_at_terminal(self, subject: str, position: str, board: Board) -> None:
        wiring = self._parameters.transducers[position]
        wanted = f"/{board.name}/{wiring.output_terminal}"
        facts = next(facts for facts in self._facts if facts.serial == board.serial)
        known = wanted in facts.terminals
        self._add(
            subject,
            "coil's terminal",
            "ok" if known else "fail",
            f"{wanted} {'exists' if known else 'does not exist'} on {board.label}",
            "" if known else "correct output_terminal in [rig.daqmx.transducers]",
        )

    def _measure_noise(self, connection: Connection, position: str, board: Board, coil_board: Board) -> str:
        acquisition = commit_acquisition(
            connection, self._parameters, position, board, coil_board, record="noise"
        )
        try:
            acquisition.start()
            waveform = acquisition.read(READ_TIMEOUT_S)
        finally:
            acquisition.close()
        self._noise_rms_v[position] = float(np.std(waveform.volts()))
        return f"{waveform.counts.size} samples at {waveform.sample_rate_hz:.10g} Hz"

    def end(self) -> None:
        """Release the client name."""
        if self._lock is not None:
            self._lock.release()

    def result(self) -> Survey:
        """Return the result."""
        return Survey(
            package_version=version("nidaqmx"),
            driver_version=self._driver_version,
            boards=tuple(self._facts),
            noise_rms_v=self._noise_rms_v,
            findings=tuple(self._findings),
        )

    def _checked(self, subject: str, check: str, work: Callable[[], object]) -> bool:
        """Run a check; an error becomes a finding, its message names the remedy."""
        try:
            detail = work()
        except InstrumentError as error:
            log.info("%s, %s: %s", subject, check, str(error))
            problem, _, remedy = str(error).rpartition("; ")
            self._add(subject, check, "fail", problem or str(error), remedy if problem else "")
            return False
        self._add(subject, check, "ok", detail if isinstance(detail, str) else "as asked")
        return True

    def _add(self, subject: str, check: str, state: State, detail: str, remedy: str = "") -> None:
        self._findings.append(
            Finding(subject=subject, check=check, state=state, detail=detail, remedy=remedy)
        )


def _released(committed: Acquisition | Coil) -> str:
    if not committed.close():
        raise ConnectionLostError(
            "committed, but the driver did not take it back; end what else uses the board, or reset it"
        )
    return "committed as asked, not started"
