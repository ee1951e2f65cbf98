"""The drivers of serial instruments keep the contracts, on real pseudo terminals."""

import pytest
from support.serial_rig import NO_TERMINALS, SerialRig

from hardware_drivers.conformance.climate_probe_contract import ClimateProbeContract
from hardware_drivers.conformance.power_supply_contract import PowerSupplyContract

pytestmark = pytest.mark.skipif(bool(NO_TERMINALS), reason=NO_TERMINALS)


@pytest.fixture
def rig(tmp_path):
    with SerialRig(tmp_path) as rig:
        yield rig


class TestScpiPowerSupply(PowerSupplyContract):
    @pytest.fixture
    def supply(self, rig):
        # Front panel operation: the driver has not commanded it.
        link, supply = rig.instruments.supply_link, rig.instruments.supply
        link.do(lambda: [supply.answer("VOLT 5"), supply.answer("CURR 1"), supply.press_output_key(True)])
        return rig.supply


class TestScpiPowerSupplyWithNoise(TestScpiPowerSupply):
    @pytest.fixture
    def rig(self, tmp_path):
        # Noise of a bench supply's own meter: 1 mV and 0.1 mA.
        with SerialRig(tmp_path, noise_v=1e-3, noise_a=1e-4) as rig:
            yield rig


class TestScpiClimateProbe(ClimateProbeContract):
    @pytest.fixture
    def climate(self, rig):
        return rig.climate
