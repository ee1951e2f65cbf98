"""Thermometer and hygrometer with a text protocol: one number in response to one query."""

from __future__ import annotations

from hardware_drivers.measurement import ClimateReading
from hardware_drivers.serial_port.instrument import SerialInstrument
from hardware_drivers.serial_port.parameters import ClimateParameters

TEMPERATURE_RANGE_C = (-60.0, 200.0)
"""What air next to a specimen can have; without its sensor a probe often shows the end of its scale."""
HUMIDITY_RANGE = (0.0, 1.05)
"""Capacitive sensors read a little over 1 in fog."""


class ScpiClimateProbe(SerialInstrument[ClimateParameters]):
    """Climate probe with a text protocol; a `ClimateProbe` of the instrument Protocols."""

    def read(self, timeout_s: float) -> ClimateReading:
        """Measure temperature in degrees Celsius and relative humidity, 0 to 1 (up to 1.05 is read as 1).

        The port is opened if necessary. The stamp is read before the temperature.

        Raises
        ------
        BusyError
            Another program owns the port.
        ConfigurationError
            Another instrument is there, the port cannot be opened as configured, or a timeout not above 0.
        ConnectionLostError
            The probe does not answer in time, or reports values that air cannot have.
        """
        deadline_s = self._deadline_s(timeout_s)
        parameters = self._parameters
        self._connect(deadline_s)
        stamp = self._stamp()
        temperature_c = self._line.query_number(
            parameters.temperature_query, deadline_s, units=("C", "degC", "CEL")
        )
        percent = ("%", "%RH", "PCT") if parameters.humidity_unit == "percent" else ()
        humidity = self._line.query_number(parameters.humidity_query, deadline_s, units=percent)
        if parameters.humidity_unit == "percent":
            humidity /= 100.0
        for name, value, (low, high) in (
            ("a temperature in degrees Celsius", temperature_c, TEMPERATURE_RANGE_C),
            (f"a relative humidity (reported in {parameters.humidity_unit})", humidity, HUMIDITY_RANGE),
        ):
            if not low <= value <= high:
                raise self._line.mark_lost(
                    f"reports {value:g} as {name}; it must be in {low:g}..{high:g}: check its sensor and unit"
                )
        return ClimateReading(stamp=stamp, temperature_c=temperature_c, relative_humidity=min(humidity, 1.0))
