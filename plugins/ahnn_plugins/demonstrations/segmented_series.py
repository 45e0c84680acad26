"""Long series of samples cut into segments in order of time."""

from __future__ import annotations

import numpy as np
import torch

from ahnn.types import Trajectories


def segmented(states: np.ndarray, times: np.ndarray, samples: int) -> Trajectories:
    """Cut series of several bodies into segments, ordered by start time and then body.

    A split by trajectory is then a split by time, without leakage of later data into training.

    Args:
        states: (N, T, D) states of the bodies, T a multiple of `samples`.
        times: (T,) common times, or (N, T).
        samples: samples per segment.
    """
    bodies, total, size = states.shape
    cut = states.reshape(bodies, total // samples, samples, size).swapaxes(0, 1)
    clock = np.broadcast_to(times, (bodies, total)).reshape(bodies, -1, samples).swapaxes(0, 1)
    return Trajectories(
        torch.from_numpy(cut.reshape(-1, samples, size).copy()),
        torch.from_numpy(clock.reshape(-1, samples).copy()),
    )
