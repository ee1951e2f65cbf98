"""The time loop of chain and plate, compiled.

Unknowns are the displacements u_i from the static equilibrium and, for every contact, the impulse

    B(t) = integral (F - F_static) dt = integral (A d^(3/2) - F_static) dt + g ([d]_+^q - d_static^q),

because the impulse of a dashpot that acts only in contact is g [d]_+^q with q = p + 1 and
``g = gamma / (q d_r^p)``; gamma [d]_+ for the linear one. Written this way the law of `chain.spheres` has a
continuous right-hand side although its force jumps at every release:

    v_i = v_i(0) + (B_(i-1) - B_i) / m_i,    du_i/dt = v_i.

Several shots that differ in speed and dashpots only are integrated side by side, one in each lane
(`numerics.lanes`). Nothing here depends on how many there are: a shot has the same digits alone as in any
company, on any machine.

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
from simulator.numerics.machine_code import compiled

FloatArray = NDArray[np.float64]
IntegerArray = NDArray[np.int64]

LAWS_OF_DAMPING = (0.0, 0.25, 0.5, 1.5)
"""Exponents p of the dashpots, the linear one first."""

WIDEST = 8
"""Shots side by side: eight float64 fill a register of 512 bits, and two of 256."""

ENERGY_INTERVAL_STEPS = 16
"""The energy balance is drawn up every so many steps and at the end."""

ACTIVE_PART_LIMIT = 0.5
"""The difference of order three is used up to this value of gamma (C / (12 h) + h / (3 m)); 1 may blow up."""

NEWTON_TOLERANCE = 1e-7
"""Last relative change of Newton's method; it converges quadratically, so the error is its square."""

CHORD_TOLERANCE = 1e-9
"""Last relative change with a slope that is off by some 1e-4: the error is that part of the change."""

BLOCK = 8
"""So many modes, or bodies, of a single shot are treated at a time."""

BANK_ROWS = 16
"""Numbers of a mode, see `simulator.shot.modal_weights`."""

# Rows of the state of all bodies but the last, and of the contacts below them.
U, V0, V1, V2, V3, F0, F1, F2, IMPULSE, TOTAL, GAP, OVERLAP, AHEAD, DISSIPATED = range(14)
STIFFNESS, DAMPING, STATIC_FORCE, STATIC_OVERLAP, INVERSE_MASS, ROWS = range(14, 20)


# No fast mathematics: each lane is rounded as if it were alone.
_compiled = compiled(nogil=True, error_model="numpy")


@_compiled
def _raised(overlap: Any, law: int) -> Any:
    """``overlap^(1 + p)``, by square roots only."""
    if law == 0:
        return overlap
    root = sqrt(overlap)
    if law == 1:
        return overlap * sqrt(root)
    if law == 2:
        return overlap * root
    return overlap * overlap * root


@_compiled
def _raised_slope(overlap: Any, law: int) -> Any:
    """Differentiate `_raised` by the overlap."""
    if law == 0:
        return overlap * 0.0 + 1.0
    root = sqrt(overlap)
    if law == 1:
        return 1.25 * sqrt(root)
    if law == 2:
        return 1.5 * root
    return 2.5 * overlap * root


@_compiled
def _struck_twice(
    x: FloatArray,
    row: int,
    width: int,
    k: int,
    mass: float,
    stiffness: float,
    gravity: float,
    step: float,
    n: int,
    launch_speed: FloatArray,
    speed: float,
) -> float:
    """Let the striker of lane `k` touch the body below it again at step `n`; returns the energy this gives.

    It was taken off before: its contact is open and has an open past. The impulse that it gave stays with
    the body below.
    """
    p = x[OVERLAP * row + k]
    gained = 0.5 * mass * (speed**2 - x[V0 * row + k] ** 2) - 0.4 * stiffness * p**2.5
    gained -= mass * gravity * (x[U * row + width + k] - x[U * row + k])
    impulse = x[TOTAL * row + width + k]
    x[IMPULSE * row + k] = impulse
    x[U * row + k] = x[U * row + width + k]
    for past in range(4):
        x[(V0 + past) * row + k] = speed - past * step * gravity
    for past in range(3):
        x[(F0 + past) * row + k] = 0.0
    x[OVERLAP * row + k] = x[GAP * row + k] = 0.0
    launch_speed[k] = speed - gravity * (n * step) + impulse / mass
    return float(gained)


