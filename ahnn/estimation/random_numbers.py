"""Random numbers of filters of samples, by counting: the same place gives the same numbers, on any device.

A generator that counts (Salmon, Moraes, Dror & Shaw 2011, "Parallel random numbers: as easy as 1, 2, 3";
Philox of numpy) has no state that would have to be carried along: a seed and a place in the filter's course
determine what is drawn there. So a filter stays a function of its state, and one that goes on from a saved
state draws what it would have drawn.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor


class RandomNumbers(NamedTuple):
    """What is drawn at one place.

    Attributes:
        seed: of the filter.
        step: predictions made so far.
        update: updates since the last of them, this one included; 0 for the prediction itself.
    """

    seed: int
    step: int
    update: int

    def normal(self, like: Tensor, *shape: int, stage: int = 0) -> Tensor:
        """Return standard normal numbers as float64, on the device of another tensor."""
        return torch.from_numpy(self._generator(2 * stage).standard_normal(shape)).to(like.device)

    def uniform(self, like: Tensor, *shape: int, stage: int = 0) -> Tensor:
        """Return numbers of [0, 1) as float64, on the device of another tensor."""
        return torch.from_numpy(self._generator(2 * stage + 1).random(shape)).to(like.device)

    def _generator(self, kind: int) -> np.random.Generator:
        counter = np.array([0, kind, self.update, self.step], dtype=np.uint64)
        return np.random.Generator(np.random.Philox(key=self.seed, counter=counter))
