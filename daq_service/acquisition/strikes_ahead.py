"""Predict the strikes that follow a strike, so that the twin can compute them ahead."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence

from hardware_drivers.measurement import DueSet, ShotKey
from hardware_drivers.nanoseconds import NS_PER_S


def build_strike_predictor(
    sets: Sequence[DueSet], positions: Sequence[str], *, shots_per_set: int, shot_interval_s: float
) -> Callable[[ShotKey, int], Iterator[tuple[ShotKey, int]]]:
    """Build a function that predicts the strikes that `take_set` makes after a given strike.

    Parameters
    ----------
    sets
        Every planned set; the set of index k is the k-th.
    positions
        Solitary-wave positions, in the order in which they are struck.
    shot_interval_s
        Time between two strikes of a set, repetitions not counted.

    Returns
    -------
    Callable
        Takes a strike's key and its time (UTC in ns); yields the keys and times of those after it,
        through all later sets. It yields nothing for a position or shot that is not struck.
    """
    order = list(itertools.product(positions, range(shots_per_set)))
    slots_ns = [round(slot * shot_interval_s * NS_PER_S) for slot in range(len(order))]

    def yield_following_strikes(key: ShotKey, utc_ns: int) -> Iterator[tuple[ShotKey, int]]:
        """Yield keys and times (UTC in ns) of the strikes after this one, to the end of the schedule.

        An unscheduled set ends with its position; after it come the scheduled sets.
        """
        if (key.position, key.shot_index) not in order:
            return
        number = order.index((key.position, key.shot_index))
        start_ns = utc_ns - slots_ns[number]
        last = (number // shots_per_set + 1) * shots_per_set if key.unscheduled_index else len(order)
        following = itertools.islice(sets, key.set_index + 1, None)
        starts = itertools.chain(
            [(key.set_key, start_ns)], ((due.set_key, due.due_utc_ns) for due in following)
        )
        first_slot = number + 1
        for set_key, start_ns in starts:
            for slot, (position, shot_index) in enumerate(order[first_slot:last], first_slot):
                yield ShotKey.from_set(set_key, position, shot_index), start_ns + slots_ns[slot]
            first_slot, last = 0, len(order)

    return yield_following_strikes
