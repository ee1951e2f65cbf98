"""Survey of the boards for `solimon doctor`: nothing strikes, nothing is changed, each result has a state."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Collection, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import TYPE_CHECKING, Literal

import numpy as np

from hardware_drivers.daqmx.acquisition import Acquisition, commit_acquisition
from hardware_drivers.daqmx.boards import Board, check_board, describe_board, list_boards, normalize_serial
from hardware_drivers.daqmx.chassis import ROLES, list_board_serials
from hardware_drivers.daqmx.client_lock import ClientLock
from hardware_drivers.daqmx.coil import Coil, commit_coil
from hardware_drivers.daqmx.connection import Connection, build_client_name
from hardware_drivers.daqmx.parameters import DaqmxParameters, TransducerWiring
from hardware_drivers.daqmx.translation import read_metadata, translate_errors
from hardware_drivers.errors import ConnectionLostError, InstrumentError
from hardware_drivers.kinds import Finding, State, Value, build_error_finding

if TYPE_CHECKING:
    from nidaqmx.system import Device

log = logging.getLogger(__name__)

NOISE_TO_LEVEL = 0.2
"""Noise above this part of the trigger level will now and then trigger by itself (5 sigma)."""

WARMED_K = 5.0
"""A board further than this from its calibration's temperature drifts out of it (NI's own advice)."""

READ_TIMEOUT_S = 5.0

BOARD_VALUES = (
    "serial", "name", "product", "max_rate_hz", "temperature_c", "calibration_date",
    "calibration_temperature_c",
)  # fmt: skip
"""Facts of a board that its findings hand to programs."""

LOOK_UP = "look the message up in docs/reference/faults-daqmx.md"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardFacts(Board):
    """Facts about one board of the system, configured or not."""

    ours: bool
    max_rate_hz: float
    ranges_v: tuple[tuple[float, float], ...]
    inputs: tuple[str, ...]
    analog_trigger: bool
    terminals: tuple[str, ...]
    counters: tuple[str, ...]
    temperature_c: float


def survey_boards(transport: Literal["library", "grpc"] = "library", grpc_address: str = "") -> Survey:
    """Survey driver and boards before anything is wired; return the survey with its findings.

    ``grpc_address`` (HOST:PORT) is used with ``grpc`` only. Instrument errors become failed findings and are
    not raised. Nothing strikes.
    """
    no_wiring = {"": TransducerWiring(board_serial="0")}
    survey = Survey(DaqmxParameters(transducers=no_wiring, transport=transport, grpc_address=grpc_address))
    with ExitStack() as stack:
        if (connection := survey.connect_driver(stack)) is not None:
            survey.list_boards(connection)
    return survey


def survey_rig(parameters: DaqmxParameters) -> Survey:
    """Survey driver, boards and every transducer without a strike; return the survey with its findings.

    Instrument errors become failed findings, and are not raised.
    """
    survey = Survey(parameters)
    with ExitStack() as stack:
        if (connection := survey.connect_driver(stack)) is not None:
            survey.check_boards(connection)
            for position in parameters.transducers:
                survey.check_transducer(connection, position)
    return survey


@dataclass(slots=True, eq=False)
class Survey:
    """Survey of boards and wiring: the findings so far.

    Attributes
    ----------
    facts_by_serial
        Facts of each board that responds.
    noise_rms_v
        By position: noise at the input over one record, without a strike.
    """

    parameters: DaqmxParameters
    driver_version: str = ""
    facts_by_serial: dict[str, BoardFacts] = field(default_factory=dict)
    noise_rms_v: dict[str, float] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)
    _rehearsal: bool = False

    def __post_init__(self) -> None:
        # A rehearsal's settings would leave the trigger unchecked.
        """Note a dry run, then clear it in the parameters, so that the trigger is checked, too."""
        self._rehearsal, self.parameters = self.parameters.dry_run, replace(self.parameters, dry_run=False)

    @property
    def boards(self) -> tuple[BoardFacts, ...]:
        """Return the facts of each board that answered, in the order in which the driver lists them."""
        return tuple(self.facts_by_serial.values())

    def connect_driver(self, stack: ExitStack) -> Connection | None:
        """Connect to the driver, on a server under this rig's own name, until the stack is closed.

        Leftover tasks of that name are cleared. Return None if that fails; the finding is added either way.
        """
        parameters = self.parameters
        reached: list[Connection] = []

        def connect() -> str:
            """Lock the client name, connect, and clear leftover tasks; return version and transport.

            Instrument errors pass through.
            """
            if parameters.transport == "grpc":
                stack.callback(ClientLock(parameters.grpc_address, build_client_name(parameters)).release)
            connection = Connection(parameters)
            stack.callback(connection.close)
            connection.clear_leftover_tasks(ROLES)
            self.driver_version = connection.driver_version()
            reached.append(connection)
            return f"NI-DAQmx {self.driver_version} by {parameters.transport}"

        self._run_check("driver", "reachable", connect)
        return reached[0] if reached else None

    def list_boards(self, connection: Connection, ours: Collection[str] | None = None) -> Collection[str]:
        """Add findings on the list of boards and on each listed board; return their serial numbers.

        The facts of each board that answers are stored; instrument errors become findings.

        Parameters
        ----------
        ours
            Serial numbers of the configured boards: a fault of any other board is a warning. None: no board
            is configured yet.
        """
        listed: dict[str, Device] = {}
        self._run_check("driver", "lists its boards", lambda: listed.update(list_boards(connection)))
        for serial, device in listed.items():
            failed: State = "fail" if ours is None or serial in ours else "warn"
            work = partial(self._survey_board, serial, device, ours=serial in (ours or ()))
            self._run_check(f"board {serial}", "answers", work, failed=failed)
        return listed

    def check_boards(self, connection: Connection) -> None:
        """Add findings on the driver's list and on every listed board, then on the configured boards.

        A configured board that is absent or simulated by NI's driver gets a failed finding (simulated in a
        dry run: a warning); each one that answers gets a finding on its calibration. Instrument errors become
        findings.
        """
        ours = set(map(normalize_serial, list_board_serials(self.parameters)))
        listed = self.list_boards(connection, ours)
        for serial in sorted(ours - set(listed)):
            self._add_result(
                f"board {serial}",
                "present",
                "fail",
                f"no board with this serial number; there are: {', '.join(listed) or 'none'}",
                "check its power, seating and cable, and board_serial in [rig.daqmx.transducers]",
            )
        for facts in self.boards:
            if facts.ours and facts.simulated:
                self._add_result(
                    f"board {facts.serial}",
                    "real",
                    "warn" if self._rehearsal else "fail",
                    "a device simulated by NI's driver: its records are made up",
                    "use it for a rehearsal only: dry_run = true in [rig.daqmx]",
                )
            if facts.ours:
                self._add_result(f"board {facts.serial}", "calibrated", *_rate_calibration(facts))

    def _survey_board(self, serial: str, device: Device, *, ours: bool) -> str:
        """Read the facts of a board and store them in `facts_by_serial`; return a summary for its finding.

        ``ours``: the board is configured. Raise InstrumentError if the board does not answer.
        """
        board = describe_board(serial, device)
        with translate_errors(f"reading what {board.label} can do"):
            ends_v = [float(value) for value in device.ai_voltage_rngs]
            facts = BoardFacts(
                **{item.name: getattr(board, item.name) for item in fields(board)},
                ours=ours,
                max_rate_hz=float(device.ai_max_single_chan_rate),
                ranges_v=tuple(zip(ends_v[::2], ends_v[1::2], strict=False)),
                inputs=tuple(channel.name for channel in device.ai_physical_chans),
                analog_trigger=bool(device.anlg_trig_supported),
                terminals=tuple(device.terminals),
                counters=tuple(channel.name for channel in device.co_physical_chans),
                temperature_c=read_metadata(
                    lambda: float(device.cal_dev_temp), math.nan, f"how warm {board.label} is"
                ),
            )
        self.facts_by_serial[serial] = facts
        return f"{board.product} as {board.name}, up to {facts.max_rate_hz:.10g} Hz a channel"

    def check_transducer(self, connection: Connection, position: str) -> None:
        """Add findings on input, trigger, coil and noise of one transducer, as far as wired; nothing strikes.

        Instrument errors become findings. Do nothing if one of its boards did not answer: that board has a
        failed finding.
        """
        parameters, wiring = self.parameters, self.parameters.transducers[position]
        board = self.facts_by_serial.get(normalize_serial(wiring.board_serial))
        coil_board = self.facts_by_serial.get(normalize_serial(wiring.coil_serial))
        if board is None or coil_board is None:
            return  # its board has a failed finding
        subject = f"transducer {position}"

        def commit(record: Literal["shot", "noise"]) -> Acquisition:
            """Commit the acquisition of a triggered shot or of noise, and return it.

            Instrument errors pass through.
            """
            return commit_acquisition(connection, parameters, position, board, coil_board, record=record)

        def check_limits() -> str:
            """Check that the board can take the record; return the accepted input as text.

            Raise ConfigurationError if it cannot.
            """
            check_board(board, wiring, parameters)
            return (
                f"as asked: {wiring.input}, +-{wiring.range_v:g} V, {parameters.sample_rate_hz / 1e6:g} MS/s"
            )

        def check_trigger() -> str:
            """Commit the triggered acquisition and clear it; return the accepted trigger as text.

            Instrument errors pass through.
            """
            return f"{_release_task(commit('shot'))}: {format_trigger(parameters, wiring)}"

        def check_counter() -> str:
            """Commit the coil's counter and clear it; return the accepted pulse as text.

            The counter is not started. Instrument errors pass through.
            """
            # Committed, the output is connected and low; the counter is not started.
            coil = commit_coil(connection, parameters, position, coil_board)
            return f"{_release_task(coil)}: {_format_counter(parameters, wiring)}"

        if wiring.digitizes:
            self._run_check(subject, "board can do it", check_limits)
            self._run_check(subject, "trigger", check_trigger)
        if wiring.strikes:
            self._check_terminal(subject, wiring, coil_board)
            self._run_check(subject, "coil's counter", check_counter)
        if wiring.digitizes:
            self._run_check(subject, "input read", lambda: self._measure_noise(position, commit("noise")))
            self._rate_noise(position, board)

    def _check_terminal(self, subject: str, wiring: TransducerWiring, board: BoardFacts) -> None:
        """Add the finding on the coil's output terminal; failed if the board does not list that terminal."""
        terminal = f"/{board.name}/{wiring.output_terminal}"
        known = terminal in board.terminals
        self._add_result(
            subject,
            "coil's terminal",
            "ok" if known else "fail",
            f"{terminal} {'exists' if known else 'does not exist'} on {board.label}",
            "correct output_terminal in [rig.daqmx.transducers]",
        )

    def _measure_noise(self, position: str, acquisition: Acquisition) -> str:
        """Record once without a trigger and store the noise, RMS about the mean in V; return a summary.

        The task is cleared in any case; instrument errors are raised.
        """
        try:
            acquisition.start()
            waveform = acquisition.read(READ_TIMEOUT_S)
        finally:
            acquisition.close()
        self.noise_rms_v[position] = float(np.std(waveform.volts()))
        return f"{waveform.counts.size} samples at {waveform.sample_rate_hz:.10g} Hz"

    def _rate_noise(self, position: str, board: Board) -> None:
        """Add the finding on a position's noise: a warning above `NOISE_TO_LEVEL` of the trigger level.

        That of a simulated board is always a warning. Nothing is added if noise was not measured.
        """
        noise_v = self.noise_rms_v.get(position)
        if noise_v is None:
            return
        level_v = self.parameters.trigger_level_v
        state: State = "ok" if noise_v <= NOISE_TO_LEVEL * abs(level_v) else "warn"
        detail = f"{noise_v:.3g} V rms; the trigger level is {abs(level_v):g} V"
        remedy = "check cable and screen, or raise trigger_level_v to five times the noise"
        if board.simulated:
            state, detail, remedy = "warn", f"{noise_v:.3g} V rms, made up by NI's driver", LOOK_UP
        values: dict[str, Value] = {"noise_rms_v": noise_v, "trigger_level_v": level_v}
        self._add_result(f"transducer {position}", "noise", state, detail, remedy, values)

    def _run_check(
        self, subject: str, check: str, work: Callable[[], str | None], *, failed: State = "fail"
    ) -> None:
        """Run a check and add its finding: ``ok`` with the text that it returns, else the instrument error.

        Parameters
        ----------
        work
            The check. An empty text or None becomes ``as asked``; an InstrumentError is logged.
        failed
            State of the finding if `work` raises.
        """
        try:
            detail = work()
        except InstrumentError as error:
            log.info("%s, %s: %s", subject, check, str(error))
            self._add_finding(replace(build_error_finding(subject, check, error, LOOK_UP), state=failed))
        else:
            self._add_result(subject, check, "ok", detail or "as asked")

    def _add_result(
        self,
        subject: str,
        check: str,
        state: State,
        detail: str,
        remedy: str = "",
        values: Mapping[str, Value] | None = None,
    ) -> None:
        """Build a finding from these values and add it; the remedy is left out where the state is ``ok``."""
        self._add_finding(
            Finding(
                subject=subject,
                check=check,
                state=state,
                detail=detail,
                remedy="" if state == "ok" else remedy,
                values=values or {},
            )
        )

    def _add_finding(self, finding: Finding) -> None:
        """Append a finding to `findings`; one on a board gets that board's `BOARD_VALUES` as its values."""
        facts = self.facts_by_serial.get(finding.subject.removeprefix("board "))
        if facts is not None:
            finding = replace(finding, values={name: getattr(facts, name) for name in BOARD_VALUES})
        self.findings.append(finding)


