"""Compile the twin's loops before the first strike, so that two processes can share the work."""

from __future__ import annotations

import numpy as np

from hardware_drivers.measurement import ShotKey
from simulator.numerics.driven_modes import find_driven_modes
from simulator.parameters.chain import ChainParameters, DampingLaw
from simulator.parameters.experiment import TwinParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.shot.kernel import WIDEST
from simulator.shot.model import Impact, ShotModel
from simulator.specimen import Transducer, build_specimen


def compile_wide_loop(law: DampingLaw) -> None:
    """Compile the time loop of many strikes with dashpots of this law, or load its machine code."""
    _build_model(law).shots([Impact()] * WIDEST)


def compile_other_loops(law: DampingLaw) -> None:
    """Compile the time loop of few strikes and the loops of plates and records, or load their code."""
    find_driven_modes(np.eye(2), np.eye(2), 1.0, 2)
    transducer = Transducer(chain=ChainParameters(damping_law=law), model=_build_model(law))
    specimen = build_specimen(TwinParameters(), transducers={"A": transducer}, probed_thickness_m={})
    specimen.simulate_wave(ShotKey(position="A", set_index=0, shot_index=0), 0.0)


def _build_model(law: DampingLaw) -> ShotModel:
    """Build the paper's chain on an infinite plate, which needs no preparation."""
    chain, plate = ChainParameters(damping_law=law), PlateParameters(model="infinite_kirchhoff")
    return ShotModel(chain, plate, CorrosionParameters(depth_fraction=0.0))
