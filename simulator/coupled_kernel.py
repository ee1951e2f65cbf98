"""The time loop of chain and plate, compiled.

Unknowns are the displacements u_i from the static equilibrium and, for every contact, the impulse

    B(t) = integral (F - F_static) dt = integral (A d^(3/2) - F_static) dt + g ([d]_+^q - d_static^q),

because the impulse of a dashpot that acts only in contact is g [d]_+^q with q = p + 1 and
``g = gamma / (q d_r^p)``; gamma [d]_+ for the linear one. Written this way the law of `granular_chain` has a
continuous right-hand side although its force jumps at every release:

    v_i = v_i(0) + (B_(i-1) - B_i) / m_i,    du_i/dt = v_i.

Each step of length h is linear multistep of order four: Adams-Bashforth predicts the displacements,
Adams-Moulton corrects impulses and displacements. A mode of the plate, ``q'' + omega^2 q = phi F``, is
in the same way ``z' = -i omega z + omega phi B`` with ``z = omega q + i (q' - phi B)``; it is advanced
exactly for the cubic through the last four values of the integral I and for the straight line through
the last two of the dashpot's part S, ``B = I + S``: the line keeps any dashpot on any plate stable,
and S is a small part of B, so that the lower order is not seen. The contact with the plate is solved
implicitly with Newton's method.

Modes above the cut follow the force statically, ``w = C (A d^(3/2) + dS/dt)``, with a backward
difference. That of order three is not passive: at some frequencies the real part of
deflection by impulse falls to -C / (12 h), as it falls to -h / (3 m) for Adams-Moulton on the last
sphere. A shot whose dashpot does not make up for both, ``1 / gamma > C / (12 h) + h / (3 m)``, may blow
up, and the more so the smaller h; there the difference is of order two, whose real part is positive.
Having no mass, these modes lose ``C F^2 / 2`` where the dashpot pulls with F as the contact opens; the
balance books that as lost. Touch and release are booked with the compression of contact and cut modes in
series, which has no jump.

Away from touch and release the error falls as h^4; [d]_+ has a kink there, which limits the order to
two (5/2 without dashpots), with a small constant because a shot has only some twenty such events.

numba keeps the machine code in `__pycache__` beside this file, in the user's cache folder if that
cannot be written, or where NUMBA_CACHE_DIR says; if none of them can be written, it compiles anew.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

ENERGY_INTERVAL_STEPS = 16
"""The energy balance is drawn up every so many steps and at the end."""

ACTIVE_PART_LIMIT = 0.5
"""The difference of order three is used up to this value of gamma (C / (12 h) + h / (3 m)); 1 may blow up."""

GAUSS_POINTS, GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(24)


def _compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    # Sums may be reordered (vector units); not-a-number and infinity keep their meaning.
    options: dict[str, Any] = {"nogil": True, "fastmath": {"reassoc", "contract", "nsz", "arcp"}}
    try:
        compiled: Callable[..., Any] = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # no folder for the machine code can be written
        compiled = numba.njit(**options)(function)
    return compiled


@_compiled
def _raised(overlap: float, exponent: float) -> float:
    """``overlap^(1 + exponent)`` for the exponents of the laws of damping, by square roots only."""
    if exponent == 0.0:
        return overlap
    root = math.sqrt(overlap)
    if exponent == 0.25:
        return overlap * math.sqrt(root)
    if exponent == 0.5:
        return overlap * root
    return overlap * overlap * root


@_compiled
def _raised_slope(overlap: float, exponent: float) -> float:
    """Differentiate `_raised` by the overlap."""
    if exponent == 0.0:
        return 1.0
    root = math.sqrt(overlap)
    if exponent == 0.25:
        return 1.25 * math.sqrt(root)
    if exponent == 0.5:
        return 1.5 * root
    return 2.5 * overlap * root


@_compiled
def integrate(
    mass: FloatArray,
    stiffness: FloatArray,
    damping: FloatArray,
    static_force: FloatArray,
    static_overlap: FloatArray,
    gravity: float,
    impact_speed: float,
    sensor: int,
    retainer_force: float,
    step: float,
    weights: FloatArray,
    own_weights: FloatArray,
    residual_compliance: float,
    mobility: float,
    exponent: float,
    precompression: float,
    sensor_force: FloatArray,
    contact_force: FloatArray,
) -> tuple[float, int]:
    """Integrate a shot; fill `sensor_force`, float64, shape (n_steps,), and `contact_force`.

    Parameters
    ----------
    mass, stiffness, damping, static_force, static_overlap, gravity, impact_speed, sensor, precompression
        The fields of `granular_chain.Chain`; `damping` is its `dashpot_impulse_n_s_per_m`.
    retainer_force
        Constant force that carries the last sphere where there is no specimen; zero elsewhere.
    step
        h in s.
    weights
        float64, shape (10, n_modes). With y = phi z / omega, whose real parts add up to the deflection
        under the chain: cos and sin of omega h, then real and imaginary weights of I one, two and
        three steps ago and of S one step ago (`modal_weights`).
    own_weights
        float64, shape (6, n_modes): omega / phi, phi, real and imaginary weights of this step's own I
        and S.
    residual_compliance
        C of the modes above the cut, m/N.
    mobility
        Speed per force of an infinite thin plate, m/(s N); zero for every other specimen.
    exponent
        p of the dashpots: 0, 1/4, 1/2 or 3/2.
    contact_force
        Float64, shape (n_bodies, n_steps) for the force of every contact, (0, 0) where nobody asks.

    Returns
    -------
    residual_j
        Largest defect of the energy balance.
    reflection_step
        Step of the largest force between chain and plate: there the incident wave turns round.
    """
    n_bodies = mass.shape[0]
    last = n_bodies - 1
    n_modes = weights.shape[1]
    n_steps = sensor_force.shape[0]
    h24 = step / 24.0
    h38 = 9.0 * h24

    u = np.zeros(n_bodies)
    v0 = np.zeros(n_bodies)  # now, then one, two, three steps ago
    v1 = np.zeros(n_bodies)
    v2 = np.zeros(n_bodies)
    v3 = np.zeros(n_bodies)
    f0 = np.zeros(n_bodies)  # Hertz force less the static one
    f1 = np.zeros(n_bodies)
    f2 = np.zeros(n_bodies)
    gap = static_overlap.copy()  # d, negative where open
    overlap = static_overlap.copy()  # [d]_+
    impulse = np.zeros(n_bodies)  # integral of f
    total = np.zeros(n_bodies)  # B
    # Before first touch the striker fell freely and all else stood still: an exact history.
    v0[0] = impact_speed
    v1[0] = impact_speed - step * gravity
    v2[0] = impact_speed - 2.0 * step * gravity
    v3[0] = impact_speed - 3.0 * step * gravity

    cos, sin = weights[0], weights[1]
    a_re, a_im = weights[2], weights[3]
    b_re, b_im = weights[4], weights[5]
    c_re, c_im = weights[6], weights[7]
    s_re, s_im = weights[8], weights[9]
    y_re = np.zeros(n_modes)
    y_im = np.zeros(n_modes)
    i0 = i1 = i2 = 0.0  # I at the plate's contact
    s0 = s1 = s2 = 0.0  # S
    w_per_i = mobility + own_weights[2].sum()  # deflection by this step's own I and S
    w_per_s = mobility + own_weights[4].sum()
    a_plate = stiffness[last]
    g_plate = damping[last]
    n_plate = static_force[last]
    s_plate = g_plate * _raised(static_overlap[last], exponent)
    static_raised = np.empty(n_bodies)
    for i in range(n_bodies):
        static_raised[i] = _raised(static_overlap[i], exponent)
    past0 = past1 = past2 = static_overlap[last]  # d at the plate now, one and two steps ago
    observed = contact_force.shape[0] > 0
    # What 1 / gamma must make up for; see the head of this module.
    active = residual_compliance / (12.0 * step) + step / (3.0 * mass[last])
    if exponent == 0.0 and g_plate * active <= ACTIVE_PART_LIMIT:
        rate0, rate1, rate2, rate3 = 11.0 / 6.0, -3.0, 1.5, -1.0 / 3.0
    else:
        rate0, rate1, rate2, rate3 = 1.5, -2.0, 0.5, 0.0
    rate0 /= step
    rate1 /= step
    rate2 /= step
    rate3 /= step
    soft = a_plate * (h38 * (h38 / mass[last] + w_per_i) + residual_compliance)
    yielding = h38 / mass[last] + w_per_s + residual_compliance * rate0
    drag = 1.0 + g_plate * yielding

    dissipated = 0.0  # times the step
    worst = 0.0
    start = 0.5 * mass[0] * impact_speed**2 + 0.5 * residual_compliance * n_plate**2
    for i in range(n_bodies):
        start += 0.4 * stiffness[i] * static_overlap[i] ** 2.5
    # Contact and cut modes in series: together compressed by `stretch`, which has no jumps.
    rest = static_overlap[last] + residual_compliance * n_plate
    stretch = rest
    force = n_plate  # in the cut modes; they hold nothing while the contact is open
    stored = 0.4 * a_plate * static_overlap[last] ** 2.5 + 0.5 * residual_compliance * force**2
    largest = 0.0
    reflection_step = 0
    sensor_force[0] = 0.5 * (static_force[sensor - 1] + static_force[sensor])
    if observed:
        contact_force[:, 0] = static_force

    for n in range(1, n_steps):
        # The plate's deflection but for this step's own impulse.
        w_free = 0.0
        for k in range(n_modes):
            re = a_re[k] * i0 + b_re[k] * i1 + c_re[k] * i2 + s_re[k] * s0
            im = a_im[k] * i0 + b_im[k] * i1 + c_im[k] * i2 + s_im[k] * s0
            re += cos[k] * y_re[k] + sin[k] * y_im[k]
            im += cos[k] * y_im[k] - sin[k] * y_re[k]
            y_re[k] = re
            y_im[k] = im
            w_free += re

        # Predict the overlaps inside the chain and with them the impulses.
        below = u[0] + h24 * (55.0 * v0[0] - 59.0 * v1[0] + 37.0 * v2[0] - 9.0 * v3[0])
        for i in range(last):
            above = below
            j = i + 1
            below = u[j] + h24 * (55.0 * v0[j] - 59.0 * v1[j] + 37.0 * v2[j] - 9.0 * v3[j])
            p = max(above - below + static_overlap[i], 0.0)
            f = stiffness[i] * p * math.sqrt(p) - static_force[i]
            total[i] = (
                impulse[i]
                + h24 * (9.0 * f + 19.0 * f0[i] - 5.0 * f1[i] + f2[i])
                + damping[i] * (_raised(p, exponent) - static_raised[i])
            )

        # Solve the plate's contact: p + (..) p + (..) p^(3/2) = overlap without any new force.
        known = impulse[last] + h24 * (19.0 * f0[last] - 5.0 * f1[last] + f2[last] - 9.0 * n_plate)
        open_s = -s_plate
        past_rate = rate1 * s0 + rate2 * s1 + rate3 * s2
        w_known = w_free + w_per_i * known + w_per_s * open_s
        w_known += residual_compliance * (past_rate + rate0 * open_s - n_plate)
        u_known = u[last] + h24 * (
            9.0 * (total[last - 1] - known - open_s) / mass[last]
            + 19.0 * v0[last]
            - 5.0 * v1[last]
            + v2[last]
        )
        d_plate = u_known - w_known + static_overlap[last]
        p = 0.0
        if d_plate > 0.0:
            d_free = d_plate
            p = d_free / drag if overlap[last] <= 0.0 else overlap[last]
            for _ in range(60):
                root = math.sqrt(p)
                if exponent == 0.0:
                    change = (d_free - (drag + soft * root) * p) / (drag + 1.5 * soft * root)
                else:
                    miss = d_free - (1.0 + soft * root) * p - g_plate * yielding * _raised(p, exponent)
                    slope = 1.0 + 1.5 * soft * root + g_plate * yielding * _raised_slope(p, exponent)
                    change = miss / slope
                p = max(p + change, 0.0)
                if abs(change) <= 1e-13 * p:
                    break
            d_plate = p
        old_total = total[last]
        total[last] = known + h38 * a_plate * p * math.sqrt(p) + g_plate * _raised(p, exponent) + open_s

        # Correct velocities and displacements.
        above = mass[0] * (impact_speed + gravity * (n * step))
        for i in range(n_bodies):
            v = (above - total[i]) / mass[i]
            above = total[i]
            u[i] += h24 * (9.0 * v + 19.0 * v0[i] - 5.0 * v1[i] + v2[i])
            v3[i] = v2[i]
            v2[i] = v1[i]
            v1[i] = v0[i]
            v0[i] = v

        # Correct the forces and their impulses.
        for i in range(n_bodies):
            d = u[i] - u[i + 1] + static_overlap[i] if i < last else d_plate
            p = max(d, 0.0)
            f = stiffness[i] * p * math.sqrt(p) - static_force[i]
            impulse[i] += h24 * (9.0 * f + 19.0 * f0[i] - 5.0 * f1[i] + f2[i])
            f2[i] = f1[i]
            f1[i] = f0[i]
            f0[i] = f
            if i < last:
                given = _raised(p, exponent) - _raised(overlap[i], exponent)
                dissipated += damping[i] * given * (d - gap[i])
                gap[i] = d
                overlap[i] = p
        old_overlap = overlap[last]
        overlap[last] = max(d_plate, 0.0)
        i2 = i1
        i1 = i0
        i0 = impulse[last]
        s2 = s1
        s1 = s0
        s0 = g_plate * _raised(overlap[last], exponent) - s_plate

        # What the plate's contact and, at its release, the cut modes lose.
        old_stretch, old_stored = stretch, stored
        p = overlap[last]
        force = f0[last] + n_plate + rate0 * s0 + past_rate
        stretch = d_plate + residual_compliance * force
        stored = 0.0
        if p > 0.0:
            stored = 0.4 * a_plate * p * p * math.sqrt(p) + 0.5 * residual_compliance * force**2
        impulse_step = total[last] - old_total
        if p > 0.0 and old_overlap > 0.0:
            given = _raised(p, exponent) - _raised(old_overlap, exponent)
            dissipated += g_plate * given * (p - old_overlap)
        elif p > 0.0:  # touching for the part of the step in which `stretch` is positive
            part = stretch / (stretch - old_stretch) if old_stretch < 0.0 < stretch else 1.0
            dissipated += g_plate * _raised(p, exponent) * p / part
        else:
            work = (impulse_step + n_plate * step) * (stretch - old_stretch)
            dissipated += work - step * (stored - old_stored)
        dissipated += mobility * impulse_step**2
        if f0[last] > largest:
            largest = f0[last]
            reflection_step = n

        # The plate's speed is not known: its contact closes at the rate of the last four d.
        closing = (11.0 * d_plate - 18.0 * past0 + 9.0 * past1 - 2.0 * past2) / (6.0 * step)
        past2 = past1
        past1 = past0
        past0 = d_plate
        mean = 0.0
        for i in range(sensor - 1, sensor + 1):
            if overlap[i] > 0.0:
                rate = v0[i] - v0[i + 1] if i < last else closing
                mean += f0[i] + static_force[i] + damping[i] * _raised_slope(overlap[i], exponent) * rate
        sensor_force[n] = 0.5 * mean
        if observed:
            for i in range(n_bodies):
                contact_force[i, n] = 0.0
                if overlap[i] > 0.0:
                    rate = v0[i] - v0[i + 1] if i < last else closing
                    slope = _raised_slope(overlap[i], exponent)
                    contact_force[i, n] = f0[i] + static_force[i] + damping[i] * slope * rate

        if n % ENERGY_INTERVAL_STEPS == 0 or n == n_steps - 1:
            energy = dissipated / step + retainer_force * u[last]
            energy += n_plate * (u[last] - stretch + rest) + stored - precompression * u[1]
            for i in range(n_bodies):
                p = overlap[i]
                energy += 0.5 * mass[i] * v0[i] ** 2 - mass[i] * gravity * u[i]
                if i < last:
                    energy += 0.4 * stiffness[i] * p * p * math.sqrt(p)
            for k in range(n_modes):
                bent = y_re[k] + own_weights[2, k] * i0 + own_weights[4, k] * s0
                speed = y_im[k] + own_weights[3, k] * i0 + own_weights[5, k] * s0
                bent *= own_weights[0, k]
                speed = speed * own_weights[0, k] + own_weights[1, k] * (i0 + s0)
                energy += 0.5 * (speed * speed + bent * bent)
            # Written so that a value that is not a number ends up in `worst` as well.
            defect = abs(energy - start)
            if not defect <= worst:
                worst = defect
    return worst, reflection_step


def modal_weights(
    omega_rad_per_s: FloatArray, participation: FloatArray, step_s: float
) -> tuple[FloatArray, FloatArray]:
    """Weights and own weights of `integrate` for the modes of a plate.

    Parameters
    ----------
    omega_rad_per_s, participation
        Shape (n_modes,): circular frequency and mass-normalised deflection phi under the chain.
    step_s
        h; Gauss-Legendre with 24 points integrates the weights to rounding up to omega h = 10.
    """
    tau = 0.5 * (GAUSS_POINTS + 1.0)
    # tau in steps from the step's start. Cubic through I at tau = 1, 0, -1, -2; line through S at 1, 0.
    lagrange = np.stack(
        (
            tau * (tau + 1.0) * (tau + 2.0) / 6.0,
            -(tau - 1.0) * (tau + 1.0) * (tau + 2.0) / 2.0,
            (tau - 1.0) * tau * (tau + 2.0) / 2.0,
            -(tau - 1.0) * tau * (tau + 1.0) / 6.0,
            tau,
            1.0 - tau,
        )
    )
    phase = omega_rad_per_s[:, None] * step_s * (1.0 - tau)
    kernel = participation[:, None] ** 2 * (np.cos(phase) - 1j * np.sin(phase))
    own = (kernel * (0.5 * step_s * GAUSS_WEIGHTS)) @ lagrange.T  # shape (n_modes, 6)
    turn = np.cos(omega_rad_per_s * step_s) - 1j * np.sin(omega_rad_per_s * step_s)
    # What a step's own impulse adds is left out of y and made up for, turned, in the next step.
    rows = [turn.real, -turn.imag]
    for column in (turn * own[:, 0] + own[:, 1], own[:, 2], own[:, 3], turn * own[:, 4] + own[:, 5]):
        rows += [column.real, column.imag]
    own_rows = [omega_rad_per_s / participation, participation]
    for column in (own[:, 0], own[:, 4]):
        own_rows += [column.real, column.imag]
    return np.ascontiguousarray(rows), np.ascontiguousarray(own_rows)
