"""Inputs, state and outputs of the time loop: arrays and vectors by name.

numba takes named tuples apart; in machine code nothing of them is left.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntegerArray = NDArray[np.int64]


class Chains(NamedTuple):
    """Chains that differ in speed and contacts only: fields of `chain.spheres.Chain`, and more.

    Attributes
    ----------
    mass, static_force
        float64, shape (n_bodies,).
    stiffness, dashpot, static_overlap
        float64, shape (n_bodies * width,), of every shot, the shots of a contact side by side; the dashpots'
        are `Chain.dashpot_impulse_n_s_per_m`.
    retainer_force
        Constant force that carries the last sphere where there is no specimen; zero elsewhere.
    """

    mass: FloatArray
    stiffness: FloatArray
    dashpot: FloatArray
    static_force: FloatArray
    static_overlap: FloatArray
    gravity: float
    sensor: int
    precompression: float
    retainer_force: float


class Strikes(NamedTuple):
    """Strikes of the striker, float64 and int64, shape (width,).

    At `second_step` it, taken off before, touches the body below with `second_speed`; a negative step: it
    strikes once.
    """

    speed: FloatArray
    second_step: IntegerArray
    second_speed: FloatArray


class Propagator(NamedTuple):
    """Specimen data of the time loop, for one depth and step.

    Attributes
    ----------
    bank
        float64, shape (n_blocks * BANK_ROWS * BLOCK,): `modal_weights.modal_weights`.
    residual_compliance_m_per_n
        C of the modes above the cut.
    mobility_m_per_n_s
        Speed per force of an infinite thin plate; zero for every other specimen.
    """

    bank: FloatArray
    residual_compliance_m_per_n: float = 0.0
    mobility_m_per_n_s: float = 0.0


class Results(NamedTuple):
    """Output of the time loop, float64.

    Attributes
    ----------
    sensor_force
        Shape (n_steps * width,).
    contact_force
        Shape (n_bodies * n_steps * width,): force of every contact; (0,) where no one asks.
    defect_j
        Shape (width,): largest defect of the energy balance.
    reflection_step
        Shape (width,): step of the largest force between chain and plate; there the incident wave turns
        round.
    """

    sensor_force: FloatArray
    contact_force: FloatArray
    defect_j: FloatArray
    reflection_step: FloatArray


class Bodies(NamedTuple):
    """Bodies of all shots except the last of each, and the contacts below them.

    BLOCK numbers are treated at a time. What fills the last block up has neither stiffness nor dashpot nor
    speed. Digits count the steps into the past.
    """

    u: FloatArray
    v0: FloatArray
    v1: FloatArray
    v2: FloatArray
    v3: FloatArray
    f0: FloatArray
    f1: FloatArray
    f2: FloatArray
    impulse: FloatArray
    given: FloatArray  # the impulse of spring and dashpot that a body has got from above
    gap: FloatArray  # d, negative where the contact is open
    overlap: FloatArray
    ahead: FloatArray  # u, predicted
    dissipated: FloatArray
    stiffness: FloatArray
    dashpot: FloatArray
    static_force: FloatArray
    static_overlap: FloatArray
    per_mass: FloatArray


class Contact(NamedTuple):
    """Constants of the contact with the plate; where shots differ, a vector, one shot per lane."""

    step: float
    stiffness: Any
    dashpot: Any
    static_force: float
    static_overlap: Any
    static_dashpot: Any
    per_mass: float
    compliance: float
    mobility: float
    w_per_i: float  # deflection by this step's own I and S
    w_per_s: float
    w_per_last_i: float  # and by the last step's
    w_per_last_s: float
    w_per_earlier_i: float  # by the one before
    rate0: Any  # backward difference
    rate1: Any
    rate2: Any
    rate3: Any
    soft: Any
    drag: Any
    rest: Any  # contact and cut modes in series, together compressed before the strike


class LastBody(NamedTuple):
    """Last body, its contact with the plate, and the plate's past; a vector each, one shot per lane."""

    u: Any
    v: tuple[Any, Any, Any, Any]  # now, one step ago, ...
    f: tuple[Any, Any, Any]  # of the plate's contact
    i: tuple[Any, Any, Any]
    s: tuple[Any, Any, Any]
    d: tuple[Any, Any, Any]
    total: Any  # impulse of spring and dashpot that the body has given to the plate
    overlap: Any
    stretch: Any  # of contact and cut modes in series, which has no jumps
    stored: Any  # in the cut modes; they hold nothing while the contact is open
    dissipated: Any  # at the plate, times the step
