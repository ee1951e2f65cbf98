"""Piecewise polynomials along an axis: what they hold exactly, and where graded lines lie."""

import numpy as np
import pytest

from simulator.numerics.tensor_basis import Axis, lobatto_points, make_graded_breaks_m

AXIS = Axis(breaks_m=np.array([0.0, 0.5, 2.0, 2.25]), degrees=(2, 4, 3))


def test_nodes_are_shared_between_intervals_and_numbered_along_the_axis():
    assert AXIS.first.tolist() == [0, 2, 6, 9]
    assert len(AXIS.nodes_m) == 10
    assert np.all(np.diff(AXIS.nodes_m) > 0.0)
    assert AXIS.nodes_m[[0, 2, 6, 9]].tolist() == [0.0, 0.5, 2.0, 2.25]
    assert AXIS.nodes_of(1).tolist() == [2, 3, 4, 5, 6]


def test_lobatto_points_of_degree_three():
    np.testing.assert_allclose(lobatto_points(3), [-1.0, -np.sqrt(0.2), np.sqrt(0.2), 1.0], atol=1e-15)


def test_functions_are_one_at_their_node_and_hold_polynomials_of_the_lowest_degree():
    np.testing.assert_allclose(AXIS.values(AXIS.nodes_m), np.eye(10), atol=1e-13)
    at = np.linspace(0.0, 2.25, 37)
    np.testing.assert_allclose(AXIS.values(at) @ AXIS.nodes_m**2, at**2, atol=1e-13)


def test_integrals_are_exact():
    """``int f g``, ``int f' g`` and ``int f' g'`` of f = x^2, g = x from 0 to 2.25."""
    f, g, end = AXIS.nodes_m**2, AXIS.nodes_m, 2.25
    mass, slope, stiffness = AXIS.integrate_intervals(range(3))
    assert f @ mass @ g == pytest.approx(end**4 / 4.0, rel=1e-13)
    assert f @ slope @ g == pytest.approx(2.0 * end**3 / 3.0, rel=1e-13)
    assert f @ stiffness @ g == pytest.approx(end**2, rel=1e-13)
    part = AXIS.integrate_intervals([1])[0]
    assert f @ part @ g == pytest.approx((2.0**4 - 0.5**4) / 4.0, rel=1e-13)


@pytest.mark.parametrize("edge_m", [3e-3, 12.7e-3, 0.1, 0.3])
def test_graded_lines_are_fine_at_the_features_and_grow_from_there(edge_m):
    lines = make_graded_breaks_m(
        0.3048, features=[(0.0, 3e-3), (edge_m, 3e-4)], growth=2.0, largest_m=0.06, stops_m=[edge_m]
    )
    sizes = np.diff(lines)
    assert lines[0] == 0.0
    assert lines[-1] == 0.3048
    assert edge_m in lines
    assert np.all(sizes > 0.0)
    assert sizes.max() < 1.5 * 0.06  # a whole number of intervals fits in
    edge = int(np.flatnonzero(lines == edge_m)[0])
    # An interval at the feature has its size and grows along itself: ``(e^2 - 1) / 2`` times at most,
    # and half an interval more where rounding leaves too few.
    assert sizes[edge - 1] < 3e-4 * 3.2 * 3.2
    assert sizes[edge - 1] == sizes[:edge].min()


def test_a_feature_at_the_end_needs_no_line_of_its_own():
    lines = make_graded_breaks_m(1.0, features=[(1.0, 0.1)], growth=1.0, largest_m=1.0, stops_m=[1.0])
    assert lines[-1] == 1.0
    assert np.all(np.diff(lines) > 0.0)
