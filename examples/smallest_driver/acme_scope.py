"""Drive an Acme oscilloscope as a digitizer of solimon.

Only `open_acme` imports the maker's package `acme`: `solimon status` runs without it.
"""

from contextlib import contextmanager, suppress

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from hardware_drivers.errors import AcquisitionTimeoutError, ConfigurationError, ConnectionLostError
from hardware_drivers.instruments import Acquired, require_timeout
from hardware_drivers.kinds import Finding, Kind, Opened
from hardware_drivers.measurement import Calibration, Waveform

PRETRIGGER, SAMPLES, RATE_HZ, BITS = 1_000, 13_600, 10e6, 12


class AcmeParameters(BaseModel):
    """Parameters of an Acme oscilloscope."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    address: str
    """Name of the oscilloscope in the network."""
    range_v: float = Field(default=5.0, gt=0.0, le=20.0)
    """Input range, half of which the incident wave should fill."""
    trigger_level_v: float = 0.25
    """Voltage that triggers: a tenth of the incident wave."""


@contextmanager
def acme_call():
    """Raise the maker's errors as solimon's."""
    try:
        yield
    except OSError as error:
        raise ConnectionLostError(
            f"the oscilloscope does not respond ({error}); check power and network"
        ) from error


class AcmeDigitizer:
    """Record one waveform per shot."""

    def __init__(self, scope, parameters, positions):
        self.scope, self.parameters, self.positions = scope, parameters, positions
        self.armed = None

    def arm(self, key):
        """Start to wait for the trigger of this shot."""
        if key.position not in self.positions:
            raise ConfigurationError(f"no input for {key.position!r}; this one serves {self.positions}")
        if self.armed is not None:
            raise ConfigurationError(f"already armed for {self.armed}; read or disarm first")
        with acme_call():
            self.scope.arm(self.parameters.range_v, self.parameters.trigger_level_v, PRETRIGGER, SAMPLES)
        self.armed = key

    def read(self, timeout_s):
        """Return the waveform; nothing is armed afterwards, also after an error."""
        require_timeout(timeout_s)
        if self.armed is None:
            raise ConfigurationError("not armed; arm before the strike, then read")
        try:
            with acme_call():
                if not self.scope.wait(timeout_s):
                    raise AcquisitionTimeoutError(f"no trigger in {timeout_s:g} s; check trigger_level_v")
                counts = self.scope.codes()
        finally:
            self.disarm()
        range_v = self.parameters.range_v
        calibration = Calibration(
            coefficients_v=np.array([0.0, range_v / 2 ** (BITS - 1)]), resolution_bits=BITS, range_v=range_v
        )
        return Acquired(
            waveform=Waveform(
                counts=counts, sample_rate_hz=RATE_HZ, pretrigger_samples=PRETRIGGER, calibration=calibration
            )
        )

    def disarm(self):
        """Stop waiting; a scope that does not respond waits for nothing."""
        armed, self.armed = self.armed, None
        if armed is not None:
            with suppress(OSError):
                self.scope.stop()


@contextmanager
def open_acme(parameters, opening):
    """Open the oscilloscope for the positions that the configuration assigns to it."""
    import acme

    with acme_call():
        scope = acme.open(parameters.address)
    digitizer = AcmeDigitizer(scope, parameters, opening.serves["digitizer"])
    try:
        yield Opened(digitizer=digitizer, identity={"serial_number": scope.serial_number})
    finally:
        digitizer.disarm()
        scope.close()


def check_acme(parameters, opening):
    """Check it for `solimon doctor`; nothing is armed."""
    with open_acme(parameters, opening) as opened:
        yield Finding(subject="Acme", check="answers", state="ok", detail=opened.identity["serial_number"])


KIND = Kind(parameters=AcmeParameters, open=open_acme, check=check_acme)
