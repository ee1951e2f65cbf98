"""Pulser-receivers behind the NI-SCOPE double: their firings, and the boards' records of them."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware_drivers.measurement import Calibration, ShotKey
from simulator.doubles.chassis.description import ProbeWiring
from simulator.doubles.chassis.scopes import ScopeParameters
from simulator.doubles.niscope.records import RecordShape, simulate_records
from simulator.doubles.niscope.session import Acquisition, Channel, Session
from simulator.electronics.transduction import quantise_volts
from simulator.specimen import Specimen

WAVEFORM_INFO = "<dddi4xdddd"
"""`struct` layout of one ``niScope_wfmInfo``: absolute and relative initial x, x increment, actual samples,
offset, gain, two reserved."""

NextEcho = Callable[[str], tuple[ShotKey, float]]
"""Which shot and hour the next acquisition at a position is."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FetchedWaveform:
    """Record of one channel as a fetch returns it.

    Attributes
    ----------
    samples
        Padded codes, shape (n_samples,).
    info
        Its packed ``niScope_wfmInfo``.
    overloaded
        A code lies at an end of the ADC's range.
    """

    samples: NDArray[np.int32]
    info: bytes
    overloaded: bool


class Pulsers:
    """Probes of a rig and the boards their receivers are wired to."""

    def __init__(
        self,
        probes: Mapping[str, ProbeWiring],
        boards: Sequence[ScopeParameters],
        specimen: Specimen,
        next_echo: NextEcho,
    ) -> None:
        serial_numbers = {board.name: board.serial_number for board in boards}
        self._probes = dict(probes)
        # A probe's cable stays with its board, whatever the board is called later.
        self._wired_to = {position: serial_numbers[probe.resource] for position, probe in probes.items()}
        self._specimen = specimen
        self._next_echo = next_echo

    def begin(self, session: Session, now_s: float) -> Acquisition:
        """Start an acquisition at a monotonic time in s; its records follow the next firings of the pulser.

        Without a probe that triggers the board it is never done (infinite times).
        """
        shape = RecordShape(
            sample_rate_hz=session.rate_hz,
            samples=session.samples,
            records=session.records,
            trigger_delay_s=session.trigger_delay_s,
        )
        position = self._find_triggering_position(session)
        if not position:
            return Acquisition(done_s=math.inf, position="", shape=shape, first_firing_s=math.inf)
        period_s = 1.0 / self._probes[position].repetition_hz
        # The pulser runs on its own: the next whole number of periods.
        first_s = (math.floor(now_s / period_s) + 1) * period_s
        record_s = session.trigger_delay_s + session.samples / session.rate_hz
        return Acquisition(
            done_s=first_s + (session.records - 1) * period_s + record_s,
            position=position,
            shape=shape,
            first_firing_s=first_s,
        )

    def _find_triggering_position(self, session: Session) -> str:
        """Return the position of the first probe whose sync signal triggers the session; empty if none does.

        The pulser must be on and wired to an enabled channel and the trigger source; an analog level (V) must
        be between 0 and the height of the sync pulse.
        """
        enabled = [name for name, channel in session.channels.items() if channel.enabled]
        for position, probe in self._probes.items():
            wired = self._wired_to[position] == session.board.serial_number and probe.channel in enabled
            digital = session.trigger_source.startswith("VAL_PFI")
            crossed = digital or 0.0 < session.trigger_level_v < probe.sync_v
            if wired and probe.switched_on and probe.sync_terminal == session.trigger_source and crossed:
                return position
        return ""

    def waveform(
        self, session: Session, running: Acquisition, record: int, channel: tuple[str, Channel], wanted: int
    ) -> FetchedWaveform:
        """Return one record of a channel, at most ``wanted`` samples, as padded codes with their scaling.

        Parameters
        ----------
        record
            Index of the record in the acquisition; IndexError after the last.
        channel
            Name and settings.
        """
        name, settings = channel
        calibration = session.board.calibration(0.5 * settings.range_pp_v, settings.offset_v)
        codes = self._get_codes(running, name, calibration)[record, :wanted]
        low, high = calibration.full_scale_counts
        offset_v, gain_v = calibration.coefficients_v
        padding, shape = session.board.padding, running.shape
        fired_s = running.first_firing_s + record / self._probes[running.position].repetition_hz
        info: tuple[Any, ...] = (
            fired_s + shape.trigger_delay_s,
            shape.trigger_delay_s,
            1.0 / shape.sample_rate_hz,
            codes.size,
            float(offset_v),
            float(gain_v) / padding,
            0.0,
            0.0,
        )
        return FetchedWaveform(
            samples=codes * padding,
            info=struct.pack(WAVEFORM_INFO, *info),
            overloaded=bool(codes.min(initial=0) <= low or codes.max(initial=0) >= high),
        )

    def _get_codes(self, running: Acquisition, channel: str, calibration: Calibration) -> NDArray[np.int32]:
        """Return the unpadded codes of all records of a channel, shape (records, samples).

        They are simulated once per acquisition, which uses up the announced shot. A channel without the probe
        is a grounded input.
        """
        probe = self._probes[running.position]
        if probe.channel != channel:
            quiet = quantise_volts(np.zeros((running.shape.records, running.shape.samples)), calibration)
            return quiet.astype(np.int32)
        if running.codes is None:
            key, hour_h = self._next_echo(running.position)
            running.codes = simulate_records(self._specimen, probe, running.shape, calibration, key, hour_h)
        return running.codes
