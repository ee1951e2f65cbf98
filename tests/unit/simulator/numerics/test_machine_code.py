"""Each compilation is reported once, without those it needs."""

import numba

from simulator.numerics.machine_code import report_compilation


def test_a_compilation_is_reported_at_its_start_and_end_only():
    @numba.njit  # nothing is kept on disk: a second run of the tests compiles again
    def inner(x):
        return x + 1.0

    @numba.njit
    def outer(x):
        return 2.0 * inner(x)

    reports = []
    with report_compilation(reports.append):
        assert outer(1.0) == 4.0
        assert reports == [True, False], "the inner loop is compiled for the outer one"
        assert outer(2.0) == 6.0
    assert outer(1) == 4.0
    assert reports == [True, False], "nothing new, or nobody listens"
