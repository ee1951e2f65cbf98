"""Pulse-echo unit: ultrasonic probes behind pulser-receivers, digitised by NI-SCOPE boards.

The pulser fires by itself and sends a sync with each firing; the board records from the firing pulse on.
One acquisition takes ``averages`` records, which are summed in whole counts (`averaging`).
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping

import numpy as np

from hardware_drivers.errors import ConfigurationError
from hardware_drivers.instruments import Echo, require_timeout
from hardware_drivers.measurement import ShotKey, Waveform
from hardware_drivers.niscope.averaging import AveragedRecord, sum_records
from hardware_drivers.niscope.connection import BoardConnection
from hardware_drivers.niscope.parameters import NiscopeParameters, ProbeWiring
from hardware_drivers.niscope.session import Board, Fetched, Setup, import_niscope, read_package_version


class NiscopePulseEchoUnit:
    """Ultrasonic probes by their positions; a `PulseEchoUnit`, and `SelfCalibrating`.

    Made by `open_niscope`. All calls come from one thread.
    """

    def __init__(self, parameters: NiscopeParameters, connections: Mapping[str, BoardConnection]) -> None:
        """Use opened connections, given by the resource name of their board."""
        self._parameters = parameters
        self._connections = connections

    def acquire(self, key: ShotKey, timeout_s: float) -> Echo:
        """Record one averaged echo of a position; the pulser fires by itself.

        Parameters
        ----------
        timeout_s
            Longest wait for all records, or ``call_timeout_s`` if that is shorter.

        Returns
        -------
        Echo
            int32 counts: the sum of ``averages`` records, with the calibration of their mean.

        Raises
        ------
        ConfigurationError
            No such position, the timeout is not positive, or the board cannot do what is asked.
        AcquisitionTimeoutError
            The pulser's sync did not come often enough.
        BusyError
            Another program uses the board.
        ConnectionLostError
            The board does not answer; the next call takes the next recovery step.
        """
        require_timeout(timeout_s)
        wiring = self._parameters.probes.get(key.position)
        if wiring is None:
            raise ConfigurationError(
                f"no ultrasonic probe at position {key.position!r}; there are: "
                f"{', '.join(sorted(self._parameters.probes))}"
            )
        board, setup, fetched, warned = self._connections[wiring.resource].acquire(
            key.position, wiring, min(timeout_s, self._parameters.call_timeout_s)
        )
        averaged = sum_records(
            fetched.records,
            gain_v=fetched.gain_v,
            offset_v=fetched.offset_v,
            codes=fetched.codes,
            range_v=setup.range_v,
            calibration_date=setup.calibration_date,
        )
        waveform = Waveform(
            counts=averaged.counts,
            sample_rate_hz=setup.sample_rate_hz,
            pretrigger_samples=0,
            calibration=averaged.calibration,
        )
        return Echo(
            waveform=waveform,
            gain_db=wiring.gain_db,
            offset_v=setup.offset_v,
            averages=setup.records,
            settings=_collect_settings(wiring, board, setup, fetched, averaged, warned),
        )

    def self_calibrate(self) -> Mapping[str, str]:
        """Run the self-calibration of each board once, and configure it again.

        Returns
        -------
        Mapping
            By serial number: date and temperature of the calibration as the board reports them, as one text.

        Raises
        ------
        BusyError, ConnectionLostError, ConfigurationError
            As `acquire`; the remaining boards are not calibrated.
        """
        done = {}
        for position, wiring in self._parameters.probes.items():
            connection = self._connections[wiring.resource]
            serial_number = connection.self_calibrate().serial_number if wiring.resource not in done else ""
            if serial_number:
                _, setup = connection.prepare(position, wiring)
                done[wiring.resource] = (
                    serial_number,
                    f"{setup.calibration_date}, {setup.calibration_temperature_c:.2f} C",
                )
        return dict(done.values())

    def identity(self) -> Mapping[str, str]:
        """Return versions and boards as stored with every set, by name of the item.

        ``niscope`` and ``ni_scope`` are the versions of package and driver; ``probe_NAME`` is product,
        serial number, resource and channel. A probe whose board was never opened is left out.
        """
        named = {"niscope": read_package_version()}
        for position, wiring in self._parameters.probes.items():
            board = self._connections[wiring.resource].board
            if board is not None:
                named["ni_scope"] = board.driver_version
                named[f"probe_{position}"] = (
                    f"{board.product} {board.serial_number} at {board.resource}, channel {wiring.channel}"
                )
        return named

    def serial_number(self, position: str) -> str:
        """Return the serial number that a position's board reported; empty if it was never opened.

        KeyError for a position without a probe.
        """
        board = self._connections[self._parameters.probes[position].resource].board
        return "" if board is None else board.serial_number


@contextlib.contextmanager
def open_niscope(parameters: NiscopeParameters) -> Iterator[NiscopePulseEchoUnit]:
    """Open the boards of all probes, configure each probe once, and yield the unit; close all on exit.

    So a wrong value of any probe shows at the start.

    Raises
    ------
    ConfigurationError
        The `niscope` package or the NI-SCOPE runtime is not installed, a board is not there, or it cannot
        do what is asked.
    BusyError, ConnectionLostError
        Another program uses a board, or it does not answer.
    """
    niscope = import_niscope()
    with contextlib.ExitStack() as stack:
        connections: dict[str, BoardConnection] = {}
        for position, wiring in parameters.probes.items():
            if wiring.resource not in connections:
                connections[wiring.resource] = BoardConnection(niscope, parameters, wiring)
                stack.callback(connections[wiring.resource].close)
            connections[wiring.resource].prepare(position, wiring)
        yield NiscopePulseEchoUnit(parameters, connections)


def _collect_settings(
    wiring: ProbeWiring, board: Board, setup: Setup, fetched: Fetched, averaged: AveragedRecord, warned: str
) -> dict[str, float | str]:
    """Collect the settings stored with a record by name, with SI units in the names.

    They are board, versions, input, trigger, times of the first samples (mean and spread), gain, clipped
    records and calibration; ``driver_warnings`` only if the driver warned.
    """
    settings: dict[str, float | str] = {
        "board_serial": board.serial_number,
        "product": board.product,
        "resource": board.resource,
        "channel": wiring.channel,
        "driver_version": board.driver_version,
        "niscope_version": read_package_version(),
        "range_v": setup.range_v,
        "resolution_bits": float(setup.resolution_bits),
        "input_impedance_ohm": float(wiring.input_impedance_ohm),
        "bandwidth_hz": wiring.bandwidth_hz,
        "coupling": wiring.coupling,
        "trigger_source": wiring.trigger_source,
        "trigger_level_v": wiring.trigger_level_v,
        "firing_delay_s": wiring.firing_delay_s,
        "first_sample_s": float(fetched.first_sample_s.mean()),
        "first_sample_spread_s": float(np.ptp(fetched.first_sample_s)),
        "record_gain_v_per_count": fetched.gain_v,
        "record_offset_v": fetched.offset_v,
        "clipped_records": float(averaged.clipped_records),
        "calibration_date": setup.calibration_date,
        "calibration_temperature_c": setup.calibration_temperature_c,
    }
    if warned:
        settings["driver_warnings"] = warned
    return settings
