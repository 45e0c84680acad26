"""Long series of samples cut into stretches, in the order of time."""

from __future__ import annotations

import numpy as np
import torch

from ahnn.types import Trajectories


def stretches(states: np.ndarray, times: np.ndarray, samples: int) -> Trajectories:
    """Return the stretches of several bodies, those of all bodies that begin together next to each other.

    A split by trajectory is then one by time: what comes later is not seen by what comes before.

    Args:
        states: (N, T, D) of the bodies, T a multiple of `samples`.
        times: (T,) common to them, or (N, T).
        samples: of a stretch.
    """
    bodies, total, size = states.shape
    cut = states.reshape(bodies, total // samples, samples, size).swapaxes(0, 1)
    clock = np.broadcast_to(times, (bodies, total)).reshape(bodies, -1, samples).swapaxes(0, 1)
    return Trajectories(
        torch.from_numpy(cut.reshape(-1, samples, size).copy()),
        torch.from_numpy(clock.reshape(-1, samples).copy()),
    )
