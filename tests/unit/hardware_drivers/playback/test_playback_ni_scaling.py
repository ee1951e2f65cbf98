"""NI's scales as one polynomial; npTDMS's own scaling is the reference."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from nptdms.scaling import get_scaling
from support.labview_files import polynomial

from hardware_drivers.playback.ni_scaling import ScalingError, build_raw_polynomial

RAW = 0xFFFFFFFF


def linear(slope, intercept, *, scale=0, source=RAW):
    prefix = f"NI_Scale[{scale}]_"
    return {
        f"{prefix}Scale_Type": "Linear",
        f"{prefix}Linear_Slope": slope,
        f"{prefix}Linear_Y_Intercept": intercept,
        f"{prefix}Linear_Input_Source": source,
    }


def operation(kind, left, right, *, scale):
    prefix = f"NI_Scale[{scale}]_"
    return {
        f"{prefix}Scale_Type": kind,
        f"{prefix}{kind}_Left_Operand_Input_Source": left,
        f"{prefix}{kind}_Right_Operand_Input_Source": right,
    }


class RawData:
    """Raw data that npTDMS scales."""

    def __init__(self, data):
        self.data = data
        self.scaler_data = {}


def scaled_by_nptdms(properties, raw):
    return get_scaling(properties, {}, {}).scale(RawData(raw))


COEFFICIENTS = st.lists(st.floats(-2.0, 2.0), min_size=2, max_size=4)


@given(coefficients=COEFFICIENTS)
@example(coefficients=[-0.0, 1e-300, -0.0])
def test_a_single_polynomial_keeps_its_coefficients_to_the_last_bit(coefficients):
    found = build_raw_polynomial({"NI_Number_Of_Scales": 1} | polynomial(coefficients))
    assert found.tobytes() == np.array(coefficients).tobytes()


@given(slope=st.floats(-2.0, 2.0), intercept=st.floats(-2.0, 2.0))
def test_a_single_linear_scale_keeps_its_bits_too(slope, intercept):
    assert build_raw_polynomial(linear(slope, intercept)).tobytes() == np.array([intercept, slope]).tobytes()


@given(first=COEFFICIENTS, slope=st.floats(-2.0, 2.0), intercept=st.floats(-2.0, 2.0), third=COEFFICIENTS)
def test_a_chain_is_what_npTDMS_computes(first, slope, intercept, third):  # noqa: N802
    properties = (
        polynomial(first, scale=0)
        | linear(slope, intercept, scale=1, source=0)
        | polynomial(third, scale=2, source=1)
    )
    raw = np.linspace(-1.5, 1.5, 41)
    found = np.polynomial.polynomial.polyval(raw, build_raw_polynomial(properties))
    wanted = scaled_by_nptdms(properties, raw)
    # Order 9 in numbers up to 2: sums of some 1e6 with 50 operations of 1.1e-16 each.
    assert np.abs(found - wanted).max() <= 1e-8


@pytest.mark.parametrize("kind", ["Add", "Subtract"])
def test_sums_and_differences_are_what_npTDMS_computes(kind):  # noqa: N802
    properties = (
        linear(2.0, 0.25, scale=0) | polynomial([0.5, 1.0, 4.0], scale=1) | operation(kind, 0, 1, scale=2)
    )
    raw = np.linspace(-1.0, 1.0, 9)
    found = np.polynomial.polynomial.polyval(raw, build_raw_polynomial(properties))
    # Small binary fractions: both are exact.
    assert found.tolist() == scaled_by_nptdms(properties, raw).tolist()


def test_scaling_information_written_again_in_a_loop_counts_once():
    """A loop that creates the scaling with every write numbers the copies on; each reads the codes."""
    properties = linear(2.0, 1.0, scale=0) | linear(2.0, 1.0, scale=1) | linear(2.0, 1.0, scale=2)
    assert build_raw_polynomial(properties).tolist() == [1.0, 2.0]


def test_a_scaler_of_daqmx_hands_over_the_codes():
    properties = {"NI_Number_Of_Scales": 2} | polynomial([0.5, 2.0], scale=1, source=0)
    assert build_raw_polynomial(properties).tolist() == [0.5, 2.0]


def test_the_advanced_api_hands_over_its_input():
    advanced = {"NI_Scale[1]_Scale_Type": "AdvancedAPI", "NI_Scale[1]_AdvancedAPI_Input_Source": 0}
    assert build_raw_polynomial(linear(2.0, 1.0) | advanced).tolist() == [1.0, 2.0]


@pytest.mark.parametrize("properties", [{}, {"NI_Number_Of_Scales": 0}, {"name": "x"}])
def test_no_scales_are_no_polynomial(properties):
    assert build_raw_polynomial(properties) is None


def test_values_scaled_before_have_no_scales():
    assert build_raw_polynomial(linear(2.0, 1.0) | {"NI_Scaling_Status": "scaled"}) is None
    assert build_raw_polynomial(linear(2.0, 1.0) | {"NI_Scaling_Status": "unscaled"}) is not None


@pytest.mark.parametrize(
    ("properties", "message"),
    [
        ({"NI_Scale[0]_Scale_Type": "Thermocouple"}, "scale 0 is of type 'Thermocouple'"),
        (linear(2.0, 1.0, source=0), "input from scale 0, which is not before it"),
        (linear(2.0, 1.0, source=5), "input from scale 5, which is not before it"),
        ({"NI_Scale[0]_Scale_Type": "Linear"}, r"NI_Scale\[0\]_Linear_Y_Intercept is missing"),
        (linear("two", 1.0), r"Linear_Slope is 'two', no number"),
        (linear(float("nan"), 1.0), "not finite"),
        (polynomial([1.0]), "the scaling is a constant"),
        (polynomial([]), "the scaling is a constant"),
        (
            polynomial([0.0] * 7, scale=0) | polynomial([0.0] * 7, scale=1, source=0),
            "compose to an order above 32",
        ),
    ],
)
def test_a_scaling_without_a_polynomial_gives_the_reason(properties, message):
    with pytest.raises(ScalingError, match=message):
        build_raw_polynomial(properties)
