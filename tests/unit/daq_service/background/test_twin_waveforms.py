"""Waveforms of the twin are simulated one at a time, once, in a process that may fail or die."""

import threading
from dataclasses import replace

import pytest
from support.waiting import until

from analysis.errors import InvalidInputError, RecordError
from analysis.waves.record_reduction import ExtractionSettings
from daq_service.assessment.twin_waveform import simulate_curve_shot
from daq_service.background.twin_waveforms import TwinWaveforms
from daq_service.settings.tree import Settings
from simulator.errors import SimulatorError

B = Settings().positions["B"]
EXTRACTION = ExtractionSettings()


def shot_of(name):
    return B.chain, B.plate, EXTRACTION, name, 0.1


def send_or_end(results, shot):
    *_, name, _ = shot
    if name == "error":
        results.send(InvalidInputError("no such curve"))
    elif name == "shot":
        results.send("a shot")
    elif name == "ever":
        threading.Event().wait()


def test_a_shot_is_simulated_once_and_another_one_waits_for_it():
    shots = TwinWaveforms(send_or_end)
    assert shots.find(shot_of("shot")) is None
    first = shots._running
    assert shots.find(shot_of("ever")) is None
    assert shots._running is first, "one at a time"
    assert until(lambda: shots.find(shot_of("shot")), "it is simulated") == "a shot"
    assert shots._running is None
    assert shots.find(shot_of("ever")) is None
    _, process, _ = shots._running
    shots.close()
    assert not process.is_alive()


@pytest.mark.parametrize(("name", "error"), [("error", InvalidInputError), ("dies", SimulatorError)])
def test_an_error_is_raised_for_its_shot_again_and_again(name, error):
    shots = TwinWaveforms(send_or_end)
    assert shots.find(shot_of(name)) is None
    until(shots._running[2].poll, "it ends")
    for _ in range(2):
        with pytest.raises(error, match="no such curve" if name == "error" else r"ended \(exit code 0\)"):
            shots.find(shot_of(name))


@pytest.mark.parametrize(
    ("curve", "loss", "reason"),
    [
        ("mindlin, square 26 mm", 0.1, "is none of this plate"),
        ("mindlin, square 15 mm", 0.9, "no loss of 90% of the wall"),
    ],
)
def test_a_curve_of_another_bank_and_a_loss_past_its_end_are_refused(curve, loss, reason):
    plate = replace(B.plate, elements_per_edge=16)
    with pytest.raises(InvalidInputError, match=reason):
        simulate_curve_shot(B.chain, plate, EXTRACTION, curve, loss)


def test_the_incident_wave_is_found_with_the_given_settings():
    def simulate(extraction):
        plate = replace(B.plate, elements_per_edge=16)
        return simulate_curve_shot(B.chain, plate, extraction, "mindlin, square 25.4 mm", 0.1)

    usual, wide = simulate(EXTRACTION), simulate(ExtractionSettings.for_width(90e-6))
    assert 0.0 < abs(wide.isw_time_s - usual.isw_time_s) < 1e-7, "other blocks of the same wave"
    assert usual.isw_amplitude_n == pytest.approx(wide.isw_amplitude_n, rel=1e-3)
    with pytest.raises(RecordError, match="the record ends 1360 us after its trigger"):
        simulate(replace(EXTRACTION, psw_earliest_s=3e-3, psw_latest_s=4e-3))
