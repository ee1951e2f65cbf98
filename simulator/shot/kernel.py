"""Compiled time loop of chain and plate.

Unknowns are the displacements u_i from the static equilibrium and, for every contact, the impulse

    B(t) = integral (F - F_static) dt = integral (A d^(3/2) - F_static) dt + g ([d]_+^q - d_static^q),

because the impulse of a dashpot that acts only in contact is g [d]_+^q with q = p + 1 and
``g = gamma / (q d_r^p)``; gamma [d]_+ for the linear one. Written this way the law of `chain.spheres` has a
continuous right-hand side although its force jumps at every release:

    v_i = v_i(0) + (B_(i-1) - B_i) / m_i,    du_i/dt = v_i.

Several shots that differ in speed and contacts only are integrated side by side, one in each lane
(`numerics.lanes`). Nothing here depends on how many there are: a shot has the same digits alone as in any
company, on any machine.

Each step of length h is linear multistep of order four: Adams-Bashforth predicts the displacements,
Adams-Moulton corrects impulses and displacements. A mode of the plate, ``q'' + omega^2 q = phi F``, is
in the same way ``z' = -i omega z + omega phi B`` with ``z = omega q + i (q' - phi B)``; it is advanced
exactly for the cubic through the last four values of the integral I and for the straight line through
the last two of the dashpot's part S, ``B = I + S``: the line keeps any dashpot on any plate stable,
and S is a small part of B, so that the lower order is not seen. The contact with the plate is solved
implicitly with Newton's method. How `modal_weights` turns a mode with two additions and one product:
it is most of the work.

Modes above the cut follow the force statically, ``w = C (A d^(3/2) + dS/dt)``, with a backward
difference. That of order three is not passive: at some frequencies the real part of
deflection by impulse falls to -C / (12 h), as it falls to -h / (3 m) for Adams-Moulton on the last
sphere. A shot whose dashpot does not make up for both, ``1 / gamma > C / (12 h) + h / (3 m)``, may blow
up, and the more so the smaller h; there the difference is of order two, whose real part is positive.
Having no mass, these modes lose ``C F^2 / 2`` where the dashpot pulls with F as the contact opens; the
balance books that as lost. Touch and release are booked with the compression of contact and cut modes in
series, which has no jump.

The steps below are pasted into the loop, one file because numba keeps machine code until this file
changes. `registers` names what they share.

Away from touch and release the error falls as h^4; [d]_+ has a kink there, which limits the order to
two (5/2 without dashpots), with a small constant because a shot has only some twenty such events.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.numerics.lanes import (
    absolute,
    all_positive,
    broadcast,
    fma,
    lane,
    load,
    positive,
    sqrt,
    store,
    unless_within,
    where_greater,
)
from simulator.numerics.machine_code import jit_compile
from simulator.shot.registers import Bodies, Chains, Contact, LastBody, Propagator, Results, Strikes

FloatArray = NDArray[np.float64]

LAWS_OF_DAMPING = (0.0, 0.25, 0.5, 1.5)
"""Exponents p of the dashpots, the linear one first."""

WIDEST, NARROWEST = 8, 2
"""Shots side by side: eight float64 fill a register of 512 bits, and two of 256; two of a few shots leave no
more to wait for than one alone."""

ENERGY_INTERVAL_STEPS = 16
"""The energy balance is drawn up every so many steps and at the end."""

ACTIVE_PART_LIMIT = 0.5
"""The difference of order three is used up to this value of gamma (C / (12 h) + h / (3 m)); 1 may blow up."""

NEWTON_TOLERANCE = 1e-7
"""Last relative change of Newton's method; it converges quadratically, so the error is its square."""

CHORD_TOLERANCE = 1e-9
"""Last relative change with a slope that is off by some 1e-4: the error is that part of the change."""

BLOCK = 8
"""So many modes of a shot, or numbers of all bodies, are treated at a time."""

BANK_ROWS = 16
"""Numbers of a mode, see `simulator.shot.modal_weights`."""

# No fast mathematics: each lane is rounded as if it were alone.
_compiled = jit_compile(nogil=True, error_model="numpy")


@_compiled
def _power_of_overlap(overlap: Any, law: int) -> Any:
    """Compute ``overlap^(1 + p)``, p of index `law` in `LAWS_OF_DAMPING`, by square roots only.

    ``overlap`` is a vector in m, not negative.
    """
    if law == 0:
        return overlap
    root = sqrt(overlap)
    if law == 1:
        return overlap * sqrt(root)
    if law == 2:
        return overlap * root
    return overlap * overlap * root


@_compiled
def _slope_of_power(overlap: Any, law: int) -> Any:
    """Compute the derivative of `_power_of_overlap` by the overlap, ``(1 + p) overlap^p``."""
    if law == 0:
        return overlap * 0.0 + 1.0
    root = sqrt(overlap)
    if law == 1:
        return 1.25 * sqrt(root)
    if law == 2:
        return 1.5 * root
    return 2.5 * overlap * root


