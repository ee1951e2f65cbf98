"""A rig that is busy or gone when a recorder starts: a new test reports it, a started test waits."""

from contextlib import contextmanager
from functools import partial

import pytest
from support.crashed_recorders import LongerRecords
from support.memory_line import healthy
from support.refused_recorders import INTERVAL_S, Stop, Time
from support.refused_recorders import record as record_on
from support.small_experiment import rows_of, run, small_settings

from daq_service.errors import BusyError, RigError
from daq_service.processes.heartbeat import read_heartbeat
from daq_service.recording.session import compute_longest_call_s
from daq_service.rig.open_rig import open_rig
from hardware_drivers import errors

END_H = 2.0


class Unwilling:
    """Opener that refuses a number of times, then opens the twin."""

    def __init__(self, *refusals, on_refusal=None):
        self.refusals = list(refusals)
        self.on_refusal = on_refusal

    @contextmanager
    def __call__(self, *arguments):
        if self.refusals:
            if self.on_refusal is not None:
                self.on_refusal()
            raise self.refusals.pop(0)
        with open_rig(*arguments) as rig:
            yield rig


GONE = errors.ConnectionLostError("the chassis is gone; switch it on")
BUSY = errors.BusyError("board 01E16086 is held by 'test panel'; close it")
UNKNOWN = errors.UnknownStatusError("DAQmx -999999: nobody knows it")
WRONG = errors.ConfigurationError("range_v is 3 V; the board has 1, 2, 5 and 10 V")


record = partial(run, waits_for_rig_s=(0.01,))


@pytest.mark.parametrize(
    ("refusal", "kind", "code"),
    [(GONE, RigError, 3), (BUSY, BusyError, 5), (UNKNOWN, RigError, 3), (WRONG, RigError, 3)],
)
def test_a_test_that_has_not_started_reports_the_missing_rig_and_ends(tmp_path, refusal, kind, code):
    with pytest.raises(kind, match="cannot be opened") as failure:
        record(small_settings(), tmp_path, rig=Unwilling(refusal))
    assert str(refusal) in str(failure.value)
    assert failure.value.exit_code == code
    assert rows_of(tmp_path)["sets"] == []


def test_an_error_that_waiting_cannot_fix_ends_a_started_test_too(tmp_path):
    assert record(small_settings(schedule={"end_h": 1.0}), tmp_path)
    doing, temporary = [], (GONE, BUSY, UNKNOWN)
    rig = Unwilling(*temporary, WRONG, on_refusal=lambda: doing.append(read_heartbeat(tmp_path).doing))
    with pytest.raises(RigError, match="range_v is 3 V"):
        record(small_settings(schedule={"end_h": END_H}), tmp_path, rig=rig)
    # Which of the two was written last depends on the machine: a beat soon after another one is not written.
    assert set(doing) <= {"opening the rig", *(f"waiting for the rig: {refusal}" for refusal in temporary)}
    assert record(small_settings(schedule={"end_h": END_H}), tmp_path), "the schedule is kept"


def test_any_rig_error_is_waited_for_when_unattended(tmp_path):
    """The supervisor started the recorder again, in the night."""
    assert record(small_settings(schedule={"end_h": 1.0}), tmp_path)
    again = "was killed by signal 9"
    settings, rig = small_settings(schedule={"end_h": END_H}), Unwilling(GONE, WRONG)
    assert record(settings, tmp_path, rig=rig, restart_reason=again)
    assert rig.refusals == []


def test_each_missed_set_has_the_cause_of_its_own_time(tmp_path):
    """A gap, then a recorder that waits for its rig: real time on a simulated clock."""
    clock = Time()
    began_s, stop, again = clock.s(), Stop(clock), Stop(clock)

    def after_two_sets():
        if clock.s() > began_s + 2.7 * INTERVAL_S:
            stop.set()

    @contextmanager
    def absent(opener, *arguments):
        if clock.s() < began_s + 5.5 * INTERVAL_S:
            raise GONE
        with opener(*arguments) as rig:
            yield rig

    clock.look = after_two_sets
    instruments = LongerRecords(healthy)
    assert not record_on(tmp_path / "data", clock, instruments, [], stop)
    clock.sleep(began_s + 3.3 * INTERVAL_S - clock.s())
    assert record_on(tmp_path / "data", clock, instruments, [], again, lambda opener: partial(absent, opener))
    causes = {row.set_index: row.reason for row in rows_of(tmp_path / "data")["sets"]}
    stopped, waited = "the recorder was stopped by its operator", f"the recorder waited for the rig: {GONE}"
    assert causes == {0: None, 1: None, 2: stopped, 3: waited, 4: None, 5: None}, "4 is struck late"


def test_the_heartbeat_allows_for_the_longest_call_over_a_network():
    def deadline_s(**boards):
        wiring = {
            name: {"board_serial": "1", "input": f"ai{n}", "counter": f"ctr{n}", "output_terminal": f"PFI{n}"}
            for n, name in enumerate("BCD")
        }
        rig = {
            "kind": "daqmx",
            "daqmx": {"transducers": wiring, **boards},
            "niscope": {"probes": {"A": {"resource": "PXI1Slot5"}}},
        }
        return compute_longest_call_s(small_settings(clock={"kind": "wall"}, rig=rig))

    assert deadline_s() == 5.0
    assert deadline_s(transport="grpc", grpc_address="lab:31763", call_timeout_s=60.0) > 10 * 60.0
