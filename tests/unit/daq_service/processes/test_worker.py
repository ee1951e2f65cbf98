"""The end of a worker process is detected at any time."""

import sys
from concurrent.futures.process import BrokenProcessPool

import pytest
from support.dying_worker import die_while_answering
from support.waiting import WAIT_S

from daq_service.processes.worker import start_one_worker

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="kills by signal")


def test_a_worker_that_ends_during_its_answer_is_detected():
    """Its pool waits for the rest of the answer and must not wait forever."""
    executor = start_one_worker()
    answer = executor.submit(die_while_answering)
    assert isinstance(answer.exception(WAIT_S), BrokenProcessPool)
    with pytest.raises(BrokenProcessPool):
        executor.submit(die_while_answering)
    executor.shutdown()
