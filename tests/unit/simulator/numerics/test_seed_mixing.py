"""Seeds are mixed as NumPy mixes them: stored experiments depend on it."""

import numpy as np
import pytest

from simulator.numerics.seed_mixing import SeedWords


@pytest.mark.parametrize("n", [1, 3, 4, 5, 7, 12])
@pytest.mark.parametrize(("n_words", "dtype"), [(3, np.uint64), (1, np.uint32), (9, np.uint32)])
def test_words_are_those_of_numpy(n, n_words, dtype):
    random = np.random.default_rng(n)
    for words in random.integers(0, 2**32, (50, n), dtype=np.uint32):
        expected = np.random.SeedSequence(words).generate_state(n_words, dtype)
        np.testing.assert_array_equal(SeedWords(words).generate_state(n_words, dtype), expected)
