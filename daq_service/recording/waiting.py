"""What the recorder does while it waits: show that it lives, listen to commands, let background work run."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from contextlib import suppress

from daq_service.alarms.states import Moment
from daq_service.background.write_retry_queue import PASSING
from daq_service.commands.execution import CommandExecutor
from daq_service.recording.clock_watch import ClockWatch
from daq_service.recording.persistence import Persistence
from daq_service.recording.presence import Presence
from daq_service.recording.set_assessor import SetAssessor
from hardware_drivers.nanoseconds import NS_PER_S


class Waiting:
    """Called again and again while the recorder waits; False once it shall stop.

    Attributes
    ----------
    free_until_ns
        Until when (ns of UTC) no set is due.
    """

    def __init__(
        self,
        assessor: SetAssessor,
        persistence: Persistence,
        presence: Presence,
        clock_watch: ClockWatch,
        commands: CommandExecutor,
        moment: Callable[[], Moment],
        stop: threading.Event,
    ) -> None:
        self._set_assessor, self._persistence, self._presence = assessor, persistence, presence
        self._clock_watch, self._commands = clock_watch, commands
        self._moment, self._stop = moment, stop
        self.free_until_ns: float = -math.inf

    def between_sets(self) -> bool:
        """Let background work run, beat and listen."""
        self._persistence.work((self.free_until_ns - self._moment().utc_ns) / NS_PER_S)
        return self.within_set()

    def within_set(self) -> bool:
        """Beat and listen, also between shots: nothing else advances the heartbeat."""
        self._clock_watch.report_steps()
        self._persistence.watch_web()
        self._persistence.watch_disk()
        self._presence.beat()
        if self._persistence.trouble is None:
            self._persistence.do(self._listen)
        else:
            with suppress(*PASSING):  # the trouble is reported; a pause is read as soon as it can be
                self._listen()
        if self._set_assessor.drive is not None:
            self._set_assessor.drive.tick(self._moment().due_h)
        return not self._stop.is_set()

    def _listen(self) -> None:
        self._commands.listen()
        self._set_assessor.expire_shelves(self._moment())
