"""The twin's waveform of a set agrees with the record of its transducer; nothing waits for the simulation."""

import numpy as np
import pytest
from support.served_web import served
from support.small_experiment import run, small_settings

from daq_service import client
from daq_service.acquisition.shot_features import derive_extraction_settings
from daq_service.assessment.wall_bank import compute_mean_loss
from daq_service.background import twin_waveforms
from daq_service.catalogue import SetCommit, open_catalogue
from daq_service.catalogue.rows import FeatureRow, SetRow, WallRow
from daq_service.client.errors import RefusedError
from daq_service.processes.installation import MissingExtraError

DEPTH, CURVE = 0.3, "mindlin, square 25.4 mm"
TOLERANCE = 0.02
"""RMS difference from the mean of the shots, as a fraction of the incident wave, with scatter and noise."""


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    """Return settings and folder of three sets of B on a wall with a square patch, and its wall thickness."""
    folder = tmp_path_factory.mktemp("twin") / "data"
    waves = {"isw_fwhm_s": 60e-6}
    settings = small_settings(
        schedule={"end_h": 1.5},
        positions={"B": {"method": "solitary_wave", "waves": waves}, "A": {"method": "pulse_echo"}},
        twin={"thinning": {"B": {"reference_h": 1.5, "depth_fraction": DEPTH, "unevenness": 0.0}}},
    )
    assert run(settings, folder)
    place = settings.positions["B"]
    wall_m = place.plate.thickness_m * (1.0 - DEPTH * compute_mean_loss(place.corrosion))
    with open_catalogue(folder, writer=True) as catalogue:
        before = catalogue.rows(SetRow, position="B")[1]
        row = WallRow(
            set_index=1,
            position="B",
            due_h=before.due_h,
            extractor_version="1",
            quality="good",
            thickness_m=wall_m,
            curve=CURVE,
        )
        catalogue.commit_set(SetCommit(wall=[row]))
    return settings, folder


@pytest.fixture(scope="module")
def service(filled):
    with served(*filled) as running:
        yield running


def test_the_waveform_agrees_with_the_measured_one_and_has_its_incident_wave(filled, service):
    _, folder = filled
    with client.open(service.url) as test:
        measured = test.waveforms("B", 2)
        simulated = test.twin_waveform("B", 2)
    assert simulated.attrs["curve"] == CURVE
    assert (simulated.attrs["due_h"], simulated.attrs["quality"]) == (1.0, "good")
    np.testing.assert_array_equal(simulated["time"], measured["time"])
    with open_catalogue(folder) as catalogue:
        (mean,) = catalogue.rows(FeatureRow, position="B", scope="set", set_index=2)
    volts = measured.mean("shot")
    rms_v = float(np.sqrt(np.mean((simulated - (volts - volts[:50].mean())) ** 2)))
    assert rms_v < TOLERANCE * mean.isw_amplitude_v
    assert float(simulated.max()) == pytest.approx(mean.isw_amplitude_v, rel=0.01)
    # The reflected wave has the time of flight of this wall, not of a sound one.
    after = simulated.where(simulated["time"] > mean.isw_time_s + 0.6 * mean.tof_pp_s, drop=True)
    assert float(after["time"].values[after.values.argmax()]) == pytest.approx(mean.psw_time_s, abs=3e-6)


def test_the_answer_is_202_until_the_simulation_is_done_and_names_what_is_missing(filled, monkeypatch):
    shots = iter([None, MissingExtraError("numba is not installed")])

    asked = []

    def find(self, shot):
        asked.append(shot)
        if isinstance(found := next(shots), Exception):
            raise found
        return found

    monkeypatch.setattr(twin_waveforms.TwinWaveforms, "find", find)
    with served(*filled) as running, running.client() as api:
        waiting = api.get("/api/v1/sets/B/2/twin")
        assert waiting.status_code == 202
        assert (waiting.json()["voltage_v"], waiting.json()["reason"]) == (None, "the twin simulates it")
        refused = api.get("/api/v1/sets/B/2/twin")
        assert (refused.status_code, refused.json()["detail"]) == (501, "numba is not installed")
    place, (_, _, extraction, curve, _) = filled[0].positions["B"], asked[-1]
    assert (curve, extraction.isw_fwhm_s) == (CURVE, 60e-6)
    assert extraction == derive_extraction_settings({"B": place})["B"], "as for the features of shots"


@pytest.mark.parametrize(("position", "index"), [("B", 0), ("A", 2), ("B", 7)])
def test_a_set_without_a_wall_thickness_from_waves_has_none(service, position, index):
    with client.open(service.url) as test, pytest.raises(RefusedError, match="no wall thickness from waves"):
        test.twin_waveform(position, index)
