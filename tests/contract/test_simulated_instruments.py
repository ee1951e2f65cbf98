"""The twin's instruments keep the contracts of the real ones."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest

from hardware_drivers.conformance.digitizer_contract import DigitizerContract
from hardware_drivers.conformance.pulse_echo_unit_contract import PulseEchoUnitContract
from hardware_drivers.conformance.striker_contract import StrikerContract
from hardware_drivers.measurement import ShotKey
from simulator.clock import SimulatedClock
from simulator.instruments import build_bench
from simulator.parameters.chain import ChainParameters
from simulator.parameters.experiment import TwinParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.shot.model import ShotModel
from simulator.specimen import Transducer

EPOCH_NS = 1_704_067_200_000_000_000


def _the_next_three(key, utc_ns):
    for index in range(key.shot_index + 1, key.shot_index + 4):
        yield replace(key, shot_index=index), utc_ns


@pytest.fixture(params=["computed when read", "computed ahead"])
def bench(request):
    """Return two transducers on infinite plates, which need no reduction, and a probe."""
    chain = ChainParameters()
    model = ShotModel(chain, PlateParameters(model="infinite_kirchhoff"), CorrosionParameters())
    with ThreadPoolExecutor(max_workers=1) as executor:
        yield build_bench(
            TwinParameters(thinning={}),
            clock=SimulatedClock(EPOCH_NS),
            epoch_utc_ns=EPOCH_NS,
            transducers={name: Transducer(chain=chain, model=model) for name in ("C", "D")},
            probed_thickness_m={"A": 6.35e-3},
            strikes_after=_the_next_three,
            executor=executor if request.param == "computed ahead" else None,
        )


class Unwired:
    @pytest.fixture
    def unknown_key(self):
        return ShotKey(position="nowhere", set_index=0, shot_index=0)


class TestSimulatedDigitizer(Unwired, DigitizerContract):
    @pytest.fixture
    def digitizer(self, bench):
        return bench.digitizer

    @pytest.fixture
    def strike(self, bench):
        return bench.striker.strike

    @pytest.fixture
    def keys(self):
        return tuple(ShotKey(position="C", set_index=3, shot_index=i) for i in (0, 1))


class TestSimulatedStriker(Unwired, StrikerContract):
    @pytest.fixture
    def striker(self, bench):
        return bench.striker

    @pytest.fixture
    def coil_levels(self, bench):
        return lambda: [(event.position, event.energised) for event in bench.striker.coil_events]

    @pytest.fixture
    def keys(self):
        return tuple(ShotKey(position=name, set_index=0, shot_index=0) for name in ("C", "D"))


class TestSimulatedPulseEchoUnit(Unwired, PulseEchoUnitContract):
    @pytest.fixture
    def pulse_echo(self, bench):
        return bench.pulse_echo

    @pytest.fixture
    def keys(self):
        return tuple(ShotKey(position="A", set_index=i, shot_index=0) for i in (0, 1))
