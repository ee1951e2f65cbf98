"""Records of one input without a trigger, at rest or over a complete strike."""

from __future__ import annotations

from hardware_drivers.daqmx.chassis import Chassis
from hardware_drivers.daqmx.parameters import DaqmxParameters
from hardware_drivers.errors import ConfigurationError
from hardware_drivers.measurement import Waveform


class FreeInput:
    """Input of one sensor without a reference trigger: at rest, or over a complete strike.

    The thread that makes it is the only one that may call it.

    Parameters
    ----------
    parameters
        Not those of a rehearsal. A holdoff is left out: what it hides is what is looked for.
    timeout_s
        Longest wait for each record.

    Raises
    ------
    ConfigurationError
        A dry run, or a board that cannot do what is asked.
    InstrumentError
        As for a shot; from each call.
    """

    def __init__(self, parameters: DaqmxParameters, position: str, timeout_s: float) -> None:
        """Open and check the boards; raise as the class describes."""
        if parameters.dry_run:
            raise ConfigurationError("dry_run is true: no coil is ever energised; set it to false")
        self.position, self.parameters = position, parameters
        self._timeout_s = timeout_s
        self._chassis = Chassis(parameters)

    def record_quiet_input(self) -> Waveform:
        """Record the input at once, without a trigger and with the coil at rest, for the length of a shot.

        Raise InstrumentError as for a shot.
        """
        with self._chassis.guard_operation():
            acquisition = self._chassis.acquisition(self.position, "noise")
            acquisition.start()
            record = acquisition.read(self._timeout_s)
            acquisition.stop()
        return record

    def strike(self) -> Waveform:
        """Pulse the coil once and return the record of the complete strike; on return the coil is off.

        The first sample is taken as the coil goes on, which is `DaqmxParameters.pulse_s` before it goes off.
        Raise ConfigurationError for simulated boards, other instrument errors as for a shot.
        """
        self._chassis.require_real_boards()
        with self._chassis.guard_operation():
            acquisition = self._chassis.acquisition(self.position, "pulse")
            acquisition.start()
            self._chassis.coil(self.position, "pulse").pulse()
            record = acquisition.read(self._timeout_s)
            self._chassis.clear_tasks()
        return record

    def close(self) -> None:
        """Switch the coil off, clear every task and close the connection; repeated calls have no effect."""
        self._chassis.close()
