"""An estimator with its process model, for measurements at any times."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any, NamedTuple

import torch

from ahnn.controls import ControlTable
from ahnn.dynamics.flow_at_time import steered
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

    def advanced(self, state: S, since: float, time: float, controls: ControlTable | None = None) -> S:
        """Return the state of the time `since` at a later one.

        Args:
            state: of the estimator.
            since: its time.
            time: the later one.
            controls: of a flow that has some, from `since` on; no step crosses a jump of them.
        """
        if not time > since:
            return state
        flow, ends = self.flow, [since, time]
        if controls is not None:
            known = controls.over(torch.tensor(ends, dtype=torch.float64))
            flow, ends = steered(flow, known.times, known.values, linear=known.linear), known.times.tolist()
        for begin, end in pairwise(ends):
            count = substeps(end - begin, self.max_step)
            length = (end - begin) / count
            for _ in range(count):
                state = self.estimator.predict(state, flow, length, self.noise(length))
            state = state._replace(time=torch.tensor(end, dtype=torch.float64))
        return state
