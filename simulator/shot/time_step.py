"""Step and length of a shot's record, estimated from its chain."""

from __future__ import annotations

import math

from simulator.chain.hertz_contact import indentation_m
from simulator.chain.spheres import Chain

PHASE_PER_STEP_RAD = 0.05
"""The chain's highest frequency turns by no more than this in a step; see docs for the convergence."""


def choose_step_s(chain: Chain) -> float:
    """Return the largest time step of 1, 2 or 5 x 10^k s that resolves `chain`.

    The dashpots between the spheres must relax slowly compared with a step, too.
    """
    m = float(chain.mass_kg.min())
    omega = 2.0 * math.sqrt(stiffest_contact_n_per_m(chain) / m)
    rate = float(chain.damping_n_s_per_m[:-1].max()) / m
    if chain.damping_exponent:
        rate *= (peak_overlap_m(chain) / chain.damping_reference_overlap_m) ** chain.damping_exponent
    longest = PHASE_PER_STEP_RAD / max(omega, rate)
    decade: float = 10.0 ** math.floor(math.log10(longest))
    # Rounding of the logarithm must not lose a step that is a power of ten.
    steps = [factor * decade for factor in (1.0, 2.0, 5.0)]
    return max(step for step in steps if step <= longest * (1.0 + 1e-9))


def stiffest_contact_n_per_m(chain: Chain) -> float:
    """Estimate the stiffness dF/dd of the stiffest contact at its peak, in N/m."""
    return 1.5 * float(chain.stiffness_n_per_m15.max()) * math.sqrt(peak_overlap_m(chain))


def peak_overlap_m(chain: Chain) -> float:
    """Estimate the largest overlap in m, from two spheres that collide at the striker's speed.

    A precompressed contact is pressed that much further.
    """
    a = float(chain.stiffness_n_per_m15.max())
    overlap: float = (0.625 * float(chain.mass_kg.max()) * chain.impact_speed_m_per_s**2 / a) ** 0.4
    return overlap + indentation_m(chain.precompression_n, float(chain.stiffness_n_per_m15.min()))


def choose_record_duration_s(chain: Chain) -> float:
    """Return the duration in s that includes the reflected wave: 1.4 ms, more for slower chains.

    A solitary wave needs about ``1.2 (m^2 / (A^2 v))^(1/5)`` from one contact to the next, with a sphere's
    mass m, the contact's stiffness A and the striker's speed v, down the chain and back to the sensor; 2.5
    times that leaves room for a soft specimen.
    """
    m = float(chain.mass_kg.max())
    a = float(chain.stiffness_n_per_m15.min())
    per_contact: float = 1.2 * (m**2 / (a**2 * chain.impact_speed_m_per_s)) ** 0.2
    contacts = 2 * len(chain.mass_kg) - chain.sensor
    return max(1.4e-3, 2.5 * per_contact * contacts)
