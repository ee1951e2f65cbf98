"""Climate next to the specimen, logged at intervals."""

from __future__ import annotations

import logging
from dataclasses import replace

from daq_service.catalogue.rows import EnvironmentRow, ReadingQuality
from daq_service.corrosion_drive.drive import DriveCondition
from daq_service.corrosion_drive.reading_log import ReadingLog
from hardware_drivers.drive_parameters import LogParameters
from hardware_drivers.errors import InstrumentError
from hardware_drivers.instruments import ClimateProbe, Clock
from hardware_drivers.measurement import ClimateReading
from hardware_drivers.nanoseconds import NS_PER_S

log = logging.getLogger(__name__)


class ClimateLog:
    """Reads the probe and rates its newest reading."""

    def __init__(self, probe: ClimateProbe, clock: Clock, parameters: LogParameters) -> None:
        """Schedule the first reading for now; the probe is not read here."""
        self._probe, self._clock, self._parameters = probe, clock, parameters
        self._log = ReadingLog(parameters.log_interval_s, clock.mono_ns())
        self._reading: ClimateReading | None = None
        self._changed_ns = clock.mono_ns()

    def tick(self) -> None:
        """Read the climate probe if a reading is due, which blocks up to its timeout; else do nothing.

        An instrument error is logged as a warning, not raised.
        """
        now_ns = self._clock.mono_ns()
        if not self._log.is_due(now_ns):
            return
        self._log.record_attempt(now_ns)
        try:
            reading = self._probe.read(self._parameters.read_timeout_s)
        except InstrumentError as error:
            log.warning("climate: %s", error)
            self._log.error = str(error)
        else:
            now_ns = self._clock.mono_ns()
            if self._reading is None or _read_climate_values(reading) != _read_climate_values(self._reading):
                self._changed_ns = now_ns
            self._reading = reading
            self._log.record_success(now_ns)

    def quality(self) -> ReadingQuality:
        """Return the quality of the newest reading: that of `ReadingLog.quality`, or ``suspect``.

        ``suspect`` replaces ``good`` if temperature and humidity have not changed for ``suspect_after_s``.
        """
        now_ns = self._clock.mono_ns()
        quality = self._log.quality(now_ns)
        unchanged_s = (now_ns - self._changed_ns) / NS_PER_S
        return "suspect" if quality == "good" and unchanged_s >= self._parameters.suspect_after_s else quality

    def build_condition(self) -> DriveCondition:
        """Return the condition of a probe without communication: time in s without a reading, last error."""
        silent_s = self._log.silent_s(self._clock.mono_ns())
        return DriveCondition(
            name="climate_not_responding",
            active=self.quality() == "no_communication",
            values={"silent_s": silent_s, "read_error": self._log.error or None},
        )

    def add_climate_to_row(self, row: EnvironmentRow) -> EnvironmentRow:
        """Return a copy of an environment row with the newest climate reading, its quality and age in s.

        Temperature, humidity and age are None without a reading.
        """
        now_ns, reading = self._clock.mono_ns(), self._reading
        return replace(
            row,
            climate_quality=self.quality(),
            climate_age_s=self._log.age_s(now_ns),
            temperature_c=None if reading is None else reading.temperature_c,
            relative_humidity=None if reading is None else reading.relative_humidity,
        )


def _read_climate_values(reading: ClimateReading) -> tuple[float, float]:
    """Return temperature (degrees Celsius) and relative humidity (0 to 1) of a reading, to be compared."""
    return reading.temperature_c, reading.relative_humidity
