"""Slopes of the features for each cause, as printed by `python benchmarks/diagnosis_slopes.py`; not tuned.

Changes of the logarithms of `COMPONENTS`, on one model: the paper's chain with the disk sensor on its dry
Mindlin plate. How far others differ is `hypotheses.MISMATCH`. Contact i lies below body i, the striker is
body 0, the sensor body 4, and contact 8 carries the chain on the plate. The numbers are in `slopes.toml`.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path

_TABLES = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
Row = Sequence[float]

COMPONENTS: tuple[str, ...] = tuple(_TABLES["components"])
"""The five features that are assessed, and the two of the incident wave, which no wall changes."""
STIFFNESS: Sequence[Row] = _TABLES["stiffness"]
"""By ln A of each contact."""
DAMPING: Sequence[Row] = _TABLES["damping"]
"""By ln gamma of each contact."""
DROP_HEIGHT: Row = _TABLES["drop_height"]
"""By ln of the height that the striker falls."""
TILT: Row = _TABLES["tilt"]
"""By the tilt of the sensor disk in rad, about its mean one; its loss of sensitivity included."""
MODULUS_K: Row = _TABLES["modulus_k"]
"""By 1,000 K, through Young's modulus of chain and plate (ASME BPVC II-D, carbon steel)."""
GAIN: Row = _TABLES["gain"]
"""By ln gain: exact, whatever the model."""
DEPTHS: Row = _TABLES["depths"]
"""Lost part of the wall."""
WALL_B: Sequence[Row] = _TABLES["wall_b"]
"""By a patch of 25.4 mm, at each of `DEPTHS`."""
WALL_C: Sequence[Row] = _TABLES["wall_c"]
"""By a patch of 50.8 mm."""
