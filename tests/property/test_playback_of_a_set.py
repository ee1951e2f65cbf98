"""Playback returns exactly the shots of a set in the recording, and misses exactly the rest."""

import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from support.synthetic_records import Scene

from daq_service.acquisition.schedule import DueSet
from daq_service.acquisition.take_set import MissedShot, SetPlan, take_set
from daq_service.clock import SimulatedClock
from hardware_drivers.instruments import Rig
from hardware_drivers.measurement import Calibration, PulseEchoRecord, Shot, ShotKey, Stamp, Waveform
from hardware_drivers.playback.clock import RecordedClock
from hardware_drivers.playback.instruments import build_instruments
from hardware_drivers.playback.source import ShotsBySet

DUE_NS = 1_704_067_200_000_000_000
SHOTS, INTERVAL_S = 3, 4.0
POSITIONS = {"A": "pulse_echo", "B": "solitary_wave", "C": "solitary_wave"}
PLANNED = list(itertools.product("BC", range(SHOTS)))

attempts = st.sampled_from(["first", "second", "both", "none"])


def waveform(seed):
    return Scene(noise_fraction=0.01).waveform(seed)


WAVEFORMS = [waveform(seed) for seed in range(2 * len(PLANNED))]


def recorded_set(kinds, lateness_ns, echo):
    """Draw records of a set: each strike at or after its scheduled time; a poor one is repeated."""
    records = []
    slot = itertools.count()
    for number, ((position, shot_index), kind) in enumerate(zip(PLANNED, kinds, strict=True)):
        for attempt in range(1 if kind == "first" else 2):
            utc_ns = DUE_NS + round(next(slot) * INTERVAL_S * 1e9) + lateness_ns[number]
            if kind == "none" or (kind == "second" and attempt == 0):
                continue
            records.append(
                Shot(
                    sequence=len(records),
                    key=ShotKey(position=position, set_index=0, shot_index=shot_index, attempt=attempt),
                    stamp=Stamp(utc_ns=utc_ns, mono_ns=0, boot_id="recorded"),
                    waveform=WAVEFORMS[2 * number + attempt],
                    truth={"depth_fraction": number / 7.0},
                    settings={"board_serial": "01F2", "trigger_level_v": 0.25},
                )
            )
    if echo:
        calibration = Calibration(coefficients_v=np.array([0.0, 1e-4]), resolution_bits=14, range_v=1.0)
        counts = np.arange(64, dtype=np.int16)
        records.append(
            PulseEchoRecord(
                sequence=len(records),
                key=ShotKey(position="A", set_index=0, shot_index=0),
                stamp=Stamp(utc_ns=DUE_NS, mono_ns=0, boot_id="recorded"),
                waveform=Waveform(
                    counts=counts, sample_rate_hz=1e8, pretrigger_samples=0, calibration=calibration
                ),
                gain_db=31.5,
                offset_v=-0.25,
                averages=64,
            )
        )
    return records


class RecordedSet(ShotsBySet):
    """One set, and the shots struck in it."""

    def __init__(self, records, struck):
        super().__init__(POSITIONS, lambda set_index: records)
        self._struck = struck

    def tried(self, key):
        return key in self._struck


@given(
    kinds=st.lists(attempts, min_size=len(PLANNED), max_size=len(PLANNED)),
    lateness_ns=st.lists(st.integers(0, 10**9), min_size=len(PLANNED), max_size=len(PLANNED)),
    echo=st.booleans(),
)
def test_a_set_played_back_is_the_recorded_one(kinds, lateness_ns, echo):
    # The first moment is the start of the set: what is late, is late after it.
    lateness_ns = [0, *lateness_ns[1:]]
    records = recorded_set(kinds, lateness_ns, echo)
    moments = sorted({DUE_NS} | {record.stamp.utc_ns for record in records})
    struck = {
        ShotKey(position=position, set_index=0, shot_index=index, attempt=attempt)
        for (position, index), kind in zip(PLANNED, kinds, strict=True)
        for attempt in range(1 if kind == "first" else 2)
    }
    instruments = build_instruments(RecordedSet(records, struck))
    clock = RecordedClock(
        SimulatedClock(DUE_NS),
        lambda after: next((moment for moment in moments if moment > after), None),
        tolerance_s=INTERVAL_S / 2.0,
    )
    rig = Rig(
        kind="playback",
        clock=clock,
        striker=instruments.striker,
        digitizer=instruments.digitizer,
        pulse_echo=instruments.pulse_echo,
    )
    taken = list(
        take_set(
            rig,
            SetPlan(
                due=DueSet(set_index=0, due_h=0.0, due_utc_ns=DUE_NS),
                positions=POSITIONS,
                shots_per_set=SHOTS,
                shot_interval_s=INTERVAL_S,
                read_timeout_s=1.0,
            ),
            first_sequence=0,
            boot_id="played",
            idle=lambda: True,
            wants_restrike=lambda _: True,
        )
    )
    recorded = {record.key: record for record in records}
    played = {item.key: item for item in taken if not isinstance(item, MissedShot)}
    assert played.keys() == recorded.keys()
    for key, record in recorded.items():
        found = played[key]
        assert type(found) is type(record)
        assert found.waveform is record.waveform
        assert found.stamp.utc_ns == record.stamp.utc_ns
        assert (found.truth, found.settings) == (record.truth, record.settings)
        if isinstance(found, PulseEchoRecord):
            assert (found.gain_db, found.offset_v, found.averages) == (31.5, -0.25, 64)
    missed = {item.key for item in taken if isinstance(item, MissedShot)}
    echo_key = ShotKey(position="A", set_index=0, shot_index=0)
    assert missed == (struck | {echo_key}) - recorded.keys()
