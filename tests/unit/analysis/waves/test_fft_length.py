import subprocess
import sys

import numpy as np
import pytest
from scipy.fft import next_fast_len

from analysis.waves.fft_length import next_fast_length

LENGTHS = [*range(1, 2000), *np.random.default_rng(1).integers(2000, 400_000, 200).tolist()]


@pytest.mark.parametrize(("real", "factors"), [(True, (2, 3, 5)), (False, (2, 3, 5, 7, 11))])
def test_it_is_the_length_that_scipy_takes(real, factors):
    assert [next_fast_length(n, factors) for n in LENGTHS] == [next_fast_len(n, real=real) for n in LENGTHS]


def test_a_recorder_starts_without_scipy_fft_and_special():
    asked = "import sys, daq_service.recording.session; print(sys.modules.keys())"
    loaded = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, check=True).stdout
    assert "scipy.fft" not in loaded
    assert "scipy.special" not in loaded
