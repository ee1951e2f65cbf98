"""Parameters refuse what cannot be, with the value and the limit in the message."""

import pytest

from simulator.parameters.electronics import AdcParameters
from simulator.parameters.experiment import (
    PAPER_THINNING,
    DriftParameters,
    EchoParameters,
    ScatterParameters,
    ThinningParameters,
    TwinParameters,
)


@pytest.mark.parametrize(
    ("parameters", "values", "message"),
    [
        (ThinningParameters, {"depth_fraction": 0.96}, "depth_fraction is 0.96"),
        (ThinningParameters, {"unevenness": 1.0}, "unevenness is 1.0; it must be less than 1.0"),
        (ThinningParameters, {"onset_h": 300.0, "reference_h": 300.0}, "later than onset_h"),
        (ThinningParameters, {"onset_h": 24.0, "hole_h": 20.0}, "hole_h is 20.0 h"),
        (ThinningParameters, {"hole_h": float("nan")}, "hole_h is nan"),
        (
            ThinningParameters,
            {"history": ((0.0, 0.3), (10.0, 0.2))},
            r"depth 0.2 at hour 10.0, less than 0.3 at hour 0.0: a wall does not heal",
        ),
        (ThinningParameters, {"history": ((5.0, 0.1), (5.0, 0.2))}, "hour 5.0 after hour 5.0"),
        (ThinningParameters, {"history": ((0.0, 0.96),)}, "depth 0.96 at hour 0.0"),
        (ThinningParameters, {"history": ((float("nan"), 0.1),)}, "has hour nan"),
        (ThinningParameters, {"history": ((0.0, float("nan")),)}, "has depth nan at hour 0.0"),
        (ThinningParameters, {"history": ((0.0, 0.1),), "depth_fraction": 0.2}, "one law of thinning"),
        (ScatterParameters, {"scale": -1.0}, "scale is -1.0; it must be at least 0.0"),
        (
            DriftParameters,
            {"shortest_wander_h": 50.0, "longest_wander_h": 40.0},
            "longest_wander_h is 40.0 h",
        ),
        (AdcParameters, {"pretrigger_samples": 13_600}, "pretrigger_samples is 13600"),
        (AdcParameters, {"trigger_level_v": 5.0}, "trigger_level_v is 5.0 V"),
        (AdcParameters, {"resolution_bits": 25}, "resolution_bits is 25"),
        (EchoParameters, {"centre_frequency_hz": 50e6}, "centre_frequency_hz is 50000000.0 Hz"),
        (TwinParameters, {"seed": 2**32}, "seed is 4294967296"),
        (TwinParameters, {"update_interval_s": 0.0}, "update_interval_s is 0.0"),
    ],
)
def test_a_value_out_of_bounds_is_named(parameters, values, message):
    with pytest.raises(ValueError, match=message):
        parameters(**values)


def test_the_default_twin_is_the_papers_experiment():
    assert dict(TwinParameters().thinning) == dict(PAPER_THINNING)
    assert set(PAPER_THINNING) == {"A", "B", "C", "D"}