@cache
def kernel(width: int, linear: bool) -> Callable[..., None]:
    """Compile the time loop for `width` shots side by side, with linear dashpots or with any.

    The function returned fills its last four arguments::

        integrate(mass, stiffness, damping, static_force, static_overlap, gravity, impact_speed, second_step,
                  second_speed, sensor, retainer_force, precompression, law, step, bank, residual_compliance,
                  mobility, interval, sensor_force, contact_force, residual_j, reflection_step)

    mass, stiffness, static_force, static_overlap, gravity, sensor, precompression
        The fields of `granular_chain.Chain`.
    damping
        float64, shape (n_bodies * width,): `Chain.dashpot_impulse_n_s_per_m` of every shot, the shots of
        a contact side by side.
    impact_speed
        float64, shape (width,).
    second_step, second_speed
        int64 and float64, shape (width,): at this step the striker, taken off before, touches the body below
        with that speed; a negative step: it strikes once.
    retainer_force
        Constant force that carries the last sphere where there is no specimen; zero elsewhere.
    law
        Index of the dashpots' exponent in `LAWS_OF_DAMPING`.
    step
        h in s.
    bank
        float64, shape (n_blocks * BANK_ROWS * BLOCK,): `modal_weights.modal_weights`.
    residual_compliance
        C of the modes above the cut, m/N.
    mobility
        Speed per force of an infinite thin plate, m/(s N); zero for every other specimen.
    interval
        The energy balance is drawn up every so many steps and at the end.
    sensor_force
        float64, shape (n_steps * width,).
    contact_force
        float64, shape (n_bodies * n_steps * width,) for the force of every contact, (0,) where nobody asks.
    residual_j
        float64, shape (width,): largest defect of the energy balance.
    reflection_step
        float64, shape (width,): step of the largest force between chain and plate; there the incident
        wave turns round.
    """
    made: Callable[..., None] = _compiled(_time_loop(width, linear))
    return made


