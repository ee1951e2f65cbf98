"""Grid lines of a plate with its contact and its patches anywhere."""

import numpy as np
import pytest

from simulator.errors import SpecimenError
from simulator.plate.mindlin.grid import make_graded_edge
from simulator.plate.mindlin.hertz_pressure import hertz_nodal_weights

FIRST_M = 1e-4


@pytest.mark.parametrize(
    ("start_m", "end_m", "lines_m"),
    [
        (-0.3048, 0.3048, []),
        (-0.4, 0.2096, [-0.0127, 0.0127]),
        (-0.3048, 0.3048, [-0.2, -0.15, -0.0127, 0.0127, 0.05, 0.1]),
        (0.0, 0.3048, [0.0127, 0.05, 0.1]),
        (-0.6, 0.0096, [-0.0054, 0.0054]),
        (-0.3048, 0.3048, [-0.05, 0.0]),
    ],
)
def test_grid_has_every_line_and_grows_smoothly_from_the_contact(start_m, end_m, lines_m):
    lines = make_graded_edge(start_m, end_m, 96, FIRST_M, lines_m)
    sizes = np.diff(lines)
    assert len(sizes) == 96
    assert (lines[0], lines[-1]) == (start_m, end_m)
    assert np.all(sizes > 0.0)
    for line in (0.0, *lines_m):
        assert line in lines
    contact = int(np.flatnonzero(lines == 0.0)[0])
    # Part of the model: the elements at the contact are what was asked for.
    nearest_sizes = sizes[max(contact - 1, 0) : contact + 1]
    np.testing.assert_allclose(nearest_sizes, FIRST_M, rtol=1e-12)  # rounding
    # Whole numbers of elements between given lines: neighbours differ by less than twice.
    assert np.max(np.abs(np.diff(np.log(sizes)))) < np.log(2.0)


def test_lines_that_fall_together_are_one():
    lines = make_graded_edge(-0.3, 0.3, 24, 1e-3, [0.05, 0.05 + 1e-12, 0.3, 1e-3])
    assert len(lines) == 25
    assert np.diff(lines).min() > 0.9e-3


def test_line_within_the_elements_at_the_contact_is_refused():
    with pytest.raises(
        SpecimenError, match=r"lies 0.0005 m from the contact, within its elements of 0.001 m"
    ):
        make_graded_edge(-0.3, 0.3, 24, 1e-3, [0.0005])


def test_more_lines_than_elements_are_refused_with_the_number_that_is_enough():
    lines = list(np.linspace(0.01, 0.29, 15))
    with pytest.raises(SpecimenError, match=r"16 elements .* the 20 lines .* at least 20"):
        make_graded_edge(-0.3, 0.3, 16, 1e-3, lines)
    assert len(make_graded_edge(-0.3, 0.3, 20, 1e-3, lines)) == 21


@pytest.mark.parametrize("first_m", [0.6 / 24, 0.02])
def test_even_grid_needs_no_growth(first_m):
    sizes = np.diff(make_graded_edge(-0.3, 0.3, 24, first_m, []))
    assert np.all((sizes > 0.9 * first_m) & (sizes < 2.0 * first_m))


@pytest.mark.parametrize("symmetric", [(True, True), (False, True), (True, False), (False, False)])
def test_loads_of_the_circle_add_up_and_lie_about_the_contact(symmetric):
    x, y = (np.linspace(0.0 if half else -8e-3, 8e-3, 33 if half else 65) for half in symmetric)
    weights = hertz_nodal_weights(x, y, 3e-3, symmetric=symmetric)
    assert weights.sum() == pytest.approx(1.0, rel=1e-14)
    assert np.all(weights[np.hypot(x[:, None], y) > 3e-3 + 0.36e-3] == 0.0)
    # Mean square radius under Hertz's pressure: 2/5 a^2; bilinear functions add h^2 / 6 along both axes.
    mean_square = np.sum(weights * (x[:, None] ** 2 + y**2))
    assert mean_square == pytest.approx(0.4 * 9e-6, rel=0.01)


def test_loads_of_a_part_are_those_of_the_whole_folded():
    half, full = np.linspace(0.0, 8e-3, 33), np.linspace(-8e-3, 8e-3, 65)
    whole = hertz_nodal_weights(full, full, 3e-3, symmetric=(False, False))
    folded = whole[32:] + np.pad(whole[:32][::-1], ((1, 0), (0, 0)))
    np.testing.assert_allclose(
        hertz_nodal_weights(half, full, 3e-3, symmetric=(True, False)), folded, atol=1e-15
    )