# A step is pasted into the time loop before types are known: the loop is compiled as one.
_step = jit_compile(inline="always", nogil=True, error_model="numpy")


@_step
def _set_bodies_at_rest(chains: Chains, speed: Any, step: float, width: int) -> Bodies:
    """Create the state of all bodies but the last: at rest, the striker with its exact past of free fall.

    ``speed`` is the impact speed in each lane in m/s, ``step`` the time step in s.
    """
    last = chains.mass.shape[0] - 1
    row = -(-last * width // BLOCK) * BLOCK + width + BLOCK
    overlap, gap, static_overlap = np.zeros(row), np.zeros(row), np.zeros(row)
    static_force, stiffness, dashpot = np.zeros(row), np.zeros(row), np.zeros(row)
    per_mass = np.zeros(row)
    for i in range(last):
        for k in range(i * width, i * width + width):
            overlap[k] = gap[k] = static_overlap[k] = chains.static_overlap[k]
            static_force[k] = chains.static_force[i]
            stiffness[k] = chains.stiffness[k]
            dashpot[k] = chains.dashpot[k]
            per_mass[k] = 1.0 / chains.mass[i]
    v0, v1, v2, v3 = np.zeros(row), np.zeros(row), np.zeros(row), np.zeros(row)
    store(v0, 0, speed)
    store(v1, 0, speed - step * chains.gravity)
    store(v2, 0, speed - 2.0 * step * chains.gravity)
    store(v3, 0, speed - 3.0 * step * chains.gravity)
    return Bodies(
        u=np.zeros(row),
        v0=v0,
        v1=v1,
        v2=v2,
        v3=v3,
        f0=np.zeros(row),
        f1=np.zeros(row),
        f2=np.zeros(row),
        impulse=np.zeros(row),
        given=np.zeros(row),
        gap=gap,
        overlap=overlap,
        ahead=np.zeros(row),
        dissipated=np.zeros(row),
        stiffness=stiffness,
        dashpot=dashpot,
        static_force=static_force,
        static_overlap=static_overlap,
        per_mass=per_mass,
    )


@_step
def _compute_contact_weights(
    chains: Chains, specimen: Propagator, step: float, width: int, law: int, linear: bool
) -> Contact:
    """Return the constants of a step that act on the contact with the plate, one lane per shot.

    ``step`` is in s, ``law`` an index of `LAWS_OF_DAMPING`; ``linear`` allows a difference of order three
    where the dashpot is weak enough.
    """
    last = chains.mass.shape[0] - 1
    bank, compliance = specimen.bank, specimen.residual_compliance_m_per_n
    w_per_i = w_per_s = specimen.mobility_m_per_n_s
    w_per_last_i = w_per_last_s = w_per_earlier_i = 0.0
    for b in range(bank.shape[0] // (BANK_ROWS * BLOCK)):
        for j in range(BLOCK):
            k = b * BANK_ROWS * BLOCK + j
            w_per_i += bank[k + 6 * BLOCK]
            w_per_s += bank[k + 7 * BLOCK]
            w_per_last_i += bank[k + BLOCK] - bank[k + 8 * BLOCK]
            w_per_last_s += bank[k + 3 * BLOCK]
            w_per_earlier_i -= bank[k + 9 * BLOCK]
    per_mass = 1.0 / chains.mass[last]
    stiffness, dashpot = (
        load(chains.stiffness, last * width, width),
        load(chains.dashpot, last * width, width),
    )
    static_overlap = load(chains.static_overlap, last * width, width)
    # What 1 / gamma must make up for; see the head of this module.
    active = compliance / (12.0 * step) + step / (3.0 * chains.mass[last])
    zero = broadcast(0.0, width)
    rate0, rate1, rate2, rate3 = zero + 1.5, zero - 2.0, zero + 0.5, zero
    if linear:
        strong = dashpot * active
        rate0 = where_greater(strong, ACTIVE_PART_LIMIT, rate0, zero + 11.0 / 6.0)
        rate1 = where_greater(strong, ACTIVE_PART_LIMIT, rate1, zero - 3.0)
        rate2 = where_greater(strong, ACTIVE_PART_LIMIT, rate2, zero + 1.5)
        rate3 = where_greater(strong, ACTIVE_PART_LIMIT, rate3, zero - 1.0 / 3.0)
    rate0 = rate0 / step
    h38 = 9.0 * (step / 24.0)
    return Contact(
        step=step,
        stiffness=stiffness,
        dashpot=dashpot,
        static_force=chains.static_force[last],
        static_overlap=static_overlap,
        static_dashpot=dashpot * _power_of_overlap(static_overlap, law),
        per_mass=per_mass,
        compliance=compliance,
        mobility=specimen.mobility_m_per_n_s,
        w_per_i=w_per_i,
        w_per_s=w_per_s,
        w_per_last_i=w_per_last_i,
        w_per_last_s=w_per_last_s,
        w_per_earlier_i=w_per_earlier_i,
        rate0=rate0,
        rate1=rate1 / step,
        rate2=rate2 / step,
        rate3=rate3 / step,
        soft=stiffness * (h38 * (h38 * per_mass + w_per_i) + compliance),
        drag=dashpot * (h38 * per_mass + w_per_s + compliance * rate0),
        rest=static_overlap + compliance * chains.static_force[last],
    )


@_step
def _set_last_body_at_rest(chains: Chains, contact: Contact, zero: Any, width: int) -> LastBody:
    """Create the state of the last body at rest under its static load, with its contact's stored energy.

    ``zero`` is a vector of ``width`` zeros, one lane per shot.
    """
    held = np.empty(width)
    row = (chains.mass.shape[0] - 1) * width
    for k in range(width):
        held[k] = 0.4 * chains.stiffness[row + k] * chains.static_overlap[row + k] ** 2.5
        held[k] += 0.5 * contact.compliance * contact.static_force**2
    overlap = zero + contact.static_overlap
    return LastBody(
        u=zero,
        v=(zero, zero, zero, zero),
        f=(zero, zero, zero),
        i=(zero, zero, zero),
        s=(zero, zero, zero),
        d=(overlap, overlap, overlap),
        total=zero,
        overlap=overlap,
        stretch=zero + contact.rest,
        stored=load(held, 0, width),
        dissipated=zero,
    )


@_step
def _compute_initial_energy(chains: Chains, strikes: Strikes, compliance: float, width: int) -> FloatArray:
    """Compute the initial energy of all contacts and the striker in J for each shot, shape (width,).

    ``compliance`` is that of the modes above the cut, in m/N.
    """
    last = chains.mass.shape[0] - 1
    energy = np.empty(width)
    for k in range(width):
        speed = strikes.speed[k]
        energy[k] = 0.5 * chains.mass[0] * speed * speed + 0.5 * compliance * chains.static_force[last] ** 2
        for i in range(last + 1):
            pressed = chains.static_overlap[i * width + k] ** 2.5
            energy[k] += 0.4 * chains.stiffness[i * width + k] * pressed
    return energy


@_step
def _apply_second_strike(
    bodies: Bodies,
    chains: Chains,
    launch_speed: FloatArray,
    n: int,
    k: int,
    width: int,
    step: float,
    speed: float,
) -> float:
    """Apply a second impact of the striker of lane `k` at step `n`; return the energy added in J.

    The striker was lifted before, so its contact starts open; the impulse that it gave stays with the body
    below. ``speed`` is that of the second impact in m/s. ``launch_speed`` is updated in place: the speed at
    the start with which the striker would have fallen freely to this one.
    """
    gravity, mass = chains.gravity, chains.mass[0]
    below = width + k
    pressed = 0.4 * chains.stiffness[k] * bodies.overlap[k] ** 2.5
    gained = 0.5 * mass * (speed**2 - bodies.v0[k] ** 2) - pressed
    gained -= mass * gravity * (bodies.u[below] - bodies.u[k])
    impulse = bodies.given[below]
    bodies.impulse[k] = impulse
    bodies.u[k] = bodies.u[below]
    bodies.v0[k] = speed
    bodies.v1[k] = speed - step * gravity
    bodies.v2[k] = speed - 2.0 * step * gravity
    bodies.v3[k] = speed - 3.0 * step * gravity
    bodies.f0[k] = bodies.f1[k] = bodies.f2[k] = 0.0
    bodies.overlap[k] = bodies.gap[k] = 0.0
    launch_speed[k] = speed - gravity * (n * step) + impulse / mass
    return float(gained)


@_step
def _advance_mode(
    bent: Any, gain: Any, m: Any, i_bends: Any, i_gains: Any, s_bends: Any, s_gains: Any, i0: Any, s0: Any
) -> Any:
    """Advance one mode by a step; return its deflection without the share of I and S, and its state.

    The state is ``bent`` and ``gain``, re and g of `modal_weights`; ``i0`` and ``s0`` are I and S of the last
    step, the other arguments weights. What the last step gave is added at the end: nothing else waits for its
    contact.
    """
    gain = fma(m, bent, gain)
    bent = bent + gain
    return bent, fma(i_bends, i0, fma(s_bends, s0, bent)), fma(i_gains, i0, fma(s_gains, s0, gain))


@_step
def _advance_modes_of_two(y: FloatArray, sums: FloatArray, bank: FloatArray, last: LastBody) -> None:
    """Advance the modes of a plate for two shots in place, eight modes of one shot at a time.

    ``y`` is their state, ``bank`` the result of `modal_weights`. `sums` then holds each shot's deflection
    without the share of this step's I and S.
    """
    total, other = broadcast(0.0, BLOCK), broadcast(0.0, BLOCK)
    i0, s0, i1, s1 = lane(last.i[0], 0), lane(last.s[0], 0), lane(last.i[0], 1), lane(last.s[0], 1)
    for b in range(bank.shape[0] // (BANK_ROWS * BLOCK)):
        k, m = b * BANK_ROWS * BLOCK, 4 * b * BLOCK
        turn = load(bank, k, BLOCK)
        i_bends, i_gains = load(bank, k + BLOCK, BLOCK), load(bank, k + 2 * BLOCK, BLOCK)
        s_bends, s_gains = load(bank, k + 3 * BLOCK, BLOCK), load(bank, k + 4 * BLOCK, BLOCK)
        bent, gain = load(y, m, BLOCK), load(y, m + BLOCK, BLOCK)
        seen, bent, gain = _advance_mode(bent, gain, turn, i_bends, i_gains, s_bends, s_gains, i0, s0)
        total = total + seen
        store(y, m, bent)
        store(y, m + BLOCK, gain)
        bent, gain = load(y, m + 2 * BLOCK, BLOCK), load(y, m + 3 * BLOCK, BLOCK)
        seen, bent, gain = _advance_mode(bent, gain, turn, i_bends, i_gains, s_bends, s_gains, i1, s1)
        other = other + seen
        store(y, m + 2 * BLOCK, bent)
        store(y, m + 3 * BLOCK, gain)
    _store_sums_of_two(sums, total, other)


@_step
def _store_sums_of_two(sums: FloatArray, total: Any, other: Any) -> None:
    """Store the sums of two shots in `sums` so that `_sum_eight_vectors` returns them unchanged."""
    n = 2 * BLOCK
    store(sums, n, total)
    store(sums, n + BLOCK, other)
    for k in range(2):
        front = (sums[n] + sums[n + 1]) + (sums[n + 2] + sums[n + 3])
        sums[k] = front + ((sums[n + 4] + sums[n + 5]) + (sums[n + 6] + sums[n + 7]))
        n += BLOCK


@_step
def _advance_modes_of_many(
    y: FloatArray, sums: FloatArray, bank: FloatArray, last: LastBody, width: int
) -> None:
    """Advance the modes of shots side by side in place, one mode of all shots at a time.

    ``y`` is their state, ``bank`` the result of `modal_weights`. `sums` then holds eight vectors, each the
    sum of every eighth mode's deflection.
    """
    for j in range(BLOCK):
        total = broadcast(0.0, width)
        for b in range(bank.shape[0] // (BANK_ROWS * BLOCK)):
            k, m = b * BANK_ROWS * BLOCK + j, 2 * (b * BLOCK + j) * width
            seen, bent, gain = _advance_mode(
                load(y, m, width),
                load(y, m + width, width),
                bank[k],
                bank[k + BLOCK],
                bank[k + 2 * BLOCK],
                bank[k + 3 * BLOCK],
                bank[k + 4 * BLOCK],
                last.i[0],
                last.s[0],
            )
            total = total + seen
            store(y, m, bent)
            store(y, m + width, gain)
        store(sums, j * width, total)


@_step
def _sum_eight_vectors(sums: FloatArray, width: int) -> Any:
    """Sum eight vectors of `sums` in a fixed order; return one vector of `width` lanes."""
    front = load(sums, 0, width) + load(sums, width, width)
    front = front + (load(sums, 2 * width, width) + load(sums, 3 * width, width))
    back = load(sums, 4 * width, width) + load(sums, 5 * width, width)
    return front + (back + (load(sums, 6 * width, width) + load(sums, 7 * width, width)))


@_step
def _predict_displacements(bodies: Bodies, last: LastBody, row_of_last: int, size: int, h24: float) -> None:
    """Predict the displacements of all bodies by an Adams-Bashforth step of order four, into `ahead`.

    ``h24`` is a 24th of the step in s; ``size`` numbers belong to the bodies but the last.
    """
    for k in range(0, size, BLOCK):
        past = fma(load(bodies.v2, k, BLOCK), 37.0, -9.0 * load(bodies.v3, k, BLOCK))
        past = fma(load(bodies.v1, k, BLOCK), -59.0, past)
        past = fma(load(bodies.v0, k, BLOCK), 55.0, past)
        store(bodies.ahead, k, fma(past, h24, load(bodies.u, k, BLOCK)))
    past = fma(last.v[0], 55.0, fma(last.v[1], -59.0, fma(last.v[2], 37.0, -9.0 * last.v[3])))
    store(bodies.ahead, row_of_last, fma(past, h24, last.u))


@_step
def _predict_impulses(bodies: Bodies, striker: Any, size: int, width: int, h24: float, law: int) -> None:
    """Compute the impulses on every body from the predicted overlaps, into `given`.

    `striker` is the impulse that moves the striker in N s, ``h24`` a 24th of the step in s, ``law`` an index
    of `LAWS_OF_DAMPING`.
    """
    store(bodies.given, 0, striker)
    for k in range(0, size, BLOCK):
        q = load(bodies.static_overlap, k, BLOCK)
        p = positive(load(bodies.ahead, k, BLOCK) - load(bodies.ahead, k + width, BLOCK) + q)
        f = load(bodies.stiffness, k, BLOCK) * p * sqrt(p) - load(bodies.static_force, k, BLOCK)
        past = fma(load(bodies.f1, k, BLOCK), -5.0, load(bodies.f2, k, BLOCK))
        past = fma(load(bodies.f0, k, BLOCK), 19.0, past)
        given = fma(fma(f, 9.0, past), h24, load(bodies.impulse, k, BLOCK))
        given = fma(
            load(bodies.dashpot, k, BLOCK), _power_of_overlap(p, law) - _power_of_overlap(q, law), given
        )
        store(bodies.given, k + width, given)


@_step
def _move_bodies(bodies: Bodies, size: int, width: int, h24: float) -> None:
    """Correct velocities and displacements of all bodies but the last in place (Adams-Moulton).

    ``h24`` is a 24th of the step in s; values of earlier steps move one step into the past.
    """
    for k in range(0, size, BLOCK):
        v = load(bodies.given, k, BLOCK) - load(bodies.given, k + width, BLOCK)
        v = v * load(bodies.per_mass, k, BLOCK)
        v0, v1, v2 = load(bodies.v0, k, BLOCK), load(bodies.v1, k, BLOCK), load(bodies.v2, k, BLOCK)
        past = fma(v0, 19.0, fma(v1, -5.0, v2))
        store(bodies.u, k, fma(fma(v, 9.0, past), h24, load(bodies.u, k, BLOCK)))
        store(bodies.v3, k, v2)
        store(bodies.v2, k, v1)
        store(bodies.v1, k, v0)
        store(bodies.v0, k, v)


@_step
def _solve_overlap_root(
    d_free: Any, last: LastBody, contact: Contact, zero: Any, law: int, linear: bool
) -> Any:
    """Solve ``p + drag p^q + soft p^(3/2) = d_free`` for the root of the overlap p; 0 if d_free is negative.

    Two chord steps take the slope at the overlap extrapolated from the last three, which waits for nothing.
    Newton's method, at most 60 steps, finishes lanes that have not converged.
    """
    soft, drag = contact.soft, contact.drag
    root = sqrt(positive(3.0 * (last.d[0] - last.d[1]) + last.d[2]))
    p = root * root
    if linear:
        slope = fma(root, 3.0 * soft, zero + 2.0 * (1.0 + drag)) * root
    else:
        slope = (fma(root, 3.0 * soft, zero + 2.0) + 2.0 * drag * _slope_of_power(p, law)) * root
    per_slope = 1.0 / slope
    change = zero
    for _ in range(2):
        p = root * root
        if linear:
            change = (d_free - fma(root, soft, zero + (1.0 + drag)) * p) * per_slope
        else:
            miss = d_free - fma(root, soft, zero + 1.0) * p - drag * _power_of_overlap(p, law)
            change = miss * per_slope
        root = root + change
    # Newton's method where that has not converged or, after a touch, had no start: from the overlap that
    # there would be without the spring.
    going = unless_within(absolute(change), CHORD_TOLERANCE * root, zero + 1.0, zero)
    root = where_greater(going, zero, sqrt(positive(d_free * (1.0 / (1.0 + drag)))), root)
    going = where_greater(d_free, zero, going, zero)
    for _ in range(60):
        if all_positive(0.5 - going):
            break
        p = root * root
        if linear:
            miss = d_free - fma(root, soft, zero + (1.0 + drag)) * p
            slope = fma(root, 3.0 * soft, zero + 2.0 * (1.0 + drag)) * root
        else:
            miss = d_free - fma(root, soft, zero + 1.0) * p - drag * _power_of_overlap(p, law)
            slope = (fma(root, 3.0 * soft, zero + 2.0) + 2.0 * drag * _slope_of_power(p, law)) * root
        change = miss / slope
        root = where_greater(going, zero, root + change, root)
        going = where_greater(absolute(change), NEWTON_TOLERANCE * root, going, zero)
    return where_greater(d_free, zero, root, zero)


@_step
def _solve_plate_contact(
    last: LastBody, contact: Contact, above: Any, w_free: Any, zero: Any, law: int, linear: bool
) -> LastBody:
    """Solve the contact with the plate implicitly; return the last body after the step.

    `above` is the impulse on it from the contact above in N s, ``w_free`` the plate's deflection in m without
    the share of this step's I and S.
    """
    h24 = contact.step / 24.0
    h38 = 9.0 * h24
    n_plate, s_plate, per_mass = contact.static_force, contact.static_dashpot, contact.per_mass
    past_f = fma(last.f[0], 19.0, fma(last.f[1], -5.0, last.f[2]))
    past_v = fma(last.v[0], 19.0, fma(last.v[1], -5.0, last.v[2]))
    known = fma(past_f - 9.0 * n_plate, h24, last.i[0])
    past_rate = contact.rate1 * last.s[0] + contact.rate2 * last.s[1] + contact.rate3 * last.s[2]
    w_known = w_free + contact.w_per_i * known - contact.w_per_s * s_plate
    w_known = w_known + contact.compliance * (past_rate - (contact.rate0 * s_plate + n_plate))
    u_known = fma(fma((above - known + s_plate) * per_mass, 9.0, past_v), h24, last.u)
    d_free = u_known - w_known + contact.static_overlap
    root = _solve_overlap_root(d_free, last, contact, zero, law, linear)
    p = root * root
    hertz = contact.stiffness * p * root
    d = where_greater(d_free, zero, p, d_free)
    s = contact.dashpot * _power_of_overlap(p, law) - s_plate
    total = known + h38 * hertz + s
    v = (above - total) * per_mass
    f = hertz - n_plate
    force = hertz + contact.rate0 * s + past_rate
    stored = 0.4 * hertz * p + 0.5 * contact.compliance * force * force
    stored = where_greater(p, zero, stored, zero)
    stretch = d + contact.compliance * force
    dissipated = _add_plate_losses(last, contact, p, s, total, stretch, stored, zero)
    return LastBody(
        u=fma(fma(v, 9.0, past_v), h24, last.u),
        v=(v, last.v[0], last.v[1], last.v[2]),
        f=(f, last.f[0], last.f[1]),
        i=(fma(fma(f, 9.0, past_f), h24, last.i[0]), last.i[0], last.i[1]),
        s=(s, last.s[0], last.s[1]),
        d=(d, last.d[0], last.d[1]),
        total=total,
        overlap=p,
        stretch=stretch,
        stored=stored,
        dissipated=dissipated,
    )


@_step
def _add_plate_losses(
    last: LastBody, contact: Contact, p: Any, s: Any, total: Any, stretch: Any, stored: Any, zero: Any
) -> Any:
    """Return the dissipation at the plate, times the step, with this step's losses, also at a release.

    ``p`` is the overlap, ``s`` and ``total`` the impulses of dashpot and contact, ``stretch`` and ``stored``
    compression and energy of contact and cut modes, all after the step.
    """
    impulse = total - last.total
    # Touching for the part of the step in which `stretch` is positive.
    part = where_greater(stretch, zero, stretch / (stretch - last.stretch), zero + 1.0)
    part = where_greater(zero, last.stretch, part, zero + 1.0)
    touching = (s + contact.static_dashpot) * p / part
    work = (impulse + contact.static_force * contact.step) * (stretch - last.stretch)
    opening = work - contact.step * (stored - last.stored)
    lost = where_greater(last.overlap, zero, (s - last.s[0]) * (p - last.overlap), touching)
    lost = where_greater(p, zero, lost, opening)
    return last.dissipated + lost + contact.mobility * impulse * impulse


@_step
def _correct_forces(bodies: Bodies, size: int, width: int, h24: float, law: int) -> None:
    """Correct forces inside the chain and their impulses in place; add the losses of the dashpots.

    ``h24`` is a 24th of the step in s; the losses are counted times the step.
    """
    for k in range(0, size, BLOCK):
        d = load(bodies.u, k, BLOCK) - load(bodies.u, k + width, BLOCK)
        d = d + load(bodies.static_overlap, k, BLOCK)
        p = positive(d)
        f = load(bodies.stiffness, k, BLOCK) * p * sqrt(p)
        f = f - load(bodies.static_force, k, BLOCK)
        f0, f1 = load(bodies.f0, k, BLOCK), load(bodies.f1, k, BLOCK)
        past = fma(f0, 19.0, fma(f1, -5.0, load(bodies.f2, k, BLOCK)))
        store(bodies.impulse, k, fma(fma(f, 9.0, past), h24, load(bodies.impulse, k, BLOCK)))
        store(bodies.f2, k, f1)
        store(bodies.f1, k, f0)
        store(bodies.f0, k, f)
        taken = _power_of_overlap(p, law) - _power_of_overlap(load(bodies.overlap, k, BLOCK), law)
        taken = taken * load(bodies.dashpot, k, BLOCK)
        taken = fma(taken, d - load(bodies.gap, k, BLOCK), load(bodies.dissipated, k, BLOCK))
        store(bodies.dissipated, k, taken)
        store(bodies.gap, k, d)
        store(bodies.overlap, k, p)


@_step
def _compute_contact_force(
    i: int,
    bodies: Bodies,
    last: LastBody,
    contact: Contact,
    chains: Chains,
    closing: Any,
    width: int,
    law: int,
) -> Any:
    """Compute the force of contact i in N, one lane per shot; 0 where the contact is open.

    `closing` is the rate in m/s at which the contact with the plate is pressed.
    """
    if i < chains.mass.shape[0] - 1:
        p = load(bodies.overlap, i * width, width)
        rate = load(bodies.v0, i * width, width) - load(bodies.v0, (i + 1) * width, width)
        hertz = load(bodies.f0, i * width, width) + chains.static_force[i]
    else:
        p = last.overlap
        rate = closing
        hertz = last.f[0] + contact.static_force
    dashpot = load(chains.dashpot, i * width, width) * _slope_of_power(p, law) * rate
    zero = broadcast(0.0, width)
    return where_greater(p, zero, hertz + dashpot, zero)


@_step
def _sum_body_energy(bodies: Bodies, last: LastBody, contact: Contact, chains: Chains, width: int) -> Any:
    """Sum energy and losses of chain and contacts in J, without the modes of the plate.

    The result has one lane per shot; it stays constant with the energy of the modes added.
    """
    n_last = chains.mass.shape[0] - 1
    spent = last.dissipated
    for i in range(n_last):
        spent = spent + load(bodies.dissipated, i * width, width)
    energy = spent * (1.0 / contact.step) + chains.retainer_force * last.u
    energy = energy + contact.static_force * (last.u - last.stretch + contact.rest) + last.stored
    energy = energy - chains.precompression * load(bodies.u, width, width)
    for i in range(n_last + 1):
        v = load(bodies.v0, i * width, width)
        fallen = load(bodies.u, i * width, width)
        energy = energy + 0.5 * chains.mass[i] * v * v - chains.mass[i] * chains.gravity * fallen
        if i < n_last:
            q = load(bodies.overlap, i * width, width)
            energy = energy + 0.4 * load(chains.stiffness, i * width, width) * q * q * sqrt(q)
    return energy


@_step
def _sum_mode_energy_of_two(y: FloatArray, sums: FloatArray, bank: FloatArray, last: LastBody) -> None:
    """Sum the energy in J of the plate's modes of two shots, into `sums`."""
    total, other = broadcast(0.0, BLOCK), broadcast(0.0, BLOCK)
    i, s = last.i, last.s[0]
    of_first = lane(i[0], 0), lane(i[1], 0), lane(i[2], 0), lane(s, 0)
    of_second = lane(i[0], 1), lane(i[1], 1), lane(i[2], 1), lane(s, 1)
    for b in range(bank.shape[0] // (BANK_ROWS * BLOCK)):
        k, m = b * BANK_ROWS * BLOCK, 4 * b * BLOCK
        bending = (
            load(bank, k + 5 * BLOCK, BLOCK),
            load(bank, k + 6 * BLOCK, BLOCK),
            load(bank, k + 8 * BLOCK, BLOCK),
            load(bank, k + 9 * BLOCK, BLOCK),
            load(bank, k + 7 * BLOCK, BLOCK),
        )
        moving = (
            load(bank, k + 10 * BLOCK, BLOCK),
            load(bank, k + 11 * BLOCK, BLOCK),
            load(bank, k + 12 * BLOCK, BLOCK),
            load(bank, k + 13 * BLOCK, BLOCK),
            load(bank, k + 14 * BLOCK, BLOCK),
            load(bank, k + 15 * BLOCK, BLOCK),
        )
        bent, gain = load(y, m, BLOCK), load(y, m + BLOCK, BLOCK)
        total = total + _compute_mode_energy(bent, gain, of_first, bending, moving)
        bent, gain = load(y, m + 2 * BLOCK, BLOCK), load(y, m + 3 * BLOCK, BLOCK)
        other = other + _compute_mode_energy(bent, gain, of_second, bending, moving)
    _store_sums_of_two(sums, total, other)


@_step
def _sum_mode_energy_of_many(
    y: FloatArray, sums: FloatArray, bank: FloatArray, last: LastBody, width: int
) -> None:
    """Sum the energy in J of the plate's modes of ``width`` shots, into `sums`."""
    acting = last.i[0], last.i[1], last.i[2], last.s[0]
    for j in range(BLOCK):
        total = broadcast(0.0, width)
        for b in range(bank.shape[0] // (BANK_ROWS * BLOCK)):
            k, m = b * BANK_ROWS * BLOCK + j, 2 * (b * BLOCK + j) * width
            bending = (
                bank[k + 5 * BLOCK],
                bank[k + 6 * BLOCK],
                bank[k + 8 * BLOCK],
                bank[k + 9 * BLOCK],
                bank[k + 7 * BLOCK],
            )
            moving = (
                bank[k + 10 * BLOCK],
                bank[k + 11 * BLOCK],
                bank[k + 12 * BLOCK],
                bank[k + 13 * BLOCK],
                bank[k + 14 * BLOCK],
                bank[k + 15 * BLOCK],
            )
            bent, gain = load(y, m, width), load(y, m + width, width)
            total = total + _compute_mode_energy(bent, gain, acting, bending, moving)
        store(sums, j * width, total)


@_step
def _compute_mode_energy(bent: Any, gain: Any, acting: Any, bending: Any, moving: Any) -> Any:
    """Compute the energy of a mode in J from its state and ``acting``: I now, one and two steps ago, S now.

    ``bending`` and ``moving`` are the rows of `modal_weights` that lead to deflection and speed.
    """
    speed = fma(moving[0], gain, moving[1] * bent)
    speed = fma(moving[2], acting[0], fma(moving[3], acting[1], speed))
    speed = fma(moving[4], acting[2], fma(moving[5], acting[3], speed))
    bent = bent - (bending[2] * acting[1] + bending[3] * acting[2])
    bent = bending[0] * (bent + (bending[1] * acting[0] + bending[4] * acting[3]))
    return 0.5 * fma(speed, speed, bent * bent)


@cache
def compile_time_loop(width: int, linear: bool) -> Callable[..., None]:
    """Compile the time loop for `width` shots side by side, with linear dashpots or with any.

    The function returned fills the arrays of `found`::

        integrate(chains, strikes, specimen, law, step, interval, found)

    law
        Index of the dashpots' exponent in `LAWS_OF_DAMPING`.
    step
        h in s.
    interval
        The energy balance is drawn up every so many steps and at the end.
    """
    time_loop: Callable[..., None] = _compiled(_make_time_loop(width, linear))
    return time_loop


def _make_time_loop(W: int, LINEAR: bool) -> Callable[..., None]:
    """Create the time loop of ``W`` shots at once, not compiled yet, for linear or other dashpots."""

    def integrate(
        chains: Chains,
        strikes: Strikes,
        specimen: Propagator,
        law_of_damping: int,
        step: float,
        interval: int,
        found: Results,
    ) -> None:
        """Integrate all lanes over the record; write the results into `found`."""
        law = 0 if LINEAR else law_of_damping  # known while compiling where it is linear
        last_body = chains.mass.shape[0] - 1
        size = -(-last_body * W // BLOCK) * BLOCK
        n_steps = found.sensor_force.shape[0] // W
        bank = specimen.bank
        h24 = step / 24.0
        zero = broadcast(0.0, W)
        speed = load(strikes.speed, 0, W)
        bodies = _set_bodies_at_rest(chains, speed, step, W)
        contact = _compute_contact_weights(chains, specimen, step, W, law, LINEAR)
        last = _set_last_body_at_rest(chains, contact, zero, W)
        y = np.zeros(bank.shape[0] // (BANK_ROWS * BLOCK) * 2 * BLOCK * W)  # two numbers a mode
        sums = np.zeros(BLOCK * (W + NARROWEST))
        given_energy = _compute_initial_energy(chains, strikes, contact.compliance, W)  # with the strikes
        launch_speed = strikes.speed.copy()
        worst = largest = turn = zero
        for i in range(last_body + 1):
            if found.contact_force.shape[0]:
                store(found.contact_force, i * n_steps * W, zero + chains.static_force[i])
        at_sensor = chains.static_force[chains.sensor - 1] + chains.static_force[chains.sensor]
        store(found.sensor_force, 0, zero + 0.5 * at_sensor)

        for n in range(1, n_steps):
            for k in range(W):
                if n - 1 == strikes.second_step[k]:
                    second_speed = strikes.second_speed[k]
                    gained = _apply_second_strike(
                        bodies, chains, launch_speed, n - 1, k, W, step, second_speed
                    )
                    given_energy[k] += gained

            if W == NARROWEST:
                _advance_modes_of_two(y, sums, bank, last)
            else:
                _advance_modes_of_many(y, sums, bank, last, W)
            w_free = fma(last.i[1], contact.w_per_earlier_i, _sum_eight_vectors(sums, W))
            w_free = fma(last.s[0], contact.w_per_last_s, w_free)
            w_free = fma(last.i[0], contact.w_per_last_i, w_free)
            _predict_displacements(bodies, last, last_body * W, size, h24)
            striker = chains.mass[0] * (load(launch_speed, 0, W) + chains.gravity * (n * step))
            _predict_impulses(bodies, striker, size, W, h24, law)
            above = load(bodies.given, last_body * W, W)
            _move_bodies(bodies, size, W, h24)

            before = last
            last = _solve_plate_contact(before, contact, above, w_free, zero, law, LINEAR)
            store(bodies.u, last_body * W, last.u)
            store(bodies.v0, last_body * W, last.v[0])
            turn = where_greater(last.f[0], largest, zero + float(n), turn)
            largest = where_greater(last.f[0], largest, last.f[0], largest)
            _correct_forces(bodies, size, W, h24, law)

            # The plate's speed is not known: its contact closes at the rate of the last four d.
            closing = 11.0 * last.d[0] - 18.0 * last.d[1] + 9.0 * last.d[2] - 2.0 * before.d[2]
            closing = closing * (1.0 / (6.0 * step))
            over = _compute_contact_force(chains.sensor - 1, bodies, last, contact, chains, closing, W, law)
            under = _compute_contact_force(chains.sensor, bodies, last, contact, chains, closing, W, law)
            store(found.sensor_force, n * W, 0.5 * (over + under))
            if found.contact_force.shape[0]:
                for i in range(last_body + 1):
                    force = _compute_contact_force(i, bodies, last, contact, chains, closing, W, law)
                    store(found.contact_force, (i * n_steps + n) * W, force)

            if n % interval == 0 or n == n_steps - 1:
                energy = _sum_body_energy(bodies, last, contact, chains, W)
                if W == NARROWEST:
                    _sum_mode_energy_of_two(y, sums, bank, last)
                else:
                    _sum_mode_energy_of_many(y, sums, bank, last, W)
                energy = energy + _sum_eight_vectors(sums, W)
                defect = absolute(energy - load(given_energy, 0, W))
                # So that what is not a number ends up in `worst` as well.
                worst = unless_within(defect, worst, defect, worst)
        store(found.defect_j, 0, worst)
        store(found.reflection_step, 0, turn)

    return integrate
