"""The first compilation calls a function once; loading machine code does not."""

import numba

from simulator.numerics.machine_code import call_at_first_compilation


def test_only_the_first_compilation_calls():
    @numba.njit  # nothing is kept on disk: a second run of the tests compiles again
    def inner(x):
        return x + 1.0

    @numba.njit
    def outer(x):
        return 2.0 * inner(x)

    calls = []
    with call_at_first_compilation(lambda: calls.append(len(outer.signatures))):
        assert outer(1.0) == 4.0
        assert calls == [0], "before the machine code is there"
        assert outer(1) == 4.0
    with call_at_first_compilation(lambda: calls.append(2)):
        assert outer(2.0) == 6.0
    assert calls == [0], "nothing new"
