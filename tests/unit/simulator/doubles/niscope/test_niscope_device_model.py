"""NI-SCOPE's rules and the twin's echo, asked of the brain itself."""

import struct
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from support.waiting import WAIT_S, ended

from hardware_drivers.measurement import ShotKey
from simulator.doubles.chassis.description import ProbeWiring
from simulator.doubles.chassis.scopes import ScopeParameters
from simulator.doubles.niscope.device_model import NiscopeBrain
from simulator.doubles.niscope.pulsers import WAVEFORM_INFO
from simulator.doubles.vendor_api import statuses
from simulator.doubles.vendor_api.statuses import Status
from simulator.parameters.electronics import NoiseParameters
from simulator.parameters.experiment import EchoParameters, TwinParameters
from simulator.specimen import build_specimen

KEY = ShotKey(position="A", set_index=7, shot_index=0)
HOUR_H = 120.0
SERIAL = ScopeParameters().serial_number
PROBE = ProbeWiring(resource="PXI1Slot4")
RECORDS, SAMPLES = 16, 2048


class Scope:
    """Client view of the brain: one call per function, the status raised."""

    def __init__(self, brain):
        self.brain = brain
        self.vi = 0

    def __call__(self, name, client="1", **arguments):
        return self.brain.call(client, f"niScope_{name}", {"vi": self.vi, "channel_list": ""} | arguments)

    def open(self, resource="PXI1Slot4", client="1"):
        self.vi = self(
            "InitWithOptions", client, resource_name=resource, id_query=0, reset_device=0, option_string=""
        )["vi"]
        return self

    def configure(self, range_v=1.0, level_v=1.0, source="VAL_EXTERNAL", delay_s=0.0):
        self(
            "ConfigureVertical",
            channel_list="0",
            range=2.0 * range_v,
            offset=0.0,
            coupling=1,
            probe_attenuation=1.0,
            enabled=1,
        )
        self(
            "ConfigureHorizontalTiming",
            min_sample_rate=100e6,
            min_num_pts=SAMPLES,
            ref_position=0.0,
            num_records=RECORDS,
            enforce_realtime=1,
        )
        self(
            "ConfigureTriggerEdge",
            trigger_source=source,
            level=level_v,
            slope=1,
            trigger_coupling=1,
            holdoff=0.0,
            delay=delay_s,
        )
        self("Commit")
        return self

    def fetch(self, timeout_s=WAIT_S):
        answer = self("FetchBinary16", channel_list="0", timeout=timeout_s, num_samples=SAMPLES)
        return answer["waveform"].reshape(RECORDS, SAMPLES), infos(answer)

    def attribute(self, number, kind="ViReal64", channel="0"):
        return self(f"GetAttribute{kind}", channel_list=channel, attribute_id=number)["value"]


def infos(answer):
    return list(struct.iter_unpack(WAVEFORM_INFO, answer["wfm_info"].tobytes()))


def make_brain(*, noise=False, echo=None, board=None, probe=None, monotonic_s=time.monotonic):
    twin = TwinParameters(noise=NoiseParameters(enabled=noise), echo=echo or EchoParameters())
    specimen = build_specimen(twin, transducers={}, probed_thickness_m={"A": 6.35e-3})
    brain = NiscopeBrain(
        (board or ScopeParameters(),),
        {"A": probe or PROBE},
        specimen,
        lambda _position: (KEY, HOUR_H),
        monotonic_s,
    )
    return brain, specimen


@pytest.fixture
def scope():
    return Scope(make_brain()[0]).open()


def refused(code):
    return pytest.raises(Status, check=lambda status: status.code == code)


