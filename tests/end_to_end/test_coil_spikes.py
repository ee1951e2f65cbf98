"""A coil's spike and the cure that `solimon doctor --strike` proposes, on doubles of the boards in real time.

The shots are those of the paper's drop height, with its scatter; each is compared with the twin's own record
of the same shot without any crosstalk. Noise is off where times are compared: a trigger moved by one sample
lets the same noise fall into other means. A spike lasts until it has fallen to a hundredth; in noise that
time is its decay to 1/e, so that what is left of the longest ones is still under the wave.
"""

import itertools
import math
from dataclasses import replace

import pytest
from support.daqmx_rig import (
    CHAIN,
    READ_TIMEOUT_S,
    board,
    counts_of_the_twin,
    parameters_of,
    quick_description,
    reach,
    take,
)
from support.waiting import happened

from analysis.waves.features import extract_features
from daq_service.cli.doctor.spike import propose_ringing_s, strike_and_survey_coil
from hardware_drivers.daqmx.instruments import open_daqmx
from hardware_drivers.measurement import ShotKey
from simulator.doubles.chassis.crosstalk import Crosstalk
from simulator.parameters.electronics import NoiseParameters

DROP_M = 5e-3
NOISE = NoiseParameters()
SEEN_V = 6.0 * (NOISE.rms_v**2 + NOISE.slow_rms_v**2) ** 0.5
"""A spike below six times the noise is not separated from it, and far from the trigger level."""
TOF_S = 0.02e-6

QUICK = quick_description(board(), positions="C")
DESCRIPTION = replace(
    QUICK, transducers={"C": replace(QUICK.transducers["C"], chain=replace(CHAIN, drop_height_m=DROP_M))}
)

HEIGHTS_V, LASTING_S = (0.05, 0.3, 1.0, 5.0), (1e-6, 50e-6, 0.5e-3, 2e-3, 5e-3)
CASES = [
    (edge, height_v, lasting_s, ringing_hz)
    for (height_v, lasting_s), (edge, ringing_hz) in zip(
        itertools.product(HEIGHTS_V, LASTING_S),
        itertools.cycle([("on_v", 0.0), ("off_v", 0.0), ("off_v", 20e3), ("on_v", 5e3)]),
        strict=False,
    )
]
"""Every height with every duration, over both edges, with and without ringing."""
SHORT = [
    ("on_v", 0.05, 5e-3, 0.0),
    ("on_v", 5.0, 1e-6, 0.0),
    ("off_v", 0.3, 2e-6, 0.0),
    ("off_v", 5.0, 0.5e-3, 20e3),
    ("off_v", 5.0, 5e-3, 0.0),
]


@pytest.fixture(params=["library", "grpc"])
def parameters(request, doubles, monkeypatch):
    reach(request.param, doubles, monkeypatch)
    landed(doubles)
    yield parameters_of(DESCRIPTION, doubles, transport=request.param, drop_height_m=DROP_M)
    doubles.control.disturb("C", Crosstalk())


def landed(doubles):
    """Wait until the ball has landed: it still falls when a record that a spike triggered is read."""
    happened(doubles.control.wait_until_quiet, "the striker landed")


def crosstalk_of(case, *, noisy):
    edge, height_v, lasting_s, ringing_hz = case
    decay_s = lasting_s if noisy else lasting_s / math.log(100.0)
    return Crosstalk(**{edge: height_v}, decay_s=decay_s, ringing_hz=ringing_hz)


def shots_of(parameters, doubles, shots, case):
    taken = []
    with open_daqmx(parameters) as rig:
        for shot in shots:
            # On a busy machine the ball of a lost shot would strike before the next pulse, and be recorded.
            landed(doubles)
            key = ShotKey(position="C", set_index=case, shot_index=shot)
            taken.append((key, take(rig, doubles, key)))
    return taken


def wrong_with(parameters, doubles, cases, shots, description=DESCRIPTION):
    """Survey each case, apply its proposal and shoot; return lost or wrong shots and the number of shots."""
    seen_v = SEEN_V if description.twin.noise.enabled else 0.0
    wrong = []
    taken = 0
    for number, case in enumerate(cases):
        edge, height_v, _, _ = case
        doubles.control.disturb("C", crosstalk_of(case, noisy=description.twin.noise.enabled))
        survey = strike_and_survey_coil(parameters, "C", READ_TIMEOUT_S)
        spike = survey.on if edge == "on_v" else survey.off
        named = spike.height_v > 0.6 * height_v and spike.triggers is (height_v > parameters.trigger_level_v)
        if height_v > seen_v and not named:
            wrong.append(f"{case} is told as {spike}")
        if survey.holdoff_s is None:
            wrong.append(f"{case}: no holdoff is proposed ({survey})")
            continue
        cured = replace(parameters, holdoff_s=survey.holdoff_s, ringing_s=propose_ringing_s(survey))
        for key, acquired in shots_of(cured, doubles, range(shots), number):
            taken += 1
            without = replace(acquired.waveform, counts=counts_of_the_twin(description, parameters, key))
            found, expected = extract_features(acquired.waveform), extract_features(without)
            off_s = found.tof_pp_s - expected.tof_pp_s
            if found.flags != expected.flags:
                wrong.append(f"{case}: {key} is flagged {found.flags}, not {expected.flags}")
            elif not description.twin.noise.enabled and not abs(off_s) <= TOF_S:
                wrong.append(f"{case}: the ToF of {key} is off by {off_s:.3g} s")
    return wrong, taken


def test_with_the_survey_s_own_proposal_no_shot_is_lost_or_mistaken(doubles, parameters):
    wrong, taken = wrong_with(parameters, doubles, SHORT, 5)
    assert not wrong, "\n".join(wrong)
    assert taken == 25, "fifty by both transports"


@pytest.mark.slow
def test_with_the_survey_s_own_proposal_none_of_a_thousand_is_lost_or_mistaken(doubles, parameters):
    wrong, taken = wrong_with(parameters, doubles, CASES, 25)
    assert not wrong, "\n".join(wrong)
    assert taken == 500, "a thousand by both transports"
