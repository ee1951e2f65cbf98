"""Features of a set from those of its shots."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import Literal

from analysis.assessment.step import FrozenBaseline, SetOfShots
from analysis.waves.features import (
    FEATURE_NAMES,
    SetFeatures,
    ShotFeatures,
    average_features,
    extract_from_average,
)
from analysis.waves.quality_gate import ACCEPTED
from analysis.waves.record_reduction import ExtractionSettings
from analysis.waves.template import compare_with_others, flag_residual_reflections, learn_template
from hardware_drivers.measurement import Shot


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CombinedShots:
    """Shots of a set at a transducer.

    Attributes
    ----------
    shots, features
        Every attempt with a record, in order; the features are flagged by comparison with one another.
    accepted
        Features of the shots that no repetition supersedes.
    mean
        The set's feature, of the accepted shots that are valid.
    """

    shots: Sequence[Shot]
    features: Sequence[ShotFeatures]
    accepted: Sequence[ShotFeatures]
    mean: SetFeatures

    def to_set_of_shots(self, set_index: int, due_h: float, n_tried: int) -> SetOfShots:
        """Convert the combined shots to a `SetOfShots` for the assessment.

        ``due_h`` is the due time in hours; ``n_tried`` counts the attempts with or without a record. A mean
        that is not finite becomes None.
        """
        mean = self.mean
        return SetOfShots(
            set_index=set_index,
            due_h=due_h,
            n_taken=len(self.shots),
            n_tried=n_tried,
            n_valid=mean.n_valid,
            quality=mean.quality,
            reason=mean.reason,
            values={name: value if math.isfinite(value) else None for name, value in mean.mean.items()},
            flags=[features.flags for features in self.accepted],
        )


def combine_shots(
    shots: Sequence[Shot],
    features: Sequence[ShotFeatures],
    outcomes: Mapping[int, str],
    *,
    baseline: FrozenBaseline | None,
    minimum_valid_shots: int,
    of_set: Literal["mean_of_shots", "averaged_waveform"],
    settings: ExtractionSettings = ExtractionSettings(),  # noqa: B008 frozen
) -> CombinedShots:
    """Combine the features of a set's shots; flag those that differ from the others.

    Only accepted, valid shots enter the mean. If the averaged waveform is not valid, the set's quality
    becomes ``bad``, with a reason.

    Parameters
    ----------
    outcomes
        Outcome of each shot that is not ``accepted``, by its sequence.
    baseline
        The frozen one: residual reflections are flagged by its amplitude ratio.
    of_set
        The set's feature: mean of the features of valid shots, or feature of their mean waveform (paper).
    settings
        For the extraction from the mean waveform.

    Raises
    ------
    RecordError
        Waveforms to average differ in rate, length or pre-trigger.
    """
    if baseline is not None and baseline.fitted is not None:
        usual_ratio = float(baseline.fitted.mean[FEATURE_NAMES.index("amplitude_ratio")])
        features = flag_residual_reflections(features, usual_ratio)
    # Only the comparison with the other shots shows a weak strike, a knock or a second strike.
    features = compare_with_others(features, learn_template(features))
    is_accepted = [outcomes.get(shot.sequence, ACCEPTED) == ACCEPTED for shot in shots]
    accepted = list(compress(features, is_accepted))
    mean = average_features(accepted, minimum_valid_shots)
    if of_set != "mean_of_shots" and mean.quality != "bad":
        accepted_shots = list(compress(shots, is_accepted))
        valid = [shot.waveform for shot, one in zip(accepted_shots, accepted, strict=True) if one.valid]
        of_average = extract_from_average(valid, settings)
        if of_average.valid:
            mean = replace(mean, mean=of_average.values())
        else:
            flags = ", ".join(of_average.flags)
            mean = replace(mean, quality="bad", reason=f"the averaged record is {flags}")
    return CombinedShots(shots=shots, features=features, accepted=accepted, mean=mean)
