"""The unmodified `nidaqmx` package on the double of its C library."""

import ctypes
import multiprocessing
import os
import re
import threading
from pathlib import Path

import numpy as np
import pytest
from support.daqmx_models import running_brain
from support.daqmx_rig import meet
from support.waiting import WAIT_S, ended, happened

from simulator.doubles.chassis.description import build_default_description
from simulator.doubles.transports.control import RunningDoubles
from simulator.doubles.transports.library import SONAMES

nidaqmx = pytest.importorskip("nidaqmx")
from nidaqmx.constants import (  # noqa: E402
    AcquisitionType,
    Level,
    Slope,
    TaskMode,
)
from nidaqmx.errors import DaqError, DaqFunctionNotSupportedError, DaqReadError, DaqWarning  # noqa: E402
from nidaqmx.stream_readers import AnalogUnscaledReader  # noqa: E402
from nidaqmx.system import System  # noqa: E402

SAMPLES, PRETRIGGER = 13_600, 1_000


def digitizer(board="PXI1Slot3", name="", channel="ai0"):
    task = nidaqmx.Task(name)
    task.ai_channels.add_ai_voltage_chan(f"{board}/{channel}", min_val=-5.0, max_val=5.0)
    task.timing.cfg_samp_clk_timing(10e6, sample_mode=AcquisitionType.FINITE, samps_per_chan=SAMPLES)
    task.triggers.reference_trigger.cfg_anlg_edge_ref_trig(
        f"{board}/{channel}", PRETRIGGER, Slope.RISING, 0.25
    )
    return task


def coil(board="PXI1Slot3", name="", **times):
    task = nidaqmx.Task(name)
    chosen = {"initial_delay": 2e-4, "high_time": 0.006, "low_time": 0.001} | times
    task.co_channels.add_co_pulse_chan_time(f"{board}/ctr0", **chosen)
    return task


def test_attributes_of_every_type_are_set_and_read_back(meeting):
    with digitizer() as ai, coil() as co:
        ai.timing.samp_clk_rate = 5e6
        assert ai.timing.samp_clk_rate == 5e6
        ai.timing.ref_clk_src = "PXI_Clk10"
        assert ai.timing.ref_clk_src == "PXI_Clk10"
        ai.triggers.reference_trigger.pretrig_samples = 700
        assert ai.triggers.reference_trigger.pretrig_samples == 700
        ai.triggers.reference_trigger.anlg_edge_slope = Slope.FALLING
        assert ai.triggers.reference_trigger.anlg_edge_slope is Slope.FALLING
        channel = co.co_channels[0]
        assert channel.co_pulse_idle_state is Level.LOW
        assert channel.co_pulse_high_time == 0.006
        channel.co_pulse_term = "/PXI1Slot3/PFI5"
        assert channel.co_pulse_term == "/PXI1Slot3/PFI5"


def test_unsupported_calls_are_refused_by_the_package_or_with_their_number(meeting):
    with digitizer() as ai:
        with pytest.raises(DaqFunctionNotSupportedError, match="DAQmxIsTaskDone"):
            ai.is_task_done()
        with pytest.raises(DaqError, match="The double has no Chan attribute 0x17dd") as caught:
            _ = ai.ai_channels[0].ai_max
        assert caught.value.error_code == -200233


# Errors


def test_an_error_brings_its_code_text_and_task(meeting):
    with digitizer(name="digitizer B") as ai:
        ai.timing.samp_clk_rate = 20e6
        with pytest.raises(DaqError, match="Maximum Value: 14285714") as caught:
            ai.control(TaskMode.TASK_VERIFY)
        assert caught.value.error_code == -200077
        assert "Task Name: digitizer B" in str(caught.value)


def test_a_read_that_comes_too_early_leaves_the_buffer_as_it_was(meeting):
    with digitizer() as ai:
        ai.start()
        codes = np.full((1, SAMPLES), 77, np.int16)
        with pytest.raises(DaqReadError) as caught:
            AnalogUnscaledReader(ai.in_stream).read_int16(codes, SAMPLES, 0.01)
        assert caught.value.error_code == -200284
        assert caught.value.samps_per_chan_read == 0
        assert np.all(codes == 77)
        with pytest.warns(DaqWarning, match="stopped before"):
            ai.stop()


