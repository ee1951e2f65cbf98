"""State of a set during acquisition: missed records, repetitions, and the reason of a shortfall."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from support.archived_sets import SET_INDEX, make_echo, make_set, make_shot
from support.synthetic_records import Scene

from analysis.waves.features import ShotFeatures
from analysis.waves.quality_gate import RestrikeRule
from analysis.waves.record_reduction import ExtractionSettings
from daq_service.acquisition import shot_features
from daq_service.acquisition.shot_features import (
    derive_extraction_settings,
    extract_features_of_shots,
    extract_record_features,
    extract_shot_features,
)
from daq_service.recording.acquire_set import TakenSet
from daq_service.settings.tree import PositionSettings, WaveSettings
from hardware_drivers.errors import BusyError, ConnectionLostError
from hardware_drivers.instruments import Acquired
from hardware_drivers.measurement import MissedShot, ShotKey, Waveform

GOOD = ShotFeatures(flags=(), valid=True, quality="good")
CLIPPED = ShotFeatures(flags=("clipped",), valid=False, quality="bad")
STOPPED = "the recorder received a stop request"


def key(position, shot_index, attempt=0):
    return ShotKey(position=position, set_index=SET_INDEX, shot_index=shot_index, attempt=attempt)


def missed(position, shot_index, attempt=0, cause="no trigger within 5 s"):
    return MissedShot(key=key(position, shot_index, attempt), cause=cause)


def taken_set(*measurements, budget=3, **values):
    taken = TakenSet(rule=RestrikeRule(restrikes_per_set=budget), **values)
    for measurement in measurements:
        taken.keep(measurement)
    return taken


def test_shots_and_missed_records_are_stored_by_position():
    taken = taken_set()
    assert taken.is_empty
    for measurement in (missed("B", 0), make_echo(40), make_shot("B", 0, 41, attempt=1)):
        taken.keep(measurement)
    assert not taken.is_empty
    assert ([shot.sequence for shot in taken.shots], [echo.sequence for echo in taken.echoes]) == ([41], [40])
    assert taken.missed == [missed("B", 0)]


def test_missed_strikes_alone_are_no_record():
    assert taken_set(missed("B", 0)).is_empty


def test_a_repeated_shot_is_one_shot():
    taken = taken_set(make_shot("B", 0, 1), make_shot("B", 0, 2, attempt=1), make_shot("C", 0, 3))
    assert (taken.n_records("B"), taken.n_records("C"), taken.n_records("D")) == (1, 1, 0)


def test_a_repetition_counts_only_for_its_transducer():
    taken = taken_set(budget=1)
    assert taken.decide_restrike(missed("B", 0))
    assert not taken.decide_restrike(missed("B", 1)), "the budget is used up"
    assert taken.decide_restrike(missed("C", 0))
    assert not taken.decide_restrike(missed("C", 0, attempt=1))
    assert taken.restrikes == {"B": 1, "C": 1}


@pytest.mark.parametrize(("features", "wanted"), [(GOOD, False), (CLIPPED, True)])
def test_a_restrike_is_requested_according_to_the_quality_flags(features, wanted):
    shot = make_shot("B", 0, 1)
    taken = taken_set(shot)
    taken.features[1] = features
    assert taken.decide_restrike(shot) is wanted


def test_a_failed_analysis_flags_only_its_shot(monkeypatch):
    def fails(waveform):
        raise ZeroDivisionError("a fault of the analysis")

    monkeypatch.setattr(shot_features, "extract_features", fails)
    found = shot_features.extract_shot_features(make_shot("B", 0, 1))
    assert (found.flags, found.valid, found.quality) == (("not_analysed",), False, "bad")


def test_a_complete_position_has_no_shortfall():
    taken = taken_set(missed("B", 0), make_shot("B", 0, 1, attempt=1), make_shot("B", 1, 2))
    assert taken.find_shortfall("B", 2, STOPPED) == ""


def test_a_shortfall_names_what_ended_the_set_and_what_was_missed():
    lost = ConnectionLostError("board 01A2 is gone")
    silence = [missed("B", 0), missed("B", 0, 1), missed("B", 1)]
    assert taken_set(*silence).find_shortfall("B", 2, STOPPED) == "3 missed: no trigger within 5 s"
    assert taken_set(make_shot("B", 0, 1)).find_shortfall("B", 2, STOPPED) == STOPPED
    assert (
        taken_set(missed("B", 0)).find_shortfall("B", 2, STOPPED)
        == f"{STOPPED}; 1 missed: no trigger within 5 s"
    )
    cut = taken_set(missed("B", 0), trouble=lost)
    assert cut.find_shortfall("B", 2, STOPPED) == "board 01A2 is gone; 1 missed: no trigger within 5 s"
    # All its strikes were made before the error.
    assert (
        taken_set(*silence, trouble=lost).find_shortfall("B", 2, STOPPED) == "3 missed: no trigger within 5 s"
    )
    assert taken_set(*silence, trouble=lost).find_shortfall("C", 2, STOPPED) == "board 01A2 is gone"


def test_a_shortfall_does_not_repeat_the_error_message():
    lost = ConnectionLostError("board 01A2 is gone")
    taken = taken_set(missed("B", 0, cause=str(lost)), trouble=lost)
    assert taken.find_shortfall("B", 2, STOPPED) == "board 01A2 is gone"


def test_an_instrument_error_has_its_class_name():
    assert taken_set().format_error() == ""
    assert taken_set(trouble=BusyError("owned by LabVIEW: slot 3")).format_error() == (
        "BusyError: owned by LabVIEW: slot 3"
    )


def test_outcomes_are_listed_by_position():
    shots = [
        make_shot("B", 0, 1),
        make_shot("B", 0, 2, attempt=1),
        make_shot("C", 0, 3),  # the same index at another position is another shot
        make_shot("C", 1, 4),
        make_shot("C", 1, 5, attempt=1),
    ]
    taken = taken_set(*shots)
    taken.features.update({1: CLIPPED, 2: GOOD, 3: CLIPPED, 4: GOOD, 5: CLIPPED})
    assert taken.find_superseded_shots() == {1: "superseded", 5: "superseded"}


def test_a_stored_set_counts_strikes_misses_and_repetitions():
    record = replace(make_set(), missed=[missed("B", 0, 1), missed("C", 1), missed("C", 1, 1)])
    # B: shots 0 and 1, each repeated, one repetition without a record. C: shot 0 and a silent shot 1.
    counts = {name: (record.n_tried(name), record.n_missed(name), record.n_restrikes(name)) for name in "BCD"}
    assert counts == {"B": (2, 1, 2), "C": (2, 2, 1), "D": (0, 0, 0)}


def test_records_of_a_worker_bring_the_features_that_the_recorder_would_extract(monkeypatch):
    shots = [make_shot("B", index, index) for index in range(3)]
    own = [extract_shot_features(shot) for shot in shots]
    acquired = [None, *(Acquired(waveform=shot.waveform) for shot in shots)]
    missing, *found = pickle.loads(pickle.dumps(extract_record_features(acquired, ["B"] * len(acquired))))
    monkeypatch.setattr("daq_service.acquisition.shot_features.extract_features", None)
    assert missing is None
    assert [
        extract_shot_features(replace(s, waveform=a.waveform)) for s, a in zip(shots, found, strict=True)
    ] == own
    for shot, one in zip(shots, found, strict=True):
        np.testing.assert_array_equal(one.waveform.counts, shot.waveform.counts)


def test_each_position_is_extracted_as_its_chain_and_its_keys_say():
    """The record is that of a wave of 65 us: only C expects another one."""
    positions = {
        "B": PositionSettings(method="solitary_wave"),
        "C": PositionSettings(method="solitary_wave", waves=WaveSettings(isw_fwhm_s=30e-6)),
    }
    by_position = derive_extraction_settings(positions)
    assert by_position["B"] == ExtractionSettings()
    shots = [
        replace(make_shot(position, 0, index), waveform=Scene(noise_fraction=0.01).waveform(index))
        for index, position in enumerate("BCB")
    ]
    alone = [extract_shot_features(shot, by_position) for shot in shots]
    together = extract_features_of_shots(shots, by_position)
    ahead = extract_record_features([Acquired(waveform=s.waveform) for s in shots], "BCB", by_position)
    assert together == alone == [one.waveform.features for one in ahead]
    assert [shot.valid for shot in alone] == [True, False, True]


def test_records_that_cannot_be_analysed_together_come_without_features():
    short = Waveform(
        counts=np.zeros(1, np.int16),
        sample_rate_hz=1e7,
        pretrigger_samples=0,
        calibration=make_shot("B", 0, 1).waveform.calibration,
    )
    acquired = [Acquired(waveform=short), Acquired(waveform=make_shot("B", 0, 1).waveform)]
    assert extract_record_features(acquired, ["B"] * len(acquired)) == acquired
