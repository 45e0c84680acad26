"""Counter-based random numbers of sample filters, reproducible on any device.

A counter-based generator (Salmon, Moraes, Dror & Shaw 2011, "Parallel random numbers: as easy as 1, 2, 3";
Philox in numpy) needs no stored state: the seed and the counters of the filter determine each draw. A filter
step therefore remains a function of the filter state, and resuming from a saved state repeats the same draws.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor


class RandomNumbers(NamedTuple):
    """Random numbers at given filter counters.

    Attributes:
        seed: random seed of the filter.
        step: number of predictions so far.
        update: number of updates since the last prediction, including this one; 0 for the prediction itself.
    """

    seed: int
    step: int
    update: int

    def normal(self, like: Tensor, *shape: int, stage: int = 0) -> Tensor:
        """Return standard normal numbers as float64, on the device of another tensor."""
        return torch.from_numpy(self._generator(2 * stage).standard_normal(shape)).to(like.device)

    def uniform(self, like: Tensor, *shape: int, stage: int = 0) -> Tensor:
        """Return numbers in [0, 1) as float64, on the device of another tensor."""
        return torch.from_numpy(self._generator(2 * stage + 1).random(shape)).to(like.device)

    def _generator(self, kind: int) -> np.random.Generator:
        counter = np.array([0, kind, self.update, self.step], dtype=np.uint64)
        return np.random.Generator(np.random.Philox(key=self.seed, counter=counter))
