"""Forecast the size of a test's folder from the file of one set, built in memory as the archive does.

Noise limits the compression of records, so the set is built from records with the noise of the twin; that of
other instruments is unknown before the test.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from daq_service.assessment.confirmation import BUDGET_H
from daq_service.settings.tree import Settings
from hardware_drivers.methods import PULSE_ECHO, SOLITARY_WAVE

if TYPE_CHECKING:
    from daq_service.archive import Results
    from hardware_drivers.measurement import PulseEchoRecord, Shot

CATALOGUE_BYTES_A_RECORD = 800
"""Rows and events in the catalogue over records: of `solimon demo --hours 60`, without its empty tables."""
FOLDER_BYTES = 2 * 16 * 2**20 + 2**20
"""Two segments of the journal, and a catalogue without rows, live pictures and configuration."""
BUILT_BYTES = 32 * 2**20
"""A set with more raw bytes is built with fewer shots and scaled, so that the forecast is fast."""
TRUTH = {f"known_of_the_twin_{number}": 0.1234 + number for number in range(13)}
"""The twin stores as many facts with each shot."""
NUISANCE_TRUTH = 12
"""And with nuisance as many more, and two a body of the chain."""
ECHO_TRUTH = {f"known_of_the_echo_{number}": 0.1234 + number for number in range(6)}


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordSize:
    """Size of one record.

    Attributes
    ----------
    known
        False if unknown in advance (a recording, a mixed rig): assumed to be like the twin's.
    """

    samples: int
    sample_rate_hz: float
    pretrigger_samples: int = 0
    bytes_per_sample: int = 2
    known: bool = True

    @property
    def n_bytes(self) -> int:
        """Return the size of the record's ADC counts in bytes."""
        return self.samples * self.bytes_per_sample

    @property
    def after_trigger_s(self) -> float:
        """Return the length of the record behind its trigger in s, infinite if unknown."""
        return (self.samples - self.pretrigger_samples) / self.sample_rate_hz if self.known else math.inf


def predict_record_sizes(settings: Settings) -> tuple[RecordSize, RecordSize]:
    """Return the sizes of the records of a strike and of an echo for the configured instruments.

    Those of a recording or a mixed rig are unknown in advance: the twin's, marked ``known=False``.
    """
    adc, sampled_echo = settings.twin.adc, settings.twin.echo
    known = settings.rig.kind in ("simulated", "daqmx")
    strike = RecordSize(
        samples=adc.record_samples,
        sample_rate_hz=adc.sample_rate_hz,
        pretrigger_samples=adc.pretrigger_samples,
        known=known,
    )
    echo = RecordSize(
        samples=sampled_echo.record_samples, sample_rate_hz=sampled_echo.sample_rate_hz, known=known
    )
    boards, probes = settings.rig.daqmx, settings.rig.niscope
    if settings.rig.kind == "daqmx" and boards is not None:
        # Boards of up to 16 bits; 18 bits take twice as much, which only the board itself knows.
        strike = RecordSize(
            samples=boards.record_samples,
            sample_rate_hz=boards.sample_rate_hz,
            pretrigger_samples=boards.pretrigger_samples,
        )
    if settings.rig.kind == "daqmx" and probes is not None:
        # The sum of the averaged records.
        echo = RecordSize(
            samples=probes.record_samples, sample_rate_hz=probes.sample_rate_hz, bytes_per_sample=4
        )
    return strike, echo


def predict_stored_bytes(settings: Settings, n_sets: int) -> int:
    """Estimate the size in bytes of the data folder after ``n_sets`` sets: files, tiles, catalogue, journal.

    Builds one set in memory, which takes a moment; includes the reserve file.
    """
    records = settings.schedule.shots_per_set * len(settings.list_positions(SOLITARY_WAVE)) + len(
        settings.list_positions(PULSE_ECHO)
    )
    set_bytes = predict_set_file_bytes(settings) + CATALOGUE_BYTES_A_RECORD * records
    fixed_bytes = FOLDER_BYTES + settings.storage.reserve_mb * 10**6
    return round(n_sets * set_bytes) + predict_tile_bytes(settings, n_sets) + fixed_bytes


def predict_confirmation_bytes(settings: Settings, last_h: float) -> int:
    """Estimate the maximum size in bytes of the confirmation sets from the baseline's end to hour ``last_h``.

    0 without transducers or if none are allowed. Builds the file of one set in memory.
    """
    transducers, shots = settings.list_positions(SOLITARY_WAVE), settings.schedule.shots_per_set
    days = math.ceil(max(0.0, last_h - settings.baseline.hours) / BUDGET_H)
    sets = days * settings.alarms.confirmation_sets_a_day * len(transducers)
    if sets == 0:
        return 0
    one_position = {name: settings.positions[name] for name in transducers[:1]}
    set_bytes = predict_set_file_bytes(settings.model_copy(update={"positions": one_position}))
    return round(sets * (set_bytes + CATALOGUE_BYTES_A_RECORD * shots))


def predict_tile_bytes(settings: Settings, n_sets: int) -> int:
    """Estimate the size in bytes of the waterfall's tiles after ``n_sets`` sets.

    Builds one record of each position in memory to count the cells.
    """
    from daq_service.archive.waterfall.cells import ALIGNMENTS, build_frame
    from daq_service.archive.waterfall.tiles import estimate_tile_bytes

    a_set = _build_noisy_set(settings, *predict_record_sizes(settings), shots=1)
    frames = [build_frame(taken.waveform, alignment) for taken in a_set.records for alignment in ALIGNMENTS]
    return sum(estimate_tile_bytes(frame.n_cells, n_sets) for frame in frames)


