"""Random numbers depend on what they are for, and on nothing else."""

import itertools

import numpy as np
import pytest

from hardware_drivers.measurement import ShotKey
from simulator.numerics.keyed_random import Purpose, keyed_generator


def draws(seed=1, purpose=Purpose.NOISE, position="B", set_index=3, shot_index=2, **parts):
    key = ShotKey(position=position, set_index=set_index, shot_index=shot_index, **parts)
    return keyed_generator(seed, purpose, key=key).standard_normal(4)


def test_the_same_key_gives_the_same_numbers_in_any_order():
    first = draws()
    draws(set_index=4)
    np.testing.assert_array_equal(draws(), first)


@pytest.mark.parametrize(
    "changed",
    [
        {"seed": 2},
        {"purpose": Purpose.SHOT_SCATTER},
        {"position": "C"},
        {"set_index": 4},
        {"shot_index": 3},
        {"attempt": 1},
        {"unscheduled_index": 1},
    ],
)
def test_each_part_of_the_key_changes_the_numbers(changed):
    assert not np.any(draws(**changed) == draws())


def test_an_unscheduled_set_has_the_numbers_that_earlier_versions_gave_it():
    """Its key was one number: an earlier test that is played again has the same waveforms."""
    np.testing.assert_array_equal(draws(unscheduled_index=2), draws(set_index=20_000_003))


def test_set_and_shot_index_do_not_run_into_each_other():
    words = {tuple(draws(set_index=i, shot_index=j)) for i, j in itertools.product(range(12), repeat=2)}
    assert len(words) == 144


def test_streams_of_neighbouring_shots_are_uncorrelated():
    table = np.array([draws(set_index=i)[:2] for i in range(2_000)])
    # The correlation of n independent pairs has the standard deviation 1 / sqrt(n); four of them are
    # passed by one seed in 16,000.
    assert abs(np.corrcoef(table[:-1, 0], table[1:, 0])[0, 1]) < 4.0 / np.sqrt(2_000)
    assert abs(np.corrcoef(table.T)[0, 1]) < 4.0 / np.sqrt(2_000)


def test_the_stream_is_pinned():
    # Stored experiments are reproduced from their seed: a change of the recipe must be a decision.
    words = keyed_generator(1, Purpose.THINNING, position="B").integers(0, 2**32, 2).tolist()
    assert words == [2996663429, 698336576]
