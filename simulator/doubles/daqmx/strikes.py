"""Strikes: from a released coil to the counts of a record, with the twin behind the boards.

A strike belongs to a shot: the one that was announced for its position, or else the next one counted.
"""

from __future__ import annotations

import logging
import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from hardware_drivers.instruments import Acquired
from hardware_drivers.measurement import Calibration, ShotKey
from hardware_drivers.nanoseconds import NS_PER_S
from simulator.doubles.chassis.crosstalk import Crosstalk
from simulator.doubles.chassis.description import Description
from simulator.electronics.transduction import add_noise_volts
from simulator.errors import SimulatorError
from simulator.experiment.corrosion import make_patch
from simulator.numerics.arrays import FloatArray
from simulator.numerics.keyed_random import Purpose, keyed_generator
from simulator.parameters.electronics import AdcParameters
from simulator.shot.model import ShotModel
from simulator.specimen import Specimen, Transducer, build_specimen

log = logging.getLogger(__name__)

FALL_ACCELERATION_M_PER_S2 = 9.81
STRIKES_KEPT = 256
"""Only strikes still in flight matter; the ring is far longer."""

WAVE = AdcParameters()
"""Part of a wave that a record without a trigger shows: the usual record."""


@dataclass(slots=True, eq=False)
class Strike:
    """Strike in progress.

    Attributes
    ----------
    lifted_ns, released_ns
        When its coil was switched on and off.
    contact_ns
        When it meets the chain.
    """

    key: ShotKey
    hour_h: float
    announced: bool
    lifted_ns: int
    released_ns: int
    contact_ns: int
    cancelled: bool = False