def test_single_records_carry_the_noise_of_one():
    scope = Scope(make_brain(noise=True)[0]).open().configure()
    quiet = Scope(make_brain()[0]).open().configure()
    for each in (scope, quiet):
        each("InitiateAcquisition")
    noise = scope.fetch()[0].astype(float) - quiet.fetch()[0].astype(float)
    code_v = ScopeParameters().calibration(1.0, 0.0).coefficients_v[1] / 4.0
    single_v = noise.std() * code_v
    mean_v = noise.mean(axis=0).std() * code_v
    # Of 32,768 draws (2,048 for the mean) a standard deviation scatters by 0.4 % (1.6 %); five of those.
    assert single_v == pytest.approx(EchoParameters().noise_rms_v, rel=0.02)
    assert mean_v == pytest.approx(EchoParameters().noise_rms_v / 4.0, rel=0.08)
    assert not np.array_equal(noise[0], noise[1])


def test_the_same_shot_is_the_same_whenever_it_is_asked_for():
    scope = Scope(make_brain(noise=True)[0]).open().configure()
    taken = []
    for _ in range(2):
        scope("InitiateAcquisition")
        taken.append(scope.fetch()[0])
        scope("Abort")
    np.testing.assert_array_equal(*taken)


def test_time_stamps_are_the_pulser_s_firings():
    scope = Scope(make_brain(probe=replace(PROBE, repetition_hz=2000.0))[0]).open().configure()
    scope("InitiateAcquisition")
    stamps_s = [info[0] for info in scope.fetch()[1]]
    # A monotonic clock of up to a year resolves a nanosecond and a bit in a double.
    np.testing.assert_allclose(np.diff(stamps_s), 5e-4, rtol=0.0, atol=1e-8)


def timing(**changes):
    usual = {
        "min_sample_rate": 100e6,
        "min_num_pts": SAMPLES,
        "ref_position": 0.0,
        "num_records": RECORDS,
        "enforce_realtime": 1,
    }
    return usual | changes


@pytest.mark.parametrize(
    ("name", "arguments", "code"),
    [
        ("ConfigureHorizontalTiming", timing(min_sample_rate=2e8), statuses.SCOPE_INVALID_VALUE),
        ("ConfigureHorizontalTiming", timing(num_records=0), statuses.SCOPE_INVALID_VALUE),
        ("ConfigureHorizontalTiming", timing(min_num_pts=2**25), statuses.SCOPE_INSUFFICIENT_MEMORY),
        (
            "ConfigureChanCharacteristics",
            {"input_impedance": 75.0, "max_input_frequency": 0.0},
            statuses.SCOPE_INVALID_VALUE,
        ),
        ("GetAttributeViReal64", {"attribute_id": 42}, statuses.SCOPE_ATTRIBUTE_NOT_SUPPORTED),
        (
            "SetAttributeViInt32",
            {"attribute_id": 1250010, "value": 1.0},
            statuses.SCOPE_ATTRIBUTE_NOT_SUPPORTED,
        ),
        (
            "GetAttributeViReal64",
            {"attribute_id": 1250001, "channel_list": "7"},
            statuses.SCOPE_UNKNOWN_CHANNEL,
        ),
        ("GetChannelNameFromString", {"indices": "0,5", "buffer_size": 0}, statuses.SCOPE_INVALID_VALUE),
        ("FetchBinary16", {"timeout": 0.0, "num_samples": 1}, statuses.SCOPE_INITIATE_NOT_CALLED),
        ("Abort", {"vi": 99}, statuses.SCOPE_INVALID_SESSION),
    ],
)
def test_an_invalid_call_is_refused_with_its_number(scope, name, arguments, code):
    with refused(code):
        scope(name, **arguments)
    assert scope("error_message", error_code=code)["error_message"] == statuses.TEXTS[code]


def test_the_last_error_of_a_session_is_kept(scope):
    with refused(statuses.SCOPE_INITIATE_NOT_CALLED):
        scope("FetchBinary16", timeout=0.0, num_samples=1)
    assert scope("GetError", buffer_size=0)["error_code"] == statuses.SCOPE_INITIATE_NOT_CALLED


def test_settings_do_not_change_while_an_acquisition_runs(scope):
    scope.configure()
    scope("InitiateAcquisition")
    for name in ("Commit", "InitiateAcquisition"):
        with refused(statuses.SCOPE_ACQUISITION_IN_PROGRESS):
            scope(name)
    scope("SetAttributeViInt32", attribute_id=1150079, value=3)
    assert scope("ActualNumWfms", channel_list="0")["num_wfms"] == RECORDS - 3
    scope("Abort")
    scope("Commit")


