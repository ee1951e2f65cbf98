"""Boards behind the NI-SCOPE double: sessions, attributes, one acquisition at a time.

Rules are those of NI-SCOPE as its manual and header give them: values are coerced upwards, attributes do
not change while an acquisition runs, a board belongs to one session.
"""

from __future__ import annotations

import dataclasses
import datetime
import math
import threading
import time
from collections.abc import Callable, Mapping

import numpy as np

from simulator.doubles.chassis.description import ProbeWiring
from simulator.doubles.chassis.scopes import ScopeParameters
from simulator.doubles.niscope.pulsers import NextEcho, Pulsers
from simulator.doubles.niscope.session import (
    CONFIGURATION,
    FETCH_OFFSET,
    FETCH_RECORD,
    FETCH_RECORDS,
    FETCH_RELATIVE_TO,
    PRETRIGGER,
    Acquisition,
    Answer,
    Arguments,
    Channel,
    Session,
    channels_of,
    require_idle,
)
from simulator.doubles.vendor_api import statuses
from simulator.doubles.vendor_api.statuses import ScopeStatus, Status
from simulator.specimen import Specimen

SELF_CALIBRATION = 1


class NiscopeBrain:
    """Device model of all NI-SCOPE boards of a rig and the sessions open on them.

    Parameters
    ----------
    next_echo
        Asked once an acquisition, when its records are due.
    monotonic_s
        Clock of the pulsers.
    """

    def __init__(
        self,
        boards: tuple[ScopeParameters, ...],
        probes: Mapping[str, ProbeWiring],
        specimen: Specimen,
        next_echo: NextEcho,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._boards = {board.name: board for board in boards}
        self._unplugged: dict[int, ScopeParameters] = {}
        self._pulsers = Pulsers(probes, boards, specimen, next_echo)
        self._monotonic_s = monotonic_s
        self._sessions: dict[int, Session] = {}
        self._foreign_owners: dict[str, str] = {}
        self._self_calibrated: dict[int, datetime.date] = {}
        self._next_handle = 1
        self._changed = threading.Condition()

    # What a test or the control channel asks for

    def has_board(self, serial_number: int) -> bool:
        """Return whether a board with this serial number exists, plugged in or removed."""
        known = {board.serial_number for board in self._boards.values()}
        return serial_number in known | set(self._unplugged)

    def unplug(self, serial_number: int) -> None:
        """Remove a board: its sessions stay open, but their calls fail, also those that wait.

        Do nothing if no board with this serial number is plugged in.
        """
        with self._changed:
            for name, board in tuple(self._boards.items()):
                if board.serial_number == serial_number:
                    self._unplugged[serial_number] = self._boards.pop(name)
            self._changed.notify_all()

    def plug(self, serial_number: int, name: str = "") -> None:
        """Plug a removed board in, under another name if one is given.

        Raise KeyError if it was not removed.
        """
        with self._changed:
            board = self._unplugged.pop(serial_number)
            board = dataclasses.replace(board, name=name or board.name)
            self._boards[board.name] = board

    def names(self) -> frozenset[str]:
        """Return the resource names of the boards that are plugged in."""
        with self._changed:
            return frozenset(self._boards)

    def occupy(self, resource: str, owner: str) -> None:
        """Reserve a board by its name for another process; new sessions on it fail, open ones continue."""
        with self._changed:
            self._foreign_owners[resource] = owner

    def vacate(self, owner: str) -> None:
        """Release all boards that `occupy` has reserved for another process."""
        with self._changed:
            owners = self._foreign_owners.items()
            self._foreign_owners = {name: other for name, other in owners if other != owner}

    def list_open_sessions(self) -> list[tuple[str, str]]:
        """Return client and resource name of each open session, in the order of opening."""
        with self._changed:
            return [(session.client, session.board.name) for session in self._sessions.values()]

    def close_client_sessions(self, client: str) -> list[str]:
        """Close the sessions of a client that has died, as the driver does; return their resource names."""
        with self._changed:
            left = [session for session in self._sessions.values() if session.client == client]
            for session in left:
                del self._sessions[session.handle]
            self._changed.notify_all()
            return [session.board.name for session in left]

    # Entry points

    def call(self, client: str, function: str, arguments: Arguments) -> Answer:
        """Answer one call of the NI-SCOPE API with its outputs by name; a fetch blocks.

        Raises
        ------
        Status
            The status that the entry returns instead of 0; a positive code is a warning and carries the
            outputs. It is stored for ``GetError``.
        KeyError
            There is no such function, or an argument is missing.
        """
        name = function.removeprefix("niScope_")
        if name == "SetRuntimeEnvironment":
            return {}
        if name == "InitWithOptions":
            return self._open_session(client, arguments["resource_name"])
        if name == "error_message":
            code = arguments["error_code"]
            return {"error_message": statuses.TEXTS.get(code, f"Unknown status {code}.")}
        with self._changed:
            session = self._sessions.get(arguments["vi"])
        if session is None:
            raise ScopeStatus(statuses.SCOPE_INVALID_SESSION, str(arguments["vi"]))
        if name == "GetError":
            code, description = session.last_error
            return {"error_code": code, "description": description}
        try:
            if name in CONFIGURATION:
                return CONFIGURATION[name](session, arguments) or {}
            return _ENTRIES[name](self, session, arguments) or {}
        except Status as status:
            session.last_error = (status.code, status.message)
            raise

    def _open_session(self, client: str, resource: str) -> Answer:
        """Open a session with default settings on a board and answer with its handle.

        Raise ScopeStatus if the board is unknown, or open in another session or process.
        """
        with self._changed:
            board = self._boards.get(resource)
            if board is None:
                raise ScopeStatus(statuses.SCOPE_UNKNOWN_RESOURCE, repr(resource))
            owners = [session.client for session in self._sessions.values() if session.board == board]
            owner = self._foreign_owners.get(resource, "") or next(iter(owners), "")
            if owner:
                raise ScopeStatus(statuses.SCOPE_ALREADY_IN_USE, f"owner: {owner}")
            handle, self._next_handle = self._next_handle, self._next_handle + 1
            channels = {str(number): Channel() for number in range(board.channels)}
            self._sessions[handle] = Session(handle=handle, client=client, board=board, channels=channels)
            return {"vi": handle}

    def _close_session(self, session: Session, _: Arguments) -> None:
        """Close a session; its acquisition ends, and a fetch that waits raises ScopeStatus."""
        with self._changed:
            del self._sessions[session.handle]
            self._changed.notify_all()

    def _accept_lock(self, session: Session, _: Arguments) -> None:
        """Accept a lock without effect, because it concerns the caller's own threads."""

    def _commit_session(self, session: Session, _: Arguments) -> None:
        """Check that the session can commit; nothing is programmed.

        Raise ScopeStatus while an acquisition is not aborted, or without the board.
        """
        require_idle(session)
        self._require_present(session)

    def _restore_defaults(self, session: Session, _: Arguments) -> None:
        """Reset all settings of a session and abort its acquisition; raise ScopeStatus without its board.

        A fetch that waits fails.
        """
        self._require_present(session)
        fresh = Session(
            handle=session.handle,
            client=session.client,
            board=session.board,
            channels={name: Channel() for name in session.channels},
        )
        with self._changed:
            self._sessions[session.handle] = fresh
            session.acquisition = None
            self._changed.notify_all()

    # Acquisition

    def _start_acquisition(self, session: Session, _: Arguments) -> None:
        """Start an acquisition without waiting for it.

        Raise ScopeStatus if one is not aborted yet, no channel is enabled, or the board is gone.
        """
        require_idle(session)
        self._require_present(session)
        if not any(channel.enabled for channel in session.channels.values()):
            raise ScopeStatus(statuses.SCOPE_CHANNEL_NOT_ENABLED)
        session.acquisition = self._pulsers.begin(session, self._monotonic_s())

    def _abort_acquisition(self, session: Session, _: Arguments) -> None:
        """Abort the acquisition of a session, if there is one; a fetch that waits fails.

        Then raise ScopeStatus if its board is gone.
        """
        with self._changed:
            session.acquisition = None
            self._changed.notify_all()
        self._require_present(session)

    def _count_waveforms(self, session: Session, arguments: Arguments) -> Answer:
        """Answer with the number of waveforms of a fetch: requested records that are left, times channels.

        Raise ScopeStatus for an unknown channel.
        """
        requested = session.fetch[FETCH_RECORDS]
        left = max(session.records - session.fetch[FETCH_RECORD], 0)
        records = left if requested < 0 else min(requested, left)
        return {"num_wfms": records * len(channels_of(session, arguments))}

    def _fetch_waveforms(self, session: Session, arguments: Arguments) -> Answer:
        """Block until the records are complete; answer with their codes by record, then by channel.

        ``waveform`` has ``num_samples`` padded codes per waveform; a shorter record is filled with 0.
        ``wfm_info`` has the packed scaling of each. ScopeStatus is raised at the timeout, without an
        acquisition, for a disabled channel or fetch settings that the double lacks; a code at an end of the
        range gives the overload warning with the data.
        """
        running = session.acquisition
        if running is None:
            raise ScopeStatus(statuses.SCOPE_INITIATE_NOT_CALLED)
        self._wait_until_done(session, running, arguments["timeout"])
        channels = channels_of(session, arguments)
        if not all(channel.enabled for _, channel in channels):
            raise ScopeStatus(statuses.SCOPE_CHANNEL_NOT_ENABLED)
        wanted, count = arguments["num_samples"], self._count_waveforms(session, arguments)["num_wfms"]
        if wanted < 0 or session.fetch[FETCH_RELATIVE_TO] != PRETRIGGER or session.fetch[FETCH_OFFSET] != 0:
            raise ScopeStatus(statuses.SCOPE_INVALID_FETCH_PARAMETERS)
        first = session.fetch[FETCH_RECORD] * len(channels)
        fetched = [
            self._pulsers.waveform(
                session, running, index // len(channels), channels[index % len(channels)], wanted
            )
            for index in range(first, first + count)
        ]
        # Waveforms lie `num_samples` apart in the caller's buffer.
        waveform = np.zeros((count, wanted), dtype=np.int32)
        for row, one in zip(waveform, fetched, strict=True):
            row[: one.samples.size] = one.samples
        answer = {
            "waveform": waveform.reshape(-1),
            "wfm_info": np.frombuffer(b"".join(one.info for one in fetched), dtype=np.uint8),
        }
        if any(one.overloaded for one in fetched):
            raise ScopeStatus(statuses.SCOPE_ADC_OVERLOAD_WARNING, values=answer)
        return answer

    def _wait_until_done(self, session: Session, running: Acquisition, timeout_s: float) -> None:
        """Block until an acquisition is complete, at most ``timeout_s``; a negative one has no limit.

        Raise ScopeStatus at the timeout, or if the acquisition is aborted, the session closed or the board
        removed.
        """
        deadline_s = math.inf if timeout_s < 0.0 else self._monotonic_s() + timeout_s
        with self._changed:
            while True:
                self._require_present(session)
                if self._sessions.get(session.handle) is not session:
                    raise ScopeStatus(statuses.SCOPE_INVALID_SESSION)
                if session.acquisition is not running:
                    raise ScopeStatus(statuses.SCOPE_INITIATE_NOT_CALLED, "the acquisition was aborted")
                now_s = self._monotonic_s()
                if now_s >= running.done_s:
                    return
                if now_s >= deadline_s:
                    raise ScopeStatus(statuses.SCOPE_MAX_TIME_EXCEEDED, f"Timeout: {timeout_s} s")
                self._changed.wait(min(running.done_s, deadline_s) - now_s)

    # Calibration

    def _get_calibration_date(self, session: Session, arguments: Arguments) -> Answer:
        """Answer with year, month and day of the self- or external calibration, as ``which_one`` requests."""
        day = datetime.date.fromisoformat(session.board.calibration_date)
        if arguments["which_one"] == SELF_CALIBRATION:
            day = self._self_calibrated.get(session.board.serial_number, day)
        return {"year": day.year, "month": day.month, "day": day.day}

    def _get_calibration_temperature(self, session: Session, _: Arguments) -> Answer:
        """Answer with the board's calibration temperature, °C, which self-calibration does not change."""
        return {"temperature": session.board.calibration_temperature_c}

    def _self_calibrate(self, session: Session, _: Arguments) -> None:
        """Set the date of the board's self-calibration to today (UTC).

        Raise ScopeStatus while an acquisition is not aborted, or without the board.
        """
        require_idle(session)
        self._require_present(session)
        today = datetime.datetime.now(tz=datetime.UTC).date()
        self._self_calibrated[session.board.serial_number] = today

    def _require_present(self, session: Session) -> None:
        """Raise ScopeStatus if the session's board is not plugged in."""
        if session.board not in self._boards.values():
            raise ScopeStatus(
                statuses.SCOPE_HARDWARE_FAILURE, f"{session.board.name} is not in the system any more"
            )


_ENTRIES: Mapping[str, Callable[[NiscopeBrain, Session, Arguments], Answer | None]] = {
    "close": NiscopeBrain._close_session,
    "LockSession": NiscopeBrain._accept_lock,
    "UnlockSession": NiscopeBrain._accept_lock,
    "Commit": NiscopeBrain._commit_session,
    "ResetDevice": NiscopeBrain._restore_defaults,
    "InitiateAcquisition": NiscopeBrain._start_acquisition,
    "Abort": NiscopeBrain._abort_acquisition,
    "ActualNumWfms": NiscopeBrain._count_waveforms,
    "FetchBinary16": NiscopeBrain._fetch_waveforms,
    "CalFetchDate": NiscopeBrain._get_calibration_date,
    "CalFetchTemperature": NiscopeBrain._get_calibration_temperature,
    "CalSelfCalibrate": NiscopeBrain._self_calibrate,
}

_ANSWERED_WITHOUT_SESSION = ("SetRuntimeEnvironment", "InitWithOptions", "error_message", "GetError")

ANSWERED = frozenset(f"niScope_{name}" for name in (*_ANSWERED_WITHOUT_SESSION, *CONFIGURATION, *_ENTRIES))
"""Entry points that the brain knows."""
