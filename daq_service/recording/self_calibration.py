"""Let the boards calibrate themselves between sets, as often as configured."""

from __future__ import annotations

import logging
import math

from daq_service.acquisition.schedule import DueSet
from daq_service.errors import RigError
from daq_service.recording.opening import is_transient
from daq_service.recording.persistence import Persistence
from daq_service.recording.presence import Presence
from daq_service.recording.set_assessor import SetAssessor
from hardware_drivers.errors import InstrumentError
from hardware_drivers.instruments import Rig
from hardware_drivers.nanoseconds import NS_PER_H, NS_PER_S

log = logging.getLogger(__name__)

TAKES_NS = 180 * NS_PER_S
"""A board's self-calibration takes up to two minutes: it is started only when there is time for it. The first
one comes at once, since it is unknown how long the boards have been warm."""


class SelfCalibration:
    """Knows when the boards calibrated themselves last."""

    def __init__(self, rig: Rig, assessor: SetAssessor, persistence: Persistence, presence: Presence) -> None:
        self._rig, self._set_assessor = rig, assessor
        self._persistence, self._presence = persistence, presence
        self._last_ns: int | None = None

    def before(self, due: DueSet) -> None:
        """Calibrate before a set if it is time to, and if there is time.

        Raises
        ------
        RigError
            The boards cannot, and no set was complete in this folder yet.
        """
        self_calibrating, interval_h = self._rig.self_calibrating, self._rig.self_calibration_interval_h
        if self_calibrating is None or not interval_h:
            return
        now_ns = self._rig.clock.utc_ns()
        age_h = math.inf if self._last_ns is None else (now_ns - self._last_ns) / NS_PER_H
        has_time = due.due_utc_ns - now_ns > TAKES_NS or self._last_ns is None
        if age_h < interval_h or not has_time:
            return
        self._presence.announce(f"self-calibration before set {due.set_index}")
        try:
            result = self_calibrating.self_calibrate()
        except InstrumentError as error:
            if not is_transient(error, proven=self._set_assessor.proven):
                raise RigError(f"self-calibration before set {due.set_index} failed: {error}") from error
            log.warning("self-calibration before set %d failed: %s", due.set_index, error)
            result = {"failed": str(error)}
        self._last_ns = now_ns
        self._persistence.say("self_calibrated", dict(result))
