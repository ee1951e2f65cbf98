"""What the recorder does now and what it asks a person, as its heartbeat shows it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict

from daq_service.processes.heartbeat import Heartbeat
from daq_service.recording.persistence import Persistence
from hardware_drivers.measurement import ShotKey

Reporter = Callable[..., None]

ASKED, ASKED_OVER = "asked", "asked_over"
"""Events: a person is asked to do something now; that is done, or too late."""


class Presence:
    """Shows what the recorder does.

    Parameters
    ----------
    answer_within_s
        How long an instrument waits for a person.

    Attributes
    ----------
    doing
        What the recorder does now; the next beat shows it.
    """

    def __init__(
        self, heartbeat: Heartbeat, persistence: Persistence, report: Reporter, *, answer_within_s: float
    ) -> None:
        self._heartbeat, self._persistence, self._report = heartbeat, persistence, report
        self._answer_within_s = answer_within_s
        self.doing, self._request = "starting", ""

    def beat(self, *, at_once: bool = False) -> None:
        """Show what the recorder does, what a person shall do, and what waits for the disk."""
        parts = (self.doing, self._request, self._persistence.waiting)
        self._heartbeat.beat("; ".join(filter(None, parts)), at_once=at_once)

    def announce(self, doing: str) -> None:
        """Show at once what is started: should it never end, the supervisor reports what hung."""
        self.doing = doing
        self.beat()

    def end(self) -> None:
        """Show that the recorder leaves."""
        self._heartbeat.stage = "ended"
        self.doing = "leaving"
        self.beat(at_once=True)

    def report_request(self, text: str, key: ShotKey | None) -> None:
        """Report what an instrument asks a person to do now; an empty text withdraws it."""
        self._request = text and f"waiting for a person: {text}"
        # The record is waited for from here on, as long as the heartbeat's deadline allows.
        self.beat(at_once=True)
        if not text:
            self._persistence.say(ASKED_OVER, {})
            self._report(ASKED_OVER)
            return
        shot = {} if key is None else asdict(key)
        asked = {"text": text, **shot, "within_s": self._answer_within_s}
        self._persistence.say(ASKED, asked)
        self._report(ASKED, **asked)
