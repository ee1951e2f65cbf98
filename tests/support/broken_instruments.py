"""Instruments without hardware: sound ones, and others that break their contract in one place."""

from dataclasses import replace

import numpy as np

from hardware_drivers.errors import AcquisitionTimeoutError, ConfigurationError, InstrumentError
from hardware_drivers.instruments import Acquired, require_timeout
from hardware_drivers.measurement import Calibration, ShotKey, Waveform

KEYS = tuple(ShotKey(position="C", set_index=0, shot_index=i) for i in (0, 1))
UNKNOWN = ShotKey(position="nowhere", set_index=0, shot_index=0)


def waveform(samples=20, pretrigger=5):
    return Waveform(
        counts=np.arange(samples, dtype=np.int16),
        sample_rate_hz=1e7,
        pretrigger_samples=pretrigger,
        calibration=Calibration(coefficients_v=np.array([0.0, 5.0 / 2**15]), resolution_bits=16, range_v=5.0),
    )


class SoundDigitizer:
    """Digitizer that keeps the contract; each subclass below breaks one rule."""

    def __init__(self):
        self.armed = None
        self.struck = False
        self.records = 0

    def strike(self, key):
        self.struck = self.armed is not None

    def arm(self, key):
        if key.position != "C" or self.armed is not None:
            raise ConfigurationError(f"cannot arm {key.position}")
        self.armed, self.struck = key, False

    def read(self, timeout_s):
        require_timeout(timeout_s)
        if self.armed is None:
            raise ConfigurationError("not armed")
        struck = self.struck
        self.disarm()
        if not struck:
            raise AcquisitionTimeoutError("nothing came")
        self.records += 1
        return self.record()

    def record(self):
        return Acquired(waveform=waveform())

    def disarm(self):
        self.armed, self.struck = None, False


class ArmsAnything(SoundDigitizer):
    def arm(self, key):
        super().arm(KEYS[0])


class ArmsOverAnArmedOne(SoundDigitizer):
    def arm(self, key):
        self.armed = None
        super().arm(key)


class StaysArmedAfterReading(SoundDigitizer):
    def read(self, timeout_s):
        armed = self.armed
        acquired = super().read(timeout_s)
        self.armed = armed
        return acquired


class StaysArmedAfterTimeout(SoundDigitizer):
    def read(self, timeout_s):
        armed = self.armed
        try:
            return super().read(timeout_s)
        except AcquisitionTimeoutError:
            self.armed = armed
            raise


class InventsRecords(SoundDigitizer):
    def read(self, timeout_s):
        self.struck = self.struck or self.armed is not None
        return super().read(timeout_s)


class ReadsUnarmed(SoundDigitizer):
    def read(self, timeout_s):
        self.armed, self.struck = KEYS[0], True
        return super().read(timeout_s)


class RemembersStrikes(SoundDigitizer):
    def __init__(self):
        super().__init__()
        self.heard = False

    def strike(self, key):
        self.heard = True

    def arm(self, key):
        super().arm(key)
        self.struck = self.heard

    def disarm(self):
        self.armed = None


class GrowingRecords(SoundDigitizer):
    def record(self):
        return Acquired(waveform=waveform(samples=20 + self.records))


class CodesBeyondTheResolution(SoundDigitizer):
    def record(self):
        sound = waveform()
        coefficients_v = np.array([0.0, 5.0 / 128])
        return Acquired(
            waveform=replace(
                sound,
                counts=sound.counts * np.int16(10),
                calibration=Calibration(coefficients_v=coefficients_v, resolution_bits=8, range_v=5.0),
            )
        )


class CountsInMillivolts(SoundDigitizer):
    def record(self):
        sound = waveform()
        return Acquired(waveform=replace(sound, calibration=replace(sound.calibration, range_v=5000.0)))


class SettingsOfLists(SoundDigitizer):
    def record(self):
        return Acquired(waveform=waveform(), settings={"channels": [0, 1]})


class TakesAnyTime(SoundDigitizer):
    def read(self, timeout_s):
        return super().read(timeout_s or 1.0)


class NoPretrigger(SoundDigitizer):
    def record(self):
        return Acquired(waveform=waveform(pretrigger=0))


class DisarmsOnce(SoundDigitizer):
    def disarm(self):
        if self.armed is None:
            raise ConfigurationError("not armed")
        super().disarm()


class SoundStriker:
    def __init__(self):
        self.levels = []

    def strike(self, key):
        if key == UNKNOWN:
            raise ConfigurationError(f"no striker at {key.position}")
        self.levels += [(key.position, True), (key.position, False)]

    def make_safe(self):
        pass


class LeavesTheCoilOn(SoundStriker):
    def strike(self, key):
        super().strike(key)
        self.levels.pop()


class StrikesTwice(SoundStriker):
    def strike(self, key):
        super().strike(key)
        super().strike(key)


class StrikesAnotherCoil(SoundStriker):
    def strike(self, key):
        super().strike(KEYS[0])


class MovesBeforeItRefuses(SoundStriker):
    def strike(self, key):
        self.levels += [("C", True), ("C", False)] if key == UNKNOWN else []
        super().strike(key)


class IsSafeOnce(SoundStriker):
    safe = False

    def make_safe(self):
        if self.safe:
            raise InstrumentError("already safe")
        self.safe = True


class EndsWhenSafe(SoundStriker):
    def make_safe(self):
        self.strike = lambda key: None


class SafeByAPulse(SoundStriker):
    def make_safe(self):
        self.levels.append(("C", True))