def test_threads_keep_their_own_last_error(meeting):
    """A hanging call in one thread neither keeps another one from calling nor mixes up its text."""
    meeting.control.inject("DAQmxSelfCal", "hang", nth=1)
    system, found = System.local(), []

    def waiting():
        try:
            system.devices["PXI1Slot3"].self_cal()
            nidaqmx.system.Device("NoSuch").self_cal()
        except DaqError as error:
            found.append(error)

    thread = threading.Thread(target=waiting)
    thread.start()
    happened(meeting.control.wait_until_hanging, "a call hung")
    with pytest.raises(DaqError, match="Device Specified: Other"):
        nidaqmx.system.Device("Other").self_cal()
    meeting.control.release_hangs()
    ended(thread, "the hanging call came back")
    assert "Device Specified: NoSuch" in str(found[0])


# The C functions themselves


def c_library(folder):
    return ctypes.CDLL(str(folder / SONAMES["nidaqmx"]))


@pytest.mark.parametrize(("room", "status", "written"), [(8, 0, 8), (3, -200234, 3), (0, 8, 0)])
def test_an_array_never_runs_over_its_room(meeting, double_library, room, status, written):
    library, ranges = c_library(double_library), (ctypes.c_double * 10)(*[77.0] * 10)
    voltage_ranges = 0x2990
    assert library.DAQmxGetDeviceAttribute(b"PXI1Slot3", voltage_ranges, ranges, room) == status
    assert list(ranges)[written:] == [77.0] * (10 - written)
    assert 77.0 not in list(ranges)[:written]


@pytest.mark.parametrize(
    ("room", "status", "found"), [(10, 0, b"PXIe-6386"), (9, -200228, b"PXIe-638"), (0, 10, b"")]
)
def test_text_never_runs_over_its_room(meeting, double_library, room, status, found):
    library, text = c_library(double_library), ctypes.create_string_buffer(b"\0" + b"x" * 14)
    product_type = 0x631
    assert library.DAQmxGetDeviceAttribute(b"PXI1Slot3", product_type, text, room) == status
    assert text.value == found
    assert text.raw[max(room, 1) :].startswith(b"xxxx")


def test_an_unknown_attribute_writes_nothing(meeting, double_library):
    library, number = c_library(double_library), ctypes.c_double(77.0)
    assert library.DAQmxGetDeviceAttribute(b"PXI1Slot3", 0x7FFF, ctypes.byref(number)) == -200233
    assert number.value == 77.0


# Other processes


def test_a_forked_child_is_a_separate_client(meeting):
    with coil(name="parent's") as co:
        co.control(TaskMode.TASK_COMMIT)
        context = multiprocessing.get_context("fork")
        child = context.Process(target=_touch_the_double)
        child.start()
        child.join(WAIT_S)
        assert child.exitcode == 0
        # The parent's connections survived its child.
        co.start()
    clients = {call["client"] for call in meeting.control.record()["calls"]}
    assert len(clients) == 2


def _touch_the_double():
    os._exit(0 if len(System.local().devices.device_names) == 4 else 1)


# A brain that is gone


def test_without_a_brain_every_call_fails_at_once_and_a_new_brain_is_found(
    meeting,
    double_library,
    monkeypatch,
):
    with running_brain(build_default_description()) as second:
        meet(second, monkeypatch)
        co = coil(name="lost")
        second.control.inject("DAQmxStartTask", "death")
        with pytest.raises(DaqError, match="went away during the call") as caught:
            co.start()
        assert caught.value.error_code == -50405
        second.process.join(WAIT_S)
        assert second.process.exitcode == 70
        with pytest.raises(DaqError, match="No NI-DAQmx double answers") as caught:
            co.start()
        assert caught.value.error_code == -50401
    meet(meeting, monkeypatch)
    with pytest.raises(DaqError) as caught:
        co.close()
    assert caught.value.error_code == -200088
    co._handle = None
    assert len(System.local().devices.device_names) == 4


def test_without_an_address_the_remedy_is_named(meeting, monkeypatch):
    monkeypatch.delenv("SOLIMON_DOUBLES")
    with pytest.raises(DaqError, match=r"python -m simulator\.doubles"):
        nidaqmx.Task()


def test_the_page_s_example_runs(double_library, tmp_path, monkeypatch):
    page = (Path(__file__).parents[5] / "docs" / "reference" / "doubles.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)
    (tmp_path / "my_script.py").write_text(
        "from nidaqmx.system import System\nassert len(System.local().devices.device_names) == 4\n",
        encoding="utf-8",
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "simulator.doubles.transports.control.running_doubles",
        lambda: running_brain(build_default_description()),
    )
    # The page uses the user's cache; a test leaves it alone.
    monkeypatch.setattr(
        RunningDoubles.client_environment,
        "__kwdefaults__",
        {
            "cache": double_library.parent,
            "environment": None,
        },
    )
    names = {}
    exec(compile(example, "doubles.md", "exec"), names)
    functions = [call["function"] for call in names["record"]["calls"]]
    assert "DAQmxGetSystemInfoAttribute" in functions