def test_a_client_that_dies_is_reported_and_leaves_nothing_reserved(scope):
    assert scope.brain.list_open_sessions() == [("1", "PXI1Slot4")]
    assert scope.brain.close_client_sessions("1") == ["PXI1Slot4"]
    assert scope.brain.list_open_sessions() == []
    Scope(scope.brain).open(client="2")


class Clock:
    """Clock of a pulser that the test sets."""

    now_s = 0.0

    def __call__(self):
        return self.now_s


@pytest.fixture
def clock():
    return Clock()


@pytest.mark.parametrize(
    ("configured", "triggers"),
    [
        ({}, True),
        ({"level_v": 4.9}, True),
        ({"level_v": 5.0}, False),
        ({"level_v": 0.0}, False),
        ({"source": "VAL_PFI_0"}, False),
        ({"source": "0"}, False),
    ],
    ids=str,
)
def test_only_a_trigger_that_the_sync_crosses_is_one(clock, configured, triggers):
    scope = Scope(make_brain(monotonic_s=clock)[0]).open().configure(**configured)
    scope("InitiateAcquisition")
    clock.now_s = 3600.0
    if triggers:
        assert scope.fetch(timeout_s=0.0)[0].any()
        return
    with refused(statuses.SCOPE_MAX_TIME_EXCEEDED):
        scope.fetch(timeout_s=0.0)


@pytest.mark.parametrize("delay_s", [0.0, 5e-6])
def test_an_acquisition_is_done_with_its_last_sample(clock, delay_s):
    scope = Scope(make_brain(monotonic_s=clock)[0]).open().configure(delay_s=delay_s)
    scope("InitiateAcquisition")
    # Firings at 1, 2 ... 16 ms; the last record ends 20.48 us (and its delay) later.
    done_s = 16e-3 + delay_s + SAMPLES / 100e6
    clock.now_s = done_s - 1e-7
    with refused(statuses.SCOPE_MAX_TIME_EXCEEDED):
        scope.fetch(timeout_s=0.0)
    clock.now_s = done_s + 1e-7
    assert len(scope.fetch(timeout_s=0.0)[1]) == RECORDS


@pytest.mark.parametrize(
    ("end", "code"),
    [
        (lambda scope: scope("Abort"), statuses.SCOPE_INITIATE_NOT_CALLED),
        (lambda scope: scope.brain.unplug(SERIAL), statuses.SCOPE_HARDWARE_FAILURE),
        (lambda scope: scope("close"), statuses.SCOPE_INVALID_SESSION),
        (lambda scope: scope.brain.close_client_sessions("1"), statuses.SCOPE_INVALID_SESSION),
    ],
    ids=["abort", "unplug", "close", "client gone"],
)
def test_a_waiting_fetch_ends_when_its_acquisition_does(scope, end, code):
    scope.configure(level_v=6.0)
    scope("InitiateAcquisition")
    seen = []

    def wait():
        try:
            scope.fetch(timeout_s=WAIT_S)
        except Status as status:
            seen.append(status.code)

    waiting = threading.Thread(target=wait)
    waiting.start()
    end(scope)
    ended(waiting, "the fetch came back")
    assert seen == [code]


def test_a_reset_restores_the_defaults_and_keeps_the_session(scope):
    scope.configure()
    scope("InitiateAcquisition")
    scope("ResetDevice")
    assert scope.attribute(1250001) == 10.0
    scope("Commit")


def test_self_calibration_is_dated(scope):
    before = scope("CalFetchDate", which_one=1)
    assert (before["year"], before["month"], before["day"]) == (2026, 5, 4)
    scope("CalSelfCalibrate", option=0)
    assert scope("CalFetchDate", which_one=1) != before
    assert scope("CalFetchDate", which_one=0) == before