class Strikes:
    """Strikes: the key of the next one, and its voltage at a sensor."""

    def __init__(self, description: Description) -> None:
        self._description = description
        self.specimen = _build_specimen(description)
        self._announced: dict[str, tuple[ShotKey, float]] = {}
        self._counted: dict[str, int] = {}
        self._hour_h = description.hour_h
        self._planned: deque[Strike] = deque(maxlen=STRIKES_KEPT)
        self._crosstalk = {name: wiring.crosstalk for name, wiring in description.transducers.items()}

    @property
    def planned(self) -> tuple[Strike, ...]:
        """Return the newest strikes, at most `STRIKES_KEPT`, in order, without cancelled ones."""
        return tuple(strike for strike in self._planned if not strike.cancelled)

    def announce(self, key: ShotKey, hour_h: float) -> None:
        """Set key and hour of the next strike, or pulse-echo record, at the key's position.

        The hour also applies to later ones that are not announced.

        Raises
        ------
        ValueError
            Nothing is wired to this position.
        """
        if key.position not in self.specimen.walls:
            names = ", ".join(self.specimen.walls) or "none"
            raise ValueError(f"nothing is wired to position {key.position!r}; there are: {names}")
        self._announced[key.position] = (key, hour_h)
        self._hour_h = hour_h

    def take_next_echo(self, position: str) -> tuple[ShotKey, float]:
        """Return key and hour of the next pulse-echo record at a position, and remove or count them.

        They are the announced ones, or the next in the count of sets at the present hour.
        """
        announced = self._announced.pop(position, None)
        if announced is not None:
            return announced
        index = self._counted.get(position, 0)
        self._counted[position] = index + 1
        return ShotKey(position=position, set_index=index, shot_index=0), self._hour_h

    def plan(self, position: str, lifted_ns: int, released_ns: int) -> Strike | None:
        """Plan the strike of a coil's pulse (ns); None if the pulse is too short to lift the striker.

        Its key is the announced one, which is used up, or the next in the count of shots. A short pulse is
        stored, too, for its crosstalk. Raise KeyError if no transducer has this position.
        """
        lift_s = self._description.transducers[position].lift_s
        if released_ns - lifted_ns < round(lift_s * NS_PER_S):
            # Nothing falls, but the coil was switched, which its sensor hears.
            nothing = ShotKey(position=position, set_index=0, shot_index=0)
            self._planned.append(
                Strike(
                    key=nothing,
                    hour_h=0.0,
                    announced=False,
                    lifted_ns=lifted_ns,
                    released_ns=released_ns,
                    contact_ns=released_ns,
                    cancelled=True,
                )
            )
            return None
        announced = self._announced.pop(position, None)
        key, hour_h = announced or (self._count_next_key(position), self._hour_h)
        strike = Strike(
            key=key,
            hour_h=hour_h,
            announced=announced is not None,
            lifted_ns=lifted_ns,
            released_ns=released_ns,
            contact_ns=released_ns + self._fall_time_ns(key, hour_h),
        )
        self._planned.append(strike)
        return strike

    def cut(self, strike: Strike, ns: int) -> None:
        """Switch the coil of a strike off early, at ``ns``; do nothing if it is off already.

        The striker falls now; if it had not been lifted, the strike is cancelled and its key is used again.
        """
        if strike.released_ns <= ns:
            return
        lift_s = self._description.transducers[strike.key.position].lift_s
        if ns - strike.lifted_ns >= round(lift_s * NS_PER_S):
            strike.contact_ns -= strike.released_ns - ns
            strike.released_ns = ns
            return
        strike.cancelled, strike.released_ns = True, max(ns, strike.lifted_ns)
        position = strike.key.position
        if strike.announced:
            self._announced.setdefault(position, (strike.key, strike.hour_h))
        else:
            self._counted[position] -= 1

    def _count_next_key(self, position: str) -> ShotKey:
        """Return the key of the next unannounced strike at a position, and increase its count of shots."""
        index = self._counted.get(position, 0)
        self._counted[position] = index + 1
        set_index, shot_index = divmod(index, self._description.shots_per_set)
        return ShotKey(position=position, set_index=set_index, shot_index=shot_index)

    def _fall_time_ns(self, key: ShotKey, hour_h: float) -> int:
        """Return the time in ns in which the striker of a shot falls freely from its drop height."""
        height_m = self.specimen.strike(key, hour_h).drop_height_m
        return round(math.sqrt(2.0 * height_m / FALL_ACCELERATION_M_PER_S2) * NS_PER_S)

    def record(self, strike: Strike, adc: AdcParameters, calibration: Calibration) -> Acquired | None:
        """Simulate a board's record of a strike with crosstalk; None if the wave does not trigger it.

        Parameters
        ----------
        calibration
            Polynomial from codes to V of the board in its range.

        Raises
        ------
        SimulatorError, ValueError
            The twin cannot compute this shot or this record.
        """
        crosstalk, pulses = self.crosstalk(strike.key.position), self.list_coil_pulses(strike.key.position)

        def stray(first_s: float, rate_hz: float, samples: int) -> FloatArray:
            """Compute the crosstalk in V, shape (samples,); ``first_s`` counts from the striker's contact."""
            return crosstalk.volts(pulses, strike.contact_ns + first_s * NS_PER_S, rate_hz, samples)

        disturbed = replace(self.specimen, stray=None if crosstalk.silent else stray)
        return self._simulate_board_record(disturbed, strike, adc, calibration)

    def _simulate_board_record(
        self, specimen: Specimen, strike: Strike, adc: AdcParameters, calibration: Calibration
    ) -> Acquired | None:
        """Simulate a strike's record with the converter of a board; None if the wave does not trigger it.

        Raise SimulatorError or ValueError as `record` does.
        """
        twin = replace(specimen.twin, adc=adc)
        through_board = replace(specimen, twin=twin, adc_calibration=calibration)
        return through_board.simulate_wave(strike.key, strike.hour_h)

    def simulate_free_volts(
        self, key: ShotKey, first_ns: int, adc: AdcParameters, calibration: Calibration
    ) -> FloatArray:
        """Simulate the untriggered voltage at a sensor's input in V, shape (record_samples,).

        It has noise if that is on, the waves of strikes as far as a usual record shows them, and crosstalk.
        Raise SimulatorError or ValueError if the twin cannot compute a wave.

        Parameters
        ----------
        key
            Position, and the key of the noise.
        first_ns
            Monotonic time of the first sample, ns.
        """
        twin, rate_hz = self.specimen.twin, adc.sample_rate_hz
        volts = np.zeros(adc.record_samples)
        if twin.noise.enabled:
            random = keyed_generator(twin.seed, Purpose.NOISE, key=key)
            add_noise_volts(volts, rate_hz, twin.noise, random)
        usual = rate_hz / WAVE.sample_rate_hz
        wave_adc = replace(
            adc,
            record_samples=round(WAVE.record_samples * usual),
            pretrigger_samples=round(WAVE.pretrigger_samples * usual),
            trigger_level_v=WAVE.trigger_level_v,
        )
        for strike in self.planned:
            begins = (strike.contact_ns - first_ns) / NS_PER_S * rate_hz
            if strike.key.position != key.position or not -wave_adc.record_samples < begins < volts.size:
                continue
            wave = self._simulate_board_record(self.specimen, strike, wave_adc, calibration)
            if wave is not None:
                begins += wave.truth["trigger_time_s"] * rate_hz
                _insert_wave(volts, wave.waveform.volts(), round(begins) - wave_adc.pretrigger_samples)
        crosstalk = self.crosstalk(key.position)
        if not crosstalk.silent:
            volts += crosstalk.volts(self.list_coil_pulses(key.position), first_ns, rate_hz, volts.size)
        return volts

    def crosstalk(self, position: str) -> Crosstalk:
        """Return the crosstalk from the coil at a position into its sensor; a silent one if none is set."""
        return self._crosstalk.get(position, Crosstalk())

    def disturb(self, position: str, crosstalk: Crosstalk) -> None:
        """Replace the crosstalk from the coil at a position into its sensor from now on."""
        self._crosstalk[position] = crosstalk

    def list_coil_pulses(self, position: str) -> list[tuple[int, int]]:
        """Return when the coil at a position was switched on and off, ns; only the newest are kept."""
        return [
            (strike.lifted_ns, strike.released_ns)
            for strike in self._planned
            if strike.key.position == position and strike.released_ns > strike.lifted_ns
        ]

    def warm_up(self) -> None:
        """Simulate one shot per position, so that no later one waits for compilation or the plate's model.

        Log a warning for a position that cannot be computed.
        """
        for position in self.specimen.transducers:
            key = ShotKey(position=position, set_index=0, shot_index=0)
            try:
                self.specimen.simulate_wave(key, self._hour_h)
            except (SimulatorError, ValueError) as error:
                # The same error answers the record that needs this position.
                log.warning("the twin cannot compute position %s: %s", position, error)


def _insert_wave(volts: FloatArray, wave: FloatArray, at: int) -> None:
    """Overwrite ``volts`` in place with a wave from index ``at`` (may be negative), as far as it fits."""
    first, last = max(at, 0), min(at + wave.size, volts.size)
    if first < last:
        volts[first:last] = wave[first - at : last - at]


def _build_specimen(description: Description) -> Specimen:
    """Build the specimen of a described chassis: one model per transducer, one wall per probe."""
    transducers = {
        position: Transducer(
            chain=wiring.chain,
            model=ShotModel(
                wiring.chain, wiring.plate, make_patch(description.twin, position, wiring.corrosion)
            ),
        )
        for position, wiring in description.transducers.items()
    }
    probed_thickness_m = {position: probe.thickness_m for position, probe in description.probes.items()}
    return build_specimen(description.twin, transducers=transducers, probed_thickness_m=probed_thickness_m)
