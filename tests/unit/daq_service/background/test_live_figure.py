import json
import logging
import struct
from pathlib import Path

import numpy as np
import pytest

from analysis.waves.features import ShotFeatures
from daq_service.background.live_figure import LiveFigure
from daq_service.clock import MachineClock
from hardware_drivers.measurement import Calibration, Shot, ShotKey, Stamp, Waveform


def shot(counts, position="B"):
    calibration = Calibration(coefficients_v=np.array([0.001, 1.5e-4]), resolution_bits=16, range_v=5.0)
    return Shot(
        sequence=42,
        key=ShotKey(position=position, set_index=3, shot_index=7),
        stamp=Stamp(utc_ns=1_700_000_000_000_000_000, mono_ns=5, boot_id="boot"),
        waveform=Waveform(counts=counts, sample_rate_hz=1e7, pretrigger_samples=2, calibration=calibration),
    )


@pytest.mark.parametrize("dtype", [np.int16, np.int32])
def test_a_live_figure_has_header_marks_and_exact_samples(tmp_path, dtype):
    (tmp_path / "live").mkdir()
    counts = np.array([-32768, -1, 0, 1, 32767], dtype=dtype)
    features = ShotFeatures(isw_time_s=5e-5, isw_amplitude_v=2.5, flags=("noisy",))
    LiveFigure(tmp_path, "simulated").show(shot(counts), due_h=1.5, features=features)
    data = (tmp_path / "live" / "B.bin").read_bytes()
    (length,) = struct.unpack_from("<I", data)
    header = json.loads(data[4 : 4 + length])
    assert (4 + length) % 8 == 0, "the samples can be mapped as they are"
    stored = np.frombuffer(data, dtype=np.dtype(dtype).newbyteorder("<"), offset=4 + length)
    np.testing.assert_array_equal(stored, counts)
    assert (header["position"], header["sequence"], header["shot_index"]) == ("B", 42, 7)
    assert header["flags"] == ["noisy"]
    assert header["marks"]["isw_time_s"] == 5e-5
    assert header["marks"]["psw_time_s"] is None, "a mark that is not there is null, never a number"
    assert header["dtype"] == np.dtype(dtype).name


def test_a_live_figure_is_replaced_at_most_ten_times_per_second(tmp_path):
    now = [1_000_000_000]
    live = LiveFigure(tmp_path, "simulated", machine=MachineClock(mono_ns=lambda: now[0]))
    assert live.due("B")
    live.show(shot(np.zeros(4, np.int16)), due_h=1.0, features=None)
    assert not live.due("B")
    assert live.due("C"), "each position has its own pace"
    now[0] += 100_000_000
    assert live.due("B")


def test_on_a_slow_disk_live_figures_are_rarer(tmp_path, monkeypatch):
    """Two positions, 4 ms per figure: each gets one in 0.8 s, so both take 1 % of the time."""
    now = [1_000_000_000]
    written = Path.write_bytes

    def slowly(self, data):
        now[0] += 4_000_000
        return written(self, data)

    monkeypatch.setattr(Path, "write_bytes", slowly)
    live = LiveFigure(tmp_path, "simulated", machine=MachineClock(mono_ns=lambda: now[0]))
    for position in ("C", "B"):
        live.show(shot(np.zeros(4, np.int16), position), due_h=1.0, features=None)
    now[0] += 799_000_000
    assert not live.due("B")
    now[0] += 1_000_000
    assert live.due("B")


def test_a_write_error_costs_only_the_live_figure(tmp_path, monkeypatch, caplog):
    def full(self, data):
        raise OSError(28, "No space left on device")

    live = LiveFigure(tmp_path, "simulated")
    monkeypatch.setattr(Path, "write_bytes", full)
    with caplog.at_level(logging.WARNING):
        live.show(shot(np.zeros(4, np.int16)), due_h=1.0, features=None)
    assert "No space left" in caplog.text
