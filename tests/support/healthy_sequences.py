"""Sequences of five features of a healthy sensor: with memory, heavy tails, a slow wander; known by name."""

import numpy as np
from scipy.signal import lfilter

P = 5
SETTLED = 300
"""Left out at the beginning, so that a sequence begins as it goes on (.99^300 = 5 %)."""
UNEQUAL = (0.7, 0.65, 0.3, 0.1, 0.4)
CORRELATED = np.full((P, P), 0.3) + 0.7 * np.eye(P)
CORRELATED[0, 1] = CORRELATED[1, 0] = 0.985
"""As the two times of flight are; a mild correlation of the others."""


def remembering(random_numbers, phi):
    """Return a first-order autoregression of each column, with the variance of its innovations."""
    made = [
        lfilter([np.sqrt(1.0 - f * f)], [1.0, -f], random_numbers[:, j])
        for j, f in enumerate(np.broadcast_to(phi, P))
    ]
    return np.stack(made, axis=1)[SETTLED:]


def healthy(name, n_sets, random):
    """Return sets of variance 1, shape (n_sets, 5)."""
    normal = random.standard_normal((n_sets + SETTLED, P))
    # Student's t with 5 degrees, all features by one divisor: a set as a whole is far off.
    heavy = normal * np.sqrt(3.0 / random.chisquare(5, (n_sets + SETTLED, 1)))
    match name:
        case "independent":
            return normal[SETTLED:]
        case "AR .3":
            return remembering(normal, 0.3)
        case "AR .6":
            return remembering(normal, 0.6)
        case "t5":
            return heavy[SETTLED:]
        case "t5, AR .6":
            return remembering(heavy, 0.6)
        case "unequal memory":
            return remembering(normal @ np.linalg.cholesky(CORRELATED).T, UNEQUAL)
        case "slow drift":
            wander = remembering(random.standard_normal((n_sets + SETTLED, P)), 0.99)
            return 0.5 * wander + np.sqrt(0.75) * normal[SETTLED:]
    raise ValueError(f"no healthy sequence is called {name!r}")


NAMES = ("independent", "AR .3", "AR .6", "t5", "t5, AR .6", "unequal memory", "slow drift")