def _rate_calibration(facts: BoardFacts) -> tuple[State, str, str]:
    """Return state, detail and remedy of the finding on a board's self-calibration.

    A warning if the board's temperature differs by more than `WARMED_K` from that of the calibration, if the
    date is unknown, or if the board cannot calibrate itself.
    """
    if not facts.calibrates_itself:
        return "warn", "cannot calibrate itself", "follow its external interval"
    date = facts.calibration_date
    if not date:
        return (
            "warn",
            "the driver does not report its last self-calibration",
            "self-calibrate it in NI MAX; a device that NI's driver simulates has no such date",
        )
    away_k = abs(facts.temperature_c - facts.calibration_temperature_c)
    if math.isnan(away_k):
        return "ok", f"on {date}; the driver does not report its temperature then or now", ""
    detail = (
        f"on {date} at {facts.calibration_temperature_c:.1f} C; it is at {facts.temperature_c:.1f} C now (at "
        f"most {WARMED_K:g} K apart)"
    )
    state: State = "ok" if away_k <= WARMED_K else "warn"
    return state, detail, "warm the chassis up for half an hour, then self-calibrate"


def format_trigger(parameters: DaqmxParameters, wiring: TransducerWiring) -> str:
    """Format trigger level, slope, pre-trigger and holdoff of a transducer for a finding."""
    held = "" if parameters.holdoff_s is None else f", held off for {parameters.holdoff_s * 1e3:g} ms"
    return (
        f"{parameters.trigger_level_v:g} V {parameters.trigger_slope} at {wiring.input}, "
        f"{parameters.pretrigger_samples} of {parameters.record_samples} samples before it{held}"
    )


def _format_counter(parameters: DaqmxParameters, wiring: TransducerWiring) -> str:
    """Format counter, terminal and pulse length in s of a coil for a finding."""
    return f"{wiring.counter} to {wiring.output_terminal}, {parameters.pulse_s:g} s, low when idle"


def _release_task(committed: Acquisition | Coil) -> str:
    """Clear a committed, not started task and return the result as text for a finding.

    Raise ConnectionLostError if the driver does not confirm it.
    """
    if not committed.close():
        raise ConnectionLostError(
            "committed, but the driver did not take it back; end what else uses the board, or reset it"
        )
    return "committed as asked, not started"
