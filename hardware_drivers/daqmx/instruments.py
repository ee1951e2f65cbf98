"""Digitizer, striker and self-calibration of a rig on NI-DAQmx boards, behind the Protocols."""

from __future__ import annotations

import logging
import time
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager

from hardware_drivers.daqmx.chassis import Chassis
from hardware_drivers.daqmx.parameters import DaqmxParameters
from hardware_drivers.errors import ConfigurationError, InstrumentError
from hardware_drivers.instruments import Acquired, require_timeout
from hardware_drivers.kinds import Opened
from hardware_drivers.measurement import ShotKey

log = logging.getLogger(__name__)


class DaqmxBoards:
    """Boards of one chassis as a digitizer that samples each wave, and a striker that pulses one coil."""

    def __init__(self, chassis: Chassis) -> None:
        """Use the boards of an opened chassis; nothing is armed."""
        self._chassis = chassis
        self._armed: ShotKey | None = None
        self._lands_at = 0.0

    def arm(self, key: ShotKey) -> None:
        """Start the acquisition of a position; its pre-trigger fills from now on, or after the holdoff.

        Blocks until a striker of an earlier strike without a record has landed: its wave belongs to no shot.

        Raises
        ------
        ConfigurationError
            Already armed, a position without input here, or a call from another thread.
        BusyError, ConnectionLostError
            Another program holds the board, or it does not answer; nothing is armed.
        """
        chassis = self._chassis
        chassis.require_own_thread()
        wirings = chassis.parameters.transducers.items()
        _require_wired_position(
            key, "solitary-wave transducer", [name for name, wiring in wirings if wiring.digitizes]
        )
        if self._armed is not None:
            raise ConfigurationError(f"already armed for {self._armed}; read or disarm first")
        falling_s = self._lands_at - time.monotonic()
        if falling_s > 0.0:
            time.sleep(falling_s)
        with chassis.guard_operation():
            chassis.acquisition(key.position).start()
        self._armed = key

    def read(self, timeout_s: float) -> Acquired:
        """Wait for the record and disarm; after an error no task is left.

        A complete record is returned even if ending its acquisition fails; that is logged.

        Raises
        ------
        AcquisitionTimeoutError
            Nothing triggered within ``timeout_s``.
        ConfigurationError
            Not armed, a timeout that is not positive, or a call from another thread.
        ConnectionLostError
            The board does not answer; the next call takes a recovery step.
        """
        chassis = self._chassis
        chassis.require_own_thread()
        require_timeout(timeout_s)
        key, self._armed = self._armed, None
        if key is None:
            raise ConfigurationError("not armed; arm before the strike, then read")
        acquired = None
        try:
            with chassis.guard_operation():
                acquisition = chassis.acquisition(key.position)
                waveform = acquisition.read(timeout_s)
                settings = {**acquisition.settings, "driver_version": chassis.driver_version}
                acquired = Acquired(waveform=waveform, settings=settings)
                self._lands_at = 0.0
                chassis.reset_recovery()
                acquisition.stop()
        except InstrumentError as error:
            if acquired is None:
                raise
            # The record is complete; the next arm meets and reports what failed after it.
            log.warning("the record of %s is sound, but ending its acquisition failed: %s", key, str(error))
        return acquired

    def disarm(self) -> None:
        """Disarm and clear the tasks; harmless when not armed, and when the connection is lost.

        Raise ConfigurationError in another thread than the one that opened the boards.
        """
        self._chassis.require_own_thread()
        if self._armed is not None:
            self._armed = None
            self._chassis.clear_tasks()

    def strike(self, key: ShotKey) -> None:
        """Pulse the coil of a position once; on return it is off. In a dry run nothing moves.

        Raises
        ------
        ConfigurationError
            A position without counter here, another position is armed, or a call from another thread.
        AcquisitionTimeoutError, BusyError, ConnectionLostError
            The pulse failed: nothing is armed any more.
        """
        chassis, parameters = self._chassis, self._chassis.parameters
        chassis.require_own_thread()
        _require_wired_position(
            key, "striker", [name for name, wiring in parameters.transducers.items() if wiring.strikes]
        )
        armed = self._armed
        if armed is not None and armed.position != key.position:
            raise ConfigurationError(
                f"a strike at {key.position!r} while {armed.position!r} is armed goes unseen; disarm first"
            )
        if parameters.dry_run:
            return
        try:
            with chassis.guard_operation():
                chassis.coil(key.position).pulse()
        except BaseException:
            self._armed = None  # its acquisition was ended with the coil
            raise
        finally:
            self._lands_at = chassis.coil_off_at + parameters.fall_s + parameters.fall_margin_s

    def make_safe(self) -> None:
        """Switch off every coil that may be on, and disarm.

        Raise ConnectionLostError if a coil's state is unknown (its counter ends the pulse in any case),
        ConfigurationError in another thread.
        """
        self._chassis.require_own_thread()
        self._armed = None
        self._chassis.make_safe()

    def self_calibrate(self) -> Mapping[str, str]:
        """Calibrate every digitizer board; return date and temperature, as one text, by serial number.

        Raise ConfigurationError while armed or in another thread; other instrument errors are those of a
        record.
        """
        chassis = self._chassis
        chassis.require_own_thread()
        if self._armed is not None:
            raise ConfigurationError(f"armed for {self._armed}; calibrate between sets")
        with chassis.guard_operation():
            return chassis.self_calibrate()


def _require_wired_position(key: ShotKey, role: str, positions: Collection[str]) -> None:
    """Raise ConfigurationError unless the key's position is one of ``positions``, those wired for the role.

    The message lists them.
    """
    if key.position not in positions:
        raise ConfigurationError(
            f"no {role} at position {key.position!r}; there are: {', '.join(sorted(positions))}; wire it in "
            "[rig.daqmx.transducers]"
        )


@contextmanager
def open_daqmx(parameters: DaqmxParameters) -> Iterator[Opened]:
    """Find and check the boards, and yield the instruments; on exit the coil is off and no task is left.

    The thread that opens them is the only one that may call them.

    Raises
    ------
    ConfigurationError
        No driver, a board that cannot do what is asked, wiring that does not exist, or a simulated board
        without a dry run.
    BusyError
        Another program holds a board, named in the message.
    ConnectionLostError
        A board or the gRPC server is not there.
    """
    chassis = Chassis(parameters)
    try:
        chassis.require_real_boards()
        boards = DaqmxBoards(chassis)
        yield Opened(
            digitizer=boards,
            striker=boards,
            self_calibrating=boards,
            self_calibration_interval_h=parameters.self_calibration_interval_h,
            identity={**chassis.identity(), **({"dry_run": "yes"} if parameters.dry_run else {})},
            dry_run=parameters.dry_run,
        )
    finally:
        chassis.close()