def predict_set_file_bytes(settings: Settings) -> float:
    """Build the file of one set of noisy records in memory and return its size in bytes.

    A set with more than `BUILT_BYTES` of raw data is built with fewer shots and its size scaled.
    """
    from daq_service.archive.layout import build_set_image

    strike, echo = predict_record_sizes(settings)
    transducers, shots = len(settings.list_positions(SOLITARY_WAVE)), settings.schedule.shots_per_set
    n_built = max(1, min(shots, BUILT_BYTES // max(1, strike.n_bytes * transducers)))
    return len(build_set_image(_build_noisy_set(settings, strike, echo, n_built))) * shots / n_built


def _build_noisy_set(settings: Settings, strike: RecordSize, echo: RecordSize, shots: int) -> Any:
    """Build a synthetic `SetRecord` with ``shots`` noisy records per transducer and one per echo probe.

    Sizes of records are those of ``strike`` and ``echo``. Each record has a short pulse; the noise has a
    fixed seed.
    """
    import numpy as np

    from daq_service.archive import PositionRecord, SetRecord
    from hardware_drivers.measurement import Calibration, PulseEchoRecord, Shot, ShotKey, Stamp, Waveform

    random, twin, records = np.random.default_rng(0), settings.twin, list[Any]()

    def build_waveform(size: RecordSize, adc: Any, noise_v: float, at_s: float, width_s: float) -> Any:
        """Build a waveform with a pulse of half the range at ``at_s``, and noise of ``noise_v`` V rms.

        The pulse is ``width_s`` wide, range and resolution are those of ``adc``. No noise if the twin's is
        disabled.
        """
        time_s = np.arange(size.samples) / size.sample_rate_hz
        phase = np.clip((time_s - at_s) / width_s, -0.5, 0.5)
        volts = 0.5 * adc.range_v * np.cos(np.pi * phase) ** 4
        volts += twin.noise.enabled * noise_v * random.standard_normal(size.samples)
        step_v = adc.range_v / 2.0 ** (adc.resolution_bits - 1)
        calibration = Calibration(
            coefficients_v=np.array([0.0, step_v]), resolution_bits=adc.resolution_bits, range_v=adc.range_v
        )
        wide = size.bytes_per_sample == 4 or adc.resolution_bits > 16
        return Waveform(
            counts=np.rint(volts / step_v)
            .clip(*calibration.full_scale_counts)
            .astype(np.int32 if wide else np.int16),
            sample_rate_hz=size.sample_rate_hz,
            pretrigger_samples=0,
            calibration=calibration,
        )

    for position, place in settings.positions.items():
        for shot_index in range(1 if place.method == PULSE_ECHO else shots):
            taken: dict[str, Any] = {
                "sequence": len(records) + 1,
                "key": ShotKey(position=position, set_index=0, shot_index=shot_index),
                "stamp": Stamp(utc_ns=10**18 + len(records), mono_ns=len(records), boot_id="simulated"),
            }
            if place.method == PULSE_ECHO:
                noise_v = twin.echo.noise_rms_v / twin.echo.averages**0.5
                wave = build_waveform(echo, twin.echo, noise_v, 10e-6, 1e-6)
                settings_of: dict[str, Any] = {"gain_db": 30.0, "offset_v": 0.0, "averages": 1}
                settings_of["settings"] = {"clipped_records": 0.0}
                records.append(PulseEchoRecord(**taken, **settings_of, waveform=wave, truth=ECHO_TRUTH))
            else:
                wave = build_waveform(strike, twin.adc, twin.noise.rms_v, 150e-6, 400e-6)
                more = 0 if twin.nuisance == "none" else NUISANCE_TRUTH + 2 * place.chain.bodies
                truth = TRUTH | {f"nuisance_of_the_twin_{number}": 0.1234 + number for number in range(more)}
                records.append(Shot(**taken, waveform=wave, truth=truth))
    return SetRecord(
        set_index=0,
        due_utc_ns=10**18,
        due_h=0.5,
        started_utc_ns=10**18,
        ended_utc_ns=10**18,
        rig_kind=settings.rig.kind,
        positions=[
            PositionRecord(position=name, method=place.method, n_planned=shots, label=place.label)
            for name, place in settings.positions.items()
        ],
        shots=[record for record in records if isinstance(record, Shot)],
        echoes=[record for record in records if isinstance(record, PulseEchoRecord)],
        provenance={"configuration": settings.model_dump(mode="json")},
        results=_make_result_tables(
            settings.list_positions(PULSE_ECHO), settings.list_positions(SOLITARY_WAVE), records
        ),
    )


def _make_result_tables(
    probes: Sequence[str], transducers: Sequence[str], records: Sequence[Shot | PulseEchoRecord]
) -> Results:
    """Build the placeholder result tables of a set; their size does not depend on the values.

    ``probes`` and ``transducers`` are position names: each transducer gets a row for the set and one per
    record, each probe one per record.
    """
    from daq_service.assessment.results_in_file import build_result_tables
    from daq_service.catalogue.rows import FeatureRow, ThicknessRow
    from daq_service.recording.set_assessor import build_shot_row

    common: dict[str, Any] = {"set_index": 0, "due_h": 0.5, "extractor_version": "1.1", "quality": "good"}
    features = [
        FeatureRow(position=name, shot_index=None, sequence=None, n_valid=1, **common) for name in transducers
    ]
    thickness = []
    for record in records:
        of_record = {**common, "position": record.key.position, "sequence": record.sequence}
        if record.key.position in probes:
            thickness.append(ThicknessRow(**of_record))
        else:
            features.append(FeatureRow(shot_index=record.key.shot_index, n_valid=1, **of_record))
    return build_result_tables(
        features, thickness, [build_shot_row(record, valid=True, flags=()) for record in records]
    )
