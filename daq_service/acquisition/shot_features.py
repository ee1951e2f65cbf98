"""Features of single shots, extracted where the waveform is computed or recorded."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from analysis.waves.features import ShotFeatures, extract_all, extract_features
from hardware_drivers.instruments import Acquired
from hardware_drivers.measurement import Shot, Waveform

log = logging.getLogger(__name__)

DRY_RUN = "dry_run"
"""Flag of a record of a rehearsal: noise at the input, since no coil was energised."""
NOT_ANALYSED = "not_analysed"
"""Flag of a shot on which the extraction failed: the record is stored and can be analysed later."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AnalysedWaveform(Waveform):
    """A waveform that comes with its features, computed by the process that computed the waveform."""

    features: ShotFeatures


def extract_record_features(acquired: Sequence[Acquired | None]) -> list[Acquired | None]:
    """Return copies of the records with the features of their waveforms, extracted together; None stays None.

    If the extraction fails for any of them, the records are returned without features, and no error is raised
    or logged.
    """
    waveforms = [one.waveform for one in acquired if one is not None]
    try:
        features = iter(extract_all(waveforms))
    except Exception:  # noqa: BLE001 the recorder tries each alone, and logs the one that fails
        return list(acquired)

    def attach_features(waveform: Waveform) -> AnalysedWaveform:
        """Return a copy of a waveform with its features; must be called in the order of the waveforms."""
        parts = {part.name: getattr(waveform, part.name) for part in fields(waveform)}
        return AnalysedWaveform(**parts, features=next(features))

    return [one and replace(one, waveform=attach_features(one.waveform)) for one in acquired]


def extract_shot_features(shot: Shot) -> ShotFeatures:
    """Return the features that came with a shot's waveform, else extract them; never raise an Exception.

    If the extraction fails, log the traceback and return features that are not valid, with the flag
    ``not_analysed``.
    """
    if isinstance(shot.waveform, AnalysedWaveform):
        return shot.waveform.features
    try:
        return extract_features(shot.waveform)
    except Exception:  # a fault of the analysis must never stop the acquisition; it is logged whole
        log.exception("shot %d (%s) could not be analysed", shot.sequence, shot.key)
        return ShotFeatures(flags=(NOT_ANALYSED,), valid=False, quality="bad")


def extract_features_of_shots(shots: Sequence[Shot]) -> list[ShotFeatures]:
    """Extract the features of many shots together, in their order, also where a waveform has some.

    If that fails, each shot is treated as by `extract_shot_features`, which flags and logs a failed one.
    """
    try:
        return extract_all([shot.waveform for shot in shots])
    except Exception:  # noqa: BLE001 each is tried alone, which logs the one
        return [extract_shot_features(shot) for shot in shots]


def compute_rehearsal_features(shot: Shot) -> ShotFeatures:
    """Return features of a rehearsal's record: only the RMS of its noise about the mean, in V.

    They are not valid, with the flag ``dry_run``.
    """
    noise_rms_v = float(np.std(shot.waveform.volts()))
    return ShotFeatures(flags=(DRY_RUN,), valid=False, quality="bad", noise_rms_v=noise_rms_v)
