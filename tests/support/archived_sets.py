"""Sets for the tests of the archive: small, and with everything that a set may contain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from daq_service.archive import PositionRecord, SetRecord
from hardware_drivers.measurement import (
    Calibration,
    MissedShot,
    PulseEchoRecord,
    Shot,
    ShotKey,
    Stamp,
    Waveform,
)

SET_INDEX = 7
DUE_UTC_NS = 1_704_081_600_000_000_123
LINEAR = Calibration(
    coefficients_v=np.array([0.0125, 10.0 / 32768]), resolution_bits=16, range_v=10.0, date="2024-01-15"
)
CURVED = Calibration(
    coefficients_v=np.array([-1e-3, 3.1e-4, 2e-10, 1e-15]), resolution_bits=24, range_v=5.0, date=""
)


def counts_of(sequence: int, n_samples: int, dtype: type = np.int16) -> np.ndarray:
    """Return noise that differs for every sequence number."""
    return np.random.default_rng(sequence).integers(-2000, 2000, n_samples).astype(dtype)


def make_shot(
    position: str,
    shot_index: int,
    sequence: int,
    *,
    n_samples: int = 300,
    rate_hz: float = 1e7,
    dtype: type = np.int16,
    calibration: Calibration = LINEAR,
    attempt: int = 0,
    truth: dict[str, float] | None = None,
    settings: dict[str, float | str] | None = None,
    boot_id: str = "5d1f",
) -> Shot:
    return Shot(
        sequence=sequence,
        key=ShotKey(position=position, set_index=SET_INDEX, shot_index=shot_index, attempt=attempt),
        stamp=Stamp(utc_ns=DUE_UTC_NS + 4_000_000_001 * shot_index, mono_ns=17 + sequence, boot_id=boot_id),
        waveform=Waveform(
            counts=counts_of(sequence, n_samples, dtype),
            sample_rate_hz=rate_hz,
            pretrigger_samples=100,
            calibration=calibration,
        ),
        truth=truth or {},
        settings=settings or {},
    )


def make_echo(sequence: int) -> PulseEchoRecord:
    return PulseEchoRecord(
        sequence=sequence,
        key=ShotKey(position="A", set_index=SET_INDEX, shot_index=0),
        stamp=Stamp(utc_ns=DUE_UTC_NS, mono_ns=5, boot_id="5d1f"),
        waveform=Waveform(
            counts=counts_of(sequence, 250), sample_rate_hz=1e8, pretrigger_samples=0, calibration=LINEAR
        ),
        gain_db=31.5,
        offset_v=-0.25,
        averages=64,
        truth={"thickness_m": 4.2e-3},
        settings={"driver_version": "1.5"},
    )


def make_missed(position: str, shot_index: int, *, attempt: int = 0) -> MissedShot:
    key = ShotKey(position=position, set_index=SET_INDEX, shot_index=shot_index, attempt=attempt)
    return MissedShot(key=key, cause="no trigger within 5 s: größer", reason="no_trigger")


def make_set() -> SetRecord:
    """Return a partial set: A complete, B with a repeated strike, C cut short, D silent."""
    full_truth = {"depth_fraction": 0.25, "drop_height_m": 5.1e-3, "tilt_rad": 1e-3}
    return SetRecord(
        set_index=SET_INDEX,
        due_utc_ns=DUE_UTC_NS,
        due_h=4.0,
        started_utc_ns=DUE_UTC_NS,
        ended_utc_ns=DUE_UTC_NS + 90_000_000_000,
        rig_kind="simulated",
        positions=[
            PositionRecord(position="A", method="pulse_echo", n_planned=1, label="ultrasonic"),
            PositionRecord(
                position="B", method="solitary_wave", n_planned=2, label="Ø 25.4 mm", serial_number="T-01"
            ),
            PositionRecord(
                position="C", method="solitary_wave", n_planned=2, cause="no trigger within 5 s: größer"
            ),
            PositionRecord(position="D", method="solitary_wave", n_planned=2, cause="3 missed: größer"),
        ],
        shots=[
            make_shot("B", 0, 41, truth=full_truth, settings={"board": "01A2B3C4", "trigger_level_v": 0.4}),
            make_shot("B", 1, 42, truth={"depth_fraction": 0.1 + 0.2}),
            make_shot("B", 1, 43, attempt=1, boot_id="after-the-reboot", settings={"board": "01A2B3C5"}),
            make_shot("C", 0, 44, dtype=np.int32, calibration=CURVED),
        ],
        echoes=[make_echo(40)],
        missed=[make_missed("D", 0), make_missed("D", 0, attempt=1), make_missed("D", 1)],
        outcomes={42: "superseded"},
        trouble="ConnectionLostError: the board in slot 3 does not answer: größer",
        environment={"supply_state": "on", "voltage_v": 0.1 + 0.2, "charge_coulomb": 12.5},
        provenance={
            "configuration_hash": "ab" * 32,
            "versions": {"solimon": "0.1.0", "numpy": "2.4.6"},
            "configuration": {
                "name": "Ø test",
                "plate": {"thickness_m": 0.00635},
                "list": [1, 2.5, None, True],
            },
        },
    )


def other_set(record: SetRecord, set_index: int, unscheduled_index: int = 0) -> SetRecord:
    """Return the same measurements as another set, an hour later for each index."""
    hours = set_index - record.set_index

    def moved(item):
        return replace(
            item,
            sequence=item.sequence + 1000 * hours,
            key=replace(item.key, set_index=set_index, unscheduled_index=unscheduled_index),
            truth=dict(item.truth),
            settings=dict(item.settings),
        )

    return replace(
        record,
        set_index=set_index,
        unscheduled_index=unscheduled_index,
        due_utc_ns=record.due_utc_ns + hours * 3_600_000_000_000,
        shots=[moved(shot) for shot in record.shots],
        echoes=[moved(echo) for echo in record.echoes],
        missed=[
            replace(item, key=replace(item.key, set_index=set_index, unscheduled_index=unscheduled_index))
            for item in record.missed
        ],
        outcomes={sequence + 1000 * hours: outcome for sequence, outcome in record.outcomes.items()},
    )


def assert_same_waveform(found: Waveform, stored: Waveform) -> None:
    assert found.counts.dtype == stored.counts.dtype
    assert found.counts.tobytes() == stored.counts.tobytes()
    assert found.sample_rate_hz == stored.sample_rate_hz
    assert found.pretrigger_samples == stored.pretrigger_samples
    assert found.calibration.coefficients_v.tobytes() == stored.calibration.coefficients_v.tobytes()
    assert found.calibration.resolution_bits == stored.calibration.resolution_bits
    assert found.calibration.range_v == stored.calibration.range_v
    assert found.calibration.date == stored.calibration.date


def assert_same_records(found: SetRecord, stored: SetRecord) -> None:
    assert [item.sequence for item in found.records] == [item.sequence for item in stored.records]
    for one, other in zip(found.records, stored.records, strict=True):
        assert type(one) is type(other)
        assert (one.key, one.stamp, dict(one.truth)) == (other.key, other.stamp, dict(other.truth))
        assert dict(one.settings) == dict(other.settings)
        assert_same_waveform(one.waveform, other.waveform)
    for one, other in zip(found.echoes, stored.echoes, strict=True):
        assert (one.gain_db, one.offset_v, one.averages) == (other.gain_db, other.offset_v, other.averages)


def assert_same_set(found: SetRecord, stored: SetRecord) -> None:
    """Check that two sets are equal, bit for bit."""
    for name in ("set_index", "due_utc_ns", "due_h", "started_utc_ns", "ended_utc_ns", "rig_kind", "trouble"):
        assert getattr(found, name) == getattr(stored, name), name
    assert (found.missed, dict(found.outcomes)) == (stored.missed, dict(stored.outcomes))
    assert dict(found.environment) == dict(stored.environment)
    assert found.positions == stored.positions
    assert found.provenance == stored.provenance
    assert_same_records(found, stored)
