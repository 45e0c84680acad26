"""An estimator with its process model, for measurements at any times."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import torch

from ahnn.estimation.belief import Belief
from ahnn.estimation.covariances import Covariance
from ahnn.estimation.estimator import RecursiveEstimator, S
from ahnn.measurements import Measurement
from ahnn.substeps import substeps
from ahnn.types import Flow


def same(value: Any) -> Any:
    """Return what is given."""
    return value


class Process(NamedTuple):
    """An estimator with its process model.

    Attributes:
        estimator: it predicts and updates.
        flow: the process model.
        noise: Q of a step, as a function of its length.
        max_step: longest step of the flow; longer gaps are cut into equal ones.
        lifted: from a belief about the state to one about all that is estimated, the state first.
        seen: from a measurement model of the state to one of all that is estimated.
        about: plain values that say what this is.
    """

    estimator: RecursiveEstimator[Any]
    flow: Flow
    noise: Callable[[float], Covariance]
    max_step: float
    lifted: Callable[[Belief], Belief] = same
    seen: Callable[[Measurement], Measurement] = same
    about: dict[str, Any] = {}  # noqa: RUF012 - never written to

    def advanced(self, state: S, since: float, time: float) -> S:
        """Return the state of the time `since` at a later one."""
        gap = time - since
        if not gap > 0.0:
            return state
        count = substeps(gap, self.max_step)
        length = gap / count
        for _ in range(count):
            state = self.estimator.predict(state, self.flow, length, self.noise(length))
        return state._replace(time=torch.tensor(time, dtype=torch.float64))