def _time_loop(W: int, LINEAR: bool) -> Callable[..., None]:
    def integrate(
        mass: FloatArray,
        stiffness: FloatArray,
        damping: FloatArray,
        static_force: FloatArray,
        static_overlap: FloatArray,
        gravity: float,
        impact_speed: FloatArray,
        second_step: IntegerArray,
        second_speed: FloatArray,
        sensor: int,
        retainer_force: float,
        precompression: float,
        law_of_damping: int,
        step: float,
        bank: FloatArray,
        residual_compliance: float,
        mobility: float,
        interval: int,
        sensor_force: FloatArray,
        contact_force: FloatArray,
        residual_j: FloatArray,
        reflection_step: FloatArray,
    ) -> None:
        LAW = 0 if LINEAR else law_of_damping  # known while compiling where it is linear
        last = mass.shape[0] - 1
        n_blocks = bank.shape[0] // (BANK_ROWS * BLOCK)
        n_steps = sensor_force.shape[0] // W
        observed = contact_force.shape[0] > 0
        h24 = step / 24.0
        h38 = 9.0 * h24
        zero = broadcast(0.0, W)
        speed = load(impact_speed, 0, W)

        # All bodies but the last, body after body, of each all shots; BLOCK numbers are treated at a time.
        # What fills the last block up has neither stiffness nor dashpot nor speed.
        size = -(-last * W // BLOCK) * BLOCK
        row = size + W + BLOCK
        x = np.zeros(ROWS * row)
        for i in range(last):
            for k in range(i * W, i * W + W):
                x[OVERLAP * row + k] = x[GAP * row + k] = x[STATIC_OVERLAP * row + k] = static_overlap[i]
                x[STATIC_FORCE * row + k] = static_force[i]
                x[STIFFNESS * row + k] = stiffness[i]
                x[DAMPING * row + k] = damping[k]
                x[INVERSE_MASS * row + k] = 1.0 / mass[i]
        # Before first touch the striker fell freely and all else stood still: an exact history.
        store(x, V0 * row, speed)
        store(x, V1 * row, speed - step * gravity)
        store(x, V2 * row, speed - 2.0 * step * gravity)
        store(x, V3 * row, speed - 3.0 * step * gravity)
        # The last body.
        u = v0 = v1 = v2 = v3 = f0 = f1 = f2 = impulse = total = zero
        overlap = zero + static_overlap[last]
        per_mass = 1.0 / mass[last]

        y = np.zeros(2 * n_blocks * BLOCK * W)
        sums = np.zeros(BLOCK * W)
        i1 = i2 = zero  # I at the plate's contact one and two steps ago; `impulse` is the latest
        s0 = s1 = s2 = zero  # S
        w_per_i = w_per_s = mobility  # deflection by this step's own I and S
        w_per_last_i = w_per_last_s = 0.0  # and by the last step's
        for b in range(n_blocks):
            for j in range(BLOCK):
                k = b * BANK_ROWS * BLOCK + j
                w_per_i += bank[k + 12 * BLOCK]
                w_per_s += bank[k + 14 * BLOCK]
                w_per_last_i += bank[k + 2 * BLOCK]
                w_per_last_s += bank[k + 8 * BLOCK]
        a_plate = stiffness[last]
        g_plate = damping[last * W]  # of all shots
        n_plate = static_force[last]
        s_plate = g_plate * lane(_raised(broadcast(static_overlap[last], 1), LAW), 0)
        # What 1 / gamma must make up for; see the head of this module.
        active = residual_compliance / (12.0 * step) + step / (3.0 * mass[last])
        if LINEAR and g_plate * active <= ACTIVE_PART_LIMIT:
            rate0, rate1, rate2, rate3 = 11.0 / 6.0, -3.0, 1.5, -1.0 / 3.0
        else:
            rate0, rate1, rate2, rate3 = 1.5, -2.0, 0.5, 0.0
        rate0 /= step
        rate1 /= step
        rate2 /= step
        rate3 /= step
        soft = a_plate * (h38 * (h38 * per_mass + w_per_i) + residual_compliance)
        drag = g_plate * (h38 * per_mass + w_per_s + residual_compliance * rate0)

        dissipated = zero  # at the plate, times the step
        worst = zero
        energy = 0.5 * mass[0] * speed * speed + 0.5 * residual_compliance * n_plate**2
        for i in range(last + 1):
            energy = energy + 0.4 * stiffness[i] * static_overlap[i] ** 2.5
        given_energy = np.zeros(W)  # with the strikes
        store(given_energy, 0, energy)
        launch_speed = impact_speed.copy()
        # Contact and cut modes in series: together compressed by `stretch`, which has no jumps.
        rest = static_overlap[last] + residual_compliance * n_plate
        stretch = zero + rest
        # In the cut modes; they hold nothing while the contact is open.
        stored = zero + (0.4 * a_plate * static_overlap[last] ** 2.5 + 0.5 * residual_compliance * n_plate**2)
        past0 = past1 = past2 = zero + static_overlap[last]  # d at the plate now, one and two steps ago
        largest = turn = zero
        store(sensor_force, 0, zero + 0.5 * (static_force[sensor - 1] + static_force[sensor]))
        if observed:
            for i in range(last + 1):
                store(contact_force, i * n_steps * W, zero + static_force[i])

        def sum_of_eight() -> Any:
            front = (load(sums, 0, W) + load(sums, W, W)) + (load(sums, 2 * W, W) + load(sums, 3 * W, W))
            back = load(sums, 4 * W, W) + load(sums, 5 * W, W)
            return front + (back + (load(sums, 6 * W, W) + load(sums, 7 * W, W)))

        def force_at(i: int, at_plate: Any) -> Any:
            if i < last:
                p = load(x, OVERLAP * row + i * W, W)
                rate = load(x, V0 * row + i * W, W) - load(x, V0 * row + (i + 1) * W, W)
                hertz = load(x, F0 * row + i * W, W) + static_force[i]
            else:
                p = overlap
                rate = at_plate
                hertz = f0 + n_plate
            dashpot = load(damping, i * W, W) * _raised_slope(p, LAW) * rate
            return where_greater(p, zero, hertz + dashpot, zero)

        for n in range(1, n_steps):
            for k in range(W):
                if n - 1 == second_step[k]:
                    gained = _struck_twice(
                        x,
                        row,
                        W,
                        k,
                        mass[0],
                        stiffness[0],
                        gravity,
                        step,
                        n - 1,
                        launch_speed,
                        second_speed[k],
                    )
                    given_energy[k] += gained

            # The plate's deflection but for this step's own impulse, in sums of every eighth mode. What the
            # last step gave is added at the end: nothing else needs to wait for its contact.
            if W == 1:
                sum_of_blocks = broadcast(0.0, BLOCK)
                i0_, i1_, i2_, s0_ = lane(impulse, 0), lane(i1, 0), lane(i2, 0), lane(s0, 0)
                for b in range(n_blocks):
                    k = b * BANK_ROWS * BLOCK
                    m = 2 * b * BLOCK
                    y_re, y_im = load(y, m, BLOCK), load(y, m + BLOCK, BLOCK)
                    cos, sin = load(bank, k, BLOCK), load(bank, k + BLOCK, BLOCK)
                    re = fma(load(bank, k + 4 * BLOCK, BLOCK), i1_, cos * y_re)
                    im = fma(load(bank, k + 5 * BLOCK, BLOCK), i1_, cos * y_im)
                    re = fma(load(bank, k + 6 * BLOCK, BLOCK), i2_, re)
                    im = fma(load(bank, k + 7 * BLOCK, BLOCK), i2_, im)
                    re = fma(sin, y_im, re)
                    im = fma(sin, 0.0 - y_re, im)
                    sum_of_blocks = sum_of_blocks + re
                    re = fma(load(bank, k + 8 * BLOCK, BLOCK), s0_, re)
                    im = fma(load(bank, k + 9 * BLOCK, BLOCK), s0_, im)
                    store(y, m, fma(load(bank, k + 2 * BLOCK, BLOCK), i0_, re))
                    store(y, m + BLOCK, fma(load(bank, k + 3 * BLOCK, BLOCK), i0_, im))
                store(sums, 0, sum_of_blocks)
            else:
                for j in range(BLOCK):
                    store(sums, j * W, zero)
                for b in range(n_blocks):
                    for j in range(BLOCK):
                        k = b * BANK_ROWS * BLOCK + j
                        m = 2 * (b * BLOCK + j) * W
                        y_re, y_im = load(y, m, W), load(y, m + W, W)
                        cos, sin = bank[k], bank[k + BLOCK]
                        re = fma(bank[k + 4 * BLOCK], i1, cos * y_re)
                        im = fma(bank[k + 5 * BLOCK], i1, cos * y_im)
                        re = fma(bank[k + 6 * BLOCK], i2, re)
                        im = fma(bank[k + 7 * BLOCK], i2, im)
                        re = fma(sin, y_im, re)
                        im = fma(-sin, y_re, im)
                        store(sums, j * W, load(sums, j * W, W) + re)
                        re = fma(bank[k + 8 * BLOCK], s0, re)
                        im = fma(bank[k + 9 * BLOCK], s0, im)
                        store(y, m, fma(bank[k + 2 * BLOCK], impulse, re))
                        store(y, m + W, fma(bank[k + 3 * BLOCK], impulse, im))
            w_free = fma(impulse, w_per_last_i, fma(s0, w_per_last_s, sum_of_eight()))

            # Predict the overlaps inside the chain and with them the impulses.
            for k in range(0, size, BLOCK):
                past = fma(load(x, V2 * row + k, BLOCK), 37.0, -9.0 * load(x, V3 * row + k, BLOCK))
                past = fma(load(x, V1 * row + k, BLOCK), -59.0, past)
                past = fma(load(x, V0 * row + k, BLOCK), 55.0, past)
                store(x, AHEAD * row + k, fma(past, h24, load(x, U * row + k, BLOCK)))
            past = fma(v0, 55.0, fma(v1, -59.0, fma(v2, 37.0, -9.0 * v3)))
            store(x, AHEAD * row + last * W, fma(past, h24, u))
            # What moves the striker.
            store(x, TOTAL * row, mass[0] * (load(launch_speed, 0, W) + gravity * (n * step)))
            for k in range(0, size, BLOCK):
                q = load(x, STATIC_OVERLAP * row + k, BLOCK)
                p_ = load(x, AHEAD * row + k, BLOCK) - load(x, AHEAD * row + k + W, BLOCK) + q
                p_ = positive(p_)
                f = load(x, STIFFNESS * row + k, BLOCK) * p_ * sqrt(p_) - load(
                    x, STATIC_FORCE * row + k, BLOCK
                )
                past = fma(load(x, F1 * row + k, BLOCK), -5.0, load(x, F2 * row + k, BLOCK))
                past = fma(load(x, F0 * row + k, BLOCK), 19.0, past)
                given = fma(fma(f, 9.0, past), h24, load(x, IMPULSE * row + k, BLOCK))
                given = fma(load(x, DAMPING * row + k, BLOCK), _raised(p_, LAW) - _raised(q, LAW), given)
                store(x, TOTAL * row + k + W, given)
            above = load(x, TOTAL * row + last * W, W)

            # Correct velocities and displacements of all bodies but the last.
            for k in range(0, size, BLOCK):
                v = load(x, TOTAL * row + k, BLOCK) - load(x, TOTAL * row + k + W, BLOCK)
                v = v * load(x, INVERSE_MASS * row + k, BLOCK)
                v0_, v1_, v2_ = (
                    load(x, V0 * row + k, BLOCK),
                    load(x, V1 * row + k, BLOCK),
                    load(x, V2 * row + k, BLOCK),
                )
                past = fma(v0_, 19.0, fma(v1_, -5.0, v2_))
                store(x, U * row + k, fma(fma(v, 9.0, past), h24, load(x, U * row + k, BLOCK)))
                store(x, V3 * row + k, v2_)
                store(x, V2 * row + k, v1_)
                store(x, V1 * row + k, v0_)
                store(x, V0 * row + k, v)

            # Solve the plate's contact: p + (..) p^q + (..) p^(3/2) = overlap without any new force, for
            # the square root of p.
            past_f = fma(f0, 19.0, fma(f1, -5.0, f2))
            past_v = fma(v0, 19.0, fma(v1, -5.0, v2))
            known = fma(past_f - 9.0 * n_plate, h24, impulse)
            past_rate = rate1 * s0 + rate2 * s1 + rate3 * s2
            w_known = w_free + w_per_i * known - w_per_s * s_plate
            w_known = w_known + residual_compliance * (past_rate - (rate0 * s_plate + n_plate))
            u_known = fma(fma((above - known + s_plate) * per_mass, 9.0, past_v), h24, u)
            d_free = u_known - w_known + static_overlap[last]
            # Two steps with the slope where the last three overlaps point; that slope waits for nothing.
            root = sqrt(positive(3.0 * (past0 - past1) + past2))
            p = root * root
            if LINEAR:
                slope = fma(root, 3.0 * soft, zero + 2.0 * (1.0 + drag)) * root
            else:
                slope = (fma(root, 3.0 * soft, zero + 2.0) + 2.0 * drag * _raised_slope(p, LAW)) * root
            per_slope = 1.0 / slope
            change = zero
            for _ in range(2):
                p = root * root
                if LINEAR:
                    change = (d_free - fma(root, soft, zero + (1.0 + drag)) * p) * per_slope
                else:
                    miss = d_free - fma(root, soft, zero + 1.0) * p - drag * _raised(p, LAW)
                    change = miss * per_slope
                root = root + change
            # Newton's method where that has not converged or, after a touch, had no start: from the overlap
            # that there would be without the spring.
            going = unless_within(absolute(change), CHORD_TOLERANCE * root, zero + 1.0, zero)
            root = where_greater(going, zero, sqrt(positive(d_free * (1.0 / (1.0 + drag)))), root)
            going = where_greater(d_free, zero, going, zero)
            for _ in range(60):
                if all_positive(0.5 - going):
                    break
                p = root * root
                if LINEAR:
                    miss = d_free - fma(root, soft, zero + (1.0 + drag)) * p
                    slope = fma(root, 3.0 * soft, zero + 2.0 * (1.0 + drag)) * root
                else:
                    miss = d_free - fma(root, soft, zero + 1.0) * p - drag * _raised(p, LAW)
                    slope = (fma(root, 3.0 * soft, zero + 2.0) + 2.0 * drag * _raised_slope(p, LAW)) * root
                change = miss / slope
                root = where_greater(going, zero, root + change, root)
                going = where_greater(absolute(change), NEWTON_TOLERANCE * root, going, zero)
            root = where_greater(d_free, zero, root, zero)
            p = root * root
            hertz = a_plate * p * root
            d_plate = where_greater(d_free, zero, p, d_free)
            old_total = total
            s = g_plate * _raised(p, LAW) - s_plate
            total = known + h38 * hertz + s

            # Correct the last body, too.
            v = (above - total) * per_mass
            u = fma(fma(v, 9.0, past_v), h24, u)
            v3 = v2
            v2 = v1
            v1 = v0
            v0 = v
            store(x, U * row + last * W, u)
            store(x, V0 * row + last * W, v)

            # What the plate's contact and, at its release, the cut modes lose.
            old_overlap, old_stretch, old_stored = overlap, stretch, stored
            overlap = p
            f = hertz - n_plate
            i2 = i1
            i1 = impulse
            impulse = fma(fma(f, 9.0, past_f), h24, impulse)
            f2 = f1
            f1 = f0
            f0 = f
            force = hertz + rate0 * s + past_rate
            stretch = d_plate + residual_compliance * force
            stored = 0.4 * hertz * p + 0.5 * residual_compliance * force * force
            stored = where_greater(p, zero, stored, zero)
            impulse_step = total - old_total
            # Touching for the part of the step in which `stretch` is positive.
            part = where_greater(stretch, zero, stretch / (stretch - old_stretch), zero + 1.0)
            part = where_greater(zero, old_stretch, part, zero + 1.0)
            touching = (s + s_plate) * p / part
            work = (impulse_step + n_plate * step) * (stretch - old_stretch)
            opening = work - step * (stored - old_stored)
            lost = where_greater(old_overlap, zero, (s - s0) * (p - old_overlap), touching)
            lost = where_greater(p, zero, lost, opening)
            dissipated = dissipated + lost + mobility * impulse_step * impulse_step
            s2 = s1
            s1 = s0
            s0 = s
            turn = where_greater(f, largest, zero + float(n), turn)
            largest = where_greater(f, largest, f, largest)

            # Correct the forces and their impulses.
            for k in range(0, size, BLOCK):
                d = load(x, U * row + k, BLOCK) - load(x, U * row + k + W, BLOCK)
                d = d + load(x, STATIC_OVERLAP * row + k, BLOCK)
                p_ = positive(d)
                f_ = load(x, STIFFNESS * row + k, BLOCK) * p_ * sqrt(p_)
                f_ = f_ - load(x, STATIC_FORCE * row + k, BLOCK)
                f0_, f1_ = load(x, F0 * row + k, BLOCK), load(x, F1 * row + k, BLOCK)
                past = fma(f0_, 19.0, fma(f1_, -5.0, load(x, F2 * row + k, BLOCK)))
                store(x, IMPULSE * row + k, fma(fma(f_, 9.0, past), h24, load(x, IMPULSE * row + k, BLOCK)))
                store(x, F2 * row + k, f1_)
                store(x, F1 * row + k, f0_)
                store(x, F0 * row + k, f_)
                given = _raised(p_, LAW) - _raised(load(x, OVERLAP * row + k, BLOCK), LAW)
                given = given * load(x, DAMPING * row + k, BLOCK)
                given = fma(given, d - load(x, GAP * row + k, BLOCK), load(x, DISSIPATED * row + k, BLOCK))
                store(x, DISSIPATED * row + k, given)
                store(x, GAP * row + k, d)
                store(x, OVERLAP * row + k, p_)

            # The plate's speed is not known: its contact closes at the rate of the last four d.
            closing = (11.0 * d_plate - 18.0 * past0 + 9.0 * past1 - 2.0 * past2) * (1.0 / (6.0 * step))
            past2 = past1
            past1 = past0
            past0 = d_plate
            mean = force_at(sensor - 1, closing) + force_at(sensor, closing)
            store(sensor_force, n * W, 0.5 * mean)
            if observed:
                for i in range(last + 1):
                    store(contact_force, (i * n_steps + n) * W, force_at(i, closing))

            if n % interval == 0 or n == n_steps - 1:
                spent = dissipated
                for i in range(last):
                    spent = spent + load(x, DISSIPATED * row + i * W, W)
                energy = spent * (1.0 / step) + retainer_force * u
                energy = energy + n_plate * (u - stretch + rest) + stored
                energy = energy - precompression * load(x, U * row + W, W)
                for i in range(last + 1):
                    v = load(x, V0 * row + i * W, W)
                    fallen = load(x, U * row + i * W, W)
                    energy = energy + 0.5 * mass[i] * v * v - mass[i] * gravity * fallen
                    if i < last:
                        q = load(x, OVERLAP * row + i * W, W)
                        energy = energy + 0.4 * stiffness[i] * q * q * sqrt(q)
                for j in range(BLOCK):
                    store(sums, j * W, zero)
                for b in range(n_blocks):
                    for j in range(BLOCK):
                        k = b * BANK_ROWS * BLOCK + j
                        if W == 1:
                            m = 2 * b * BLOCK + j
                            re, im = load(y, m, W), load(y, m + BLOCK, W)
                        else:
                            m = 2 * (b * BLOCK + j) * W
                            re, im = load(y, m, W), load(y, m + W, W)
                        bent = re + bank[k + 12 * BLOCK] * impulse + bank[k + 14 * BLOCK] * s0
                        moving = im + bank[k + 13 * BLOCK] * impulse + bank[k + 15 * BLOCK] * s0
                        bent = bent * bank[k + 10 * BLOCK]
                        moving = moving * bank[k + 10 * BLOCK] + bank[k + 11 * BLOCK] * (impulse + s0)
                        bent = load(sums, j * W, W) + 0.5 * (moving * moving + bent * bent)
                        store(sums, j * W, bent)
                defect = absolute(energy + sum_of_eight() - load(given_energy, 0, W))
                # So that what is not a number ends up in `worst` as well.
                worst = unless_within(defect, worst, defect, worst)
        store(residual_j, 0, worst)
        store(reflection_step, 0, turn)

    return integrate
