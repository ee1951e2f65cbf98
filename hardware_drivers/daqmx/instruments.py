"""Digitizer, striker and self-calibration of a rig on NI-DAQmx boards, behind the Protocols."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

from hardware_drivers.daqmx.chassis import Chassis
from hardware_drivers.daqmx.parameters import DaqmxParameters
from hardware_drivers.errors import ConfigurationError, InstrumentError
from hardware_drivers.instruments import Acquired, require_timeout
from hardware_drivers.measurement import ShotKey

log = logging.getLogger(__name__)

STRIKER = "striker"


class Bench:
    """State that the instruments of one chassis share: the armed position, a falling striker."""

    def __init__(self, chassis: Chassis) -> None:
        self.chassis = chassis
        self.armed: ShotKey | None = None
        self.lands_at = 0.0

    def require_position(self, key: ShotKey, what: str) -> None:
        """Reject a position that is not wired for the requested operation."""
        wired = self.chassis.parameters.transducers
        known = [
            name
            for name, wiring in wired.items()
            if (wiring.strikes if what == STRIKER else wiring.digitizes)
        ]
        if key.position not in known:
            raise ConfigurationError(
                f"no {what} at position {key.position!r}; there are: {', '.join(sorted(known))}; wire it in "
                "[rig.daqmx.transducers]"
            )


class DaqmxDigitizer:
    """Digitizer that samples the armed transducer around its own wave."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench

    def arm(self, key: ShotKey) -> None:
        """Start the acquisition: its pre-trigger fills from now on, or after the coil's ringing.

        A striker of an earlier strike that no one recorded is left to land first: its wave belongs to
        no shot.
        """
        bench, chassis = self._bench, self._bench.chassis
        chassis.check_thread()
        bench.require_position(key, "solitary-wave transducer")
        if bench.armed is not None:
            raise ConfigurationError(f"already armed for {bench.armed}; read or disarm first")
        falling_s = bench.lands_at - time.monotonic()
        if falling_s > 0.0:
            time.sleep(falling_s)
        with chassis.attempt():
            chassis.acquisition(key.position).start()
        bench.armed = key

    def read(self, timeout_s: float) -> Acquired:
        """Wait for the record and disarm; an error leaves nothing running."""
        bench, chassis = self._bench, self._bench.chassis
        chassis.check_thread()
        require_timeout(timeout_s)
        key, bench.armed = bench.armed, None
        if key is None:
            raise ConfigurationError("not armed; arm before the strike, then read")
        acquired = None
        try:
            with chassis.attempt():
                acquisition = chassis.acquisition(key.position)
                waveform = acquisition.read(timeout_s)
                settings = {**acquisition.settings, "driver_version": chassis.driver_version}
                acquired = Acquired(waveform=waveform, settings=settings)
                bench.lands_at = 0.0
                chassis.recovered()
                acquisition.stop()
        except InstrumentError as error:
            if acquired is None:
                raise
            # The record is whole; what failed after it is met again, and told, at the next arm.
            log.warning("the record of %s is sound, but ending its acquisition failed: %s", key, str(error))
        return acquired

    def disarm(self) -> None:
        """Stop waiting; harmless when not armed, and when the connection is lost."""
        self._bench.chassis.check_thread()
        if self._bench.armed is not None:
            self._bench.armed = None
            self._bench.chassis.end_turn()


class DaqmxStriker:
    """Striker that pulses one coil by its board's counter."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench

    def strike(self, key: ShotKey) -> None:
        """Pulse the coil once; on return it is off. In a dry run nothing moves."""
        bench, chassis = self._bench, self._bench.chassis
        chassis.check_thread()
        bench.require_position(key, STRIKER)
        armed = bench.armed
        if armed is not None and armed.position != key.position:
            raise ConfigurationError(
                f"a strike at {key.position!r} while {armed.position!r} is armed goes unseen; disarm first"
            )
        if chassis.parameters.dry_run:
            return
        parameters = chassis.parameters
        try:
            with chassis.attempt():
                chassis.coil(key.position).pulse()
        except BaseException:
            bench.armed = None  # its acquisition was ended with the coil
            raise
        finally:
            bench.lands_at = chassis.coil_off_at + parameters.fall_s + parameters.fall_margin_s

    def make_safe(self) -> None:
        """Switch off every coil that may be on; disarm the armed acquisition."""
        self._bench.chassis.check_thread()
        self._bench.armed = None
        self._bench.chassis.make_safe()


class DaqmxSelfCalibration:
    """Self-calibration of the digitizer boards, between sets."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench

    def self_calibrate(self) -> Mapping[str, str]:
        """Calibrate every digitizer board and read its scaling."""
        bench, chassis = self._bench, self._bench.chassis
        chassis.check_thread()
        if bench.armed is not None:
            raise ConfigurationError(f"armed for {bench.armed}; calibrate between sets")
        with chassis.attempt():
            return chassis.self_calibrate()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DaqmxInstruments:
    """Instruments of one chassis, from which a rig is composed together with the clock."""

    digitizer: DaqmxDigitizer
    striker: DaqmxStriker
    self_calibrating: DaqmxSelfCalibration
    identity: Mapping[str, str] = field(default_factory=dict)


@contextmanager
def opened(parameters: DaqmxParameters) -> Iterator[DaqmxInstruments]:
    """Open and check the boards; at the end the coil is off and every task cleared."""
    chassis = Chassis(parameters)
    bench = Bench(chassis)
    try:
        chassis.refuse_made_up()
        yield DaqmxInstruments(
            digitizer=DaqmxDigitizer(bench),
            striker=DaqmxStriker(bench),
            self_calibrating=DaqmxSelfCalibration(bench),
            identity=chassis.identity(),
        )
    finally:
        chassis.close()
