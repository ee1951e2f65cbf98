"""Shots of similar chains on one specimen, integrated side by side in the compiled time loop."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simulator.chain.spheres import Chain
from simulator.numerics.arrays import FloatArray
from simulator.shot.kernel import ENERGY_INTERVAL_STEPS, LAWS_OF_DAMPING, NARROWEST, WIDEST, compile_time_loop
from simulator.shot.registers import Chains, Propagator, Results, Strikes

WORTH_A_WIDE_PASS = 5
"""Shots from which on a pass of `kernel.WIDEST` lanes costs less than two after two."""


UNMOVED = Propagator(bank=np.empty(0))
"""A specimen that stands still, or none."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Record:
    """Integrated shot: every step, energy not checked yet."""

    force_n: FloatArray
    contact_force_n: FloatArray | None
    defect_j: float
    reflection_step: int


def integrate_chains(
    chains: list[Chain],
    specimen: Propagator,
    step: float,
    steps: int,
    *,
    retainer_force_n: float,
    contact_forces: bool,
) -> list[Record]:
    """Integrate chains that differ in impact speed and contacts only, up to eight at once; same order.

    Each record has ``steps`` samples at intervals of ``step`` in s; ``retainer_force_n`` carries the last
    sphere where there is no specimen. The energy balance is not checked.
    """
    records: list[Record] = []
    while len(records) < len(chains):
        rest = len(chains) - len(records)
        width = WIDEST if rest >= WORTH_A_WIDE_PASS else NARROWEST
        together = chains[len(records) : len(records) + width]
        found = _run_kernel(together, width, specimen, step, steps, retainer_force_n, contact_forces)
        records += found
    return records


def _run_kernel(
    chains: list[Chain],
    width: int,
    specimen: Propagator,
    step: float,
    steps: int,
    retainer_force_n: float,
    contact_forces: bool,
) -> list[Record]:
    """Run one pass of the kernel for at most `width` chains; return a record for each, in order.

    Lanes without a chain of their own repeat the last one.
    """
    lanes = chains + [chains[-1]] * (width - len(chains))
    chain = lanes[0]

    def stack_lanes(name: str) -> FloatArray:
        """Return one field of all lanes, body by body with the lanes adjacent."""
        return np.array([getattr(lane, name) for lane in lanes]).ravel(order="F")

    bodies = len(chain.mass_kg)
    force = np.empty((steps, width))
    contacts = np.empty((bodies, steps, width) if contact_forces else (0, 0, width))
    found = Results(force.ravel(), contacts.ravel(), np.empty(width), np.empty(width))
    compile_time_loop(width, chain.damping_exponent == 0.0)(
        Chains(
            chain.mass_kg,
            stack_lanes("stiffness_n_per_m15"),
            stack_lanes("dashpot_impulse_n_s_per_m"),
            chain.static_force_n,
            stack_lanes("static_overlap_m"),
            chain.gravity_m_per_s2,
            chain.sensor,
            chain.precompression_n,
            retainer_force_n,
        ),
        Strikes(
            np.array([lane.impact_speed_m_per_s for lane in lanes]),
            np.array(
                [-1 if lane.second_delay_s is None else round(lane.second_delay_s / step) for lane in lanes]
            ),
            np.array([lane.second_speed_m_per_s for lane in lanes]),
        ),
        specimen,
        LAWS_OF_DAMPING.index(chain.damping_exponent),
        step,
        ENERGY_INTERVAL_STEPS,
        found,
    )
    return [
        Record(
            force_n=force[:, k],
            contact_force_n=contacts[:, :, k] if contact_forces else None,
            defect_j=float(found.defect_j[k]),
            reflection_step=int(found.reflection_step[k]),
        )
        for k in range(len(chains))
    ]
