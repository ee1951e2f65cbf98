"""A worker process that dies is missed, whatever it was at."""

import sys
from concurrent.futures.process import BrokenProcessPool

import pytest
from support.dying_worker import die_while_answering
from support.waiting import WAIT_S

from daq_service.processes.worker import one_worker

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="kills by signal")


def test_a_worker_that_dies_in_the_midst_of_its_answer_is_missed():
    """Its pool reads on for the rest of it, and must not for ever."""
    executor = one_worker()
    answer = executor.submit(die_while_answering)
    assert isinstance(answer.exception(WAIT_S), BrokenProcessPool)
    with pytest.raises(BrokenProcessPool):
        executor.submit(die_while_answering)
    executor.shutdown()
