"""Features of single shots, extracted where the waveform is computed or recorded."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from analysis.waves.features import ShotFeatures, extract_all, extract_features
from analysis.waves.record_reduction import ExtractionSettings
from analysis.waves.transducer import ChainDescription, settings_of_chain
from hardware_drivers.instruments import Acquired
from hardware_drivers.measurement import Shot, Waveform

if TYPE_CHECKING:
    from daq_service.settings.tree import PositionSettings
    from simulator.parameters.chain import ChainParameters

FeaturesOf = Callable[[Shot], ShotFeatures]
SettingsByPosition = Mapping[str, ExtractionSettings]
"""A position that is missing has the paper's chain."""
PAPER_CHAINS: SettingsByPosition = {}
PAPER_SETTINGS = ExtractionSettings()

log = logging.getLogger(__name__)

DRY_RUN = "dry_run"
"""Flag of a record of a rehearsal: noise at the input, since no coil was energised."""
NOT_ANALYSED = "not_analysed"
"""Flag of a shot on which the extraction failed: the record is stored and can be analysed later."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AnalysedWaveform(Waveform):
    """A waveform that comes with its features, computed by the process that computed the waveform."""

    features: ShotFeatures


def describe_chain(chain: ChainParameters) -> ChainDescription:
    """Return what the width and the times of a chain's waves depend on."""
    shared = (field.name for field in fields(ChainDescription) if field.name != "sensor_is_disk")
    return ChainDescription(
        **{name: getattr(chain, name) for name in shared}, sensor_is_disk=chain.sensor == "disk"
    )


def derive_extraction_settings(positions: Mapping[str, PositionSettings]) -> SettingsByPosition:
    """Derive how features are extracted at each position from its chain and its ``waves`` keys."""
    return {
        name: settings_of_chain(
            describe_chain(position.chain), **position.waves.model_dump(exclude_none=True)
        )
        for name, position in positions.items()
    }


def _extract_together(
    waveforms: Sequence[Waveform], positions: Sequence[str], by_position: SettingsByPosition
) -> list[ShotFeatures]:
    """Extract the features of waveforms from several positions, in their order; RecordError if one fails."""
    found: dict[int, ShotFeatures] = {}
    of_each = [by_position.get(position, PAPER_SETTINGS) for position in positions]
    for settings in dict.fromkeys(of_each):
        numbers = [k for k, own in enumerate(of_each) if own == settings]
        found |= zip(numbers, extract_all([waveforms[k] for k in numbers], settings), strict=True)
    return [found[k] for k in range(len(waveforms))]


def extract_record_features(
    acquired: Sequence[Acquired | None],
    positions: Sequence[str],
    by_position: SettingsByPosition = PAPER_CHAINS,
) -> list[Acquired | None]:
    """Return copies of the records with the features of their waveforms, extracted together; None stays None.

    If the extraction fails for any of them, the records are returned without features, and no error is raised
    or logged.
    """
    waveforms = [one.waveform for one in acquired if one is not None]
    places = [place for one, place in zip(acquired, positions, strict=True) if one is not None]
    try:
        features = iter(_extract_together(waveforms, places, by_position))
    except Exception:  # noqa: BLE001 the recorder tries each alone, and logs the one that fails
        return list(acquired)

    def attach_features(waveform: Waveform) -> AnalysedWaveform:
        """Return a copy of a waveform with its features; must be called in the order of the waveforms."""
        parts = {part.name: getattr(waveform, part.name) for part in fields(waveform)}
        return AnalysedWaveform(**parts, features=next(features))

    return [one and replace(one, waveform=attach_features(one.waveform)) for one in acquired]


def extract_shot_features(shot: Shot, by_position: SettingsByPosition = PAPER_CHAINS) -> ShotFeatures:
    """Return the features that came with a shot's waveform, else extract them; never raise an Exception.

    If the extraction fails, log the traceback and return features that are not valid, with the flag
    ``not_analysed``.
    """
    if isinstance(shot.waveform, AnalysedWaveform):
        return shot.waveform.features
    try:
        return extract_features(shot.waveform, by_position.get(shot.key.position, PAPER_SETTINGS))
    except Exception:  # a fault of the analysis must never stop the acquisition; it is logged whole
        log.exception("shot %d (%s) could not be analysed", shot.sequence, shot.key)
        return ShotFeatures(flags=(NOT_ANALYSED,), valid=False, quality="bad")


def choose_extraction(
    positions: Mapping[str, PositionSettings], *, rehearsal: bool, given: FeaturesOf | None = None
) -> FeaturesOf:
    """Return the function for the features of a test's shots: ``given``, or else `extract_shot_features`.

    In a rehearsal it is `compute_rehearsal_features`.
    """
    if rehearsal:
        return compute_rehearsal_features
    return given or partial(extract_shot_features, by_position=derive_extraction_settings(positions))


def extract_features_of_shots(
    shots: Sequence[Shot], by_position: SettingsByPosition = PAPER_CHAINS
) -> list[ShotFeatures]:
    """Extract the features of many shots together, in their order, also where a waveform has some.

    If that fails, each shot is treated as by `extract_shot_features`, which flags and logs a failed one.
    """
    try:
        return _extract_together(
            [shot.waveform for shot in shots], [shot.key.position for shot in shots], by_position
        )
    except Exception:  # noqa: BLE001 each is tried alone, which logs the one
        return [extract_shot_features(shot, by_position) for shot in shots]


def compute_rehearsal_features(shot: Shot) -> ShotFeatures:
    """Return features of a rehearsal's record: only the RMS of its noise about the mean, in V.

    They are not valid, with the flag ``dry_run``.
    """
    noise_rms_v = float(np.std(shot.waveform.volts()))
    return ShotFeatures(flags=(DRY_RUN,), valid=False, quality="bad", noise_rms_v=noise_rms_v)
