"""Fused filter steps in one library call, for steps without decisions.

If complete rows of the first state components are measured and accepted by all members, only prediction,
posterior and sigma points are needed between two calls of the flow. The same functions are used as for single
steps: results are bitwise identical.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ahnn.dynamics.flow_at_time import at
from ahnn.estimation.belief import Belief
from ahnn.estimation.estimator import SensorModel
from ahnn.estimation.kernel import propagate, taken
from ahnn.estimation.loop import StepModel, stepper
from ahnn.estimation.state import FilterState
from ahnn.estimation.step_records import StepRecord
from ahnn.measurements import periods
from ahnn_plugins.ukf import members
from ahnn_plugins.ukf.sigma_points import draw
from ahnn_plugins.ukf.unscented_kernel import READINGS, SigmaPoints


class WholeSteps:
    """Steps of one run, with the pending sigma points.

    Args:
        rows: (B, T, M) measurements of the run.
        kernel: kernel for the other steps.
        smoothing: whether to keep the laws of a smoother, unsupported by fused steps.
    """

    def __init__(self, rows: Tensor, kernel: SigmaPoints, *, smoothing: bool = False) -> None:
        weights, form, _ = kernel
        missing = torch.isnan(rows).transpose(0, 1).flatten(1)
        self.whole, self.empty = (~missing.any(1)).tolist(), missing.all(1).tolist()
        known = not smoothing and form.read is not None and weights.crowding is None
        self.possible = [known and (a or b) for a, b in zip(self.whole, self.empty, strict=True)]
        self.rows, self.weights, self.kernel, self.smoothing = rows, weights, kernel, smoothing
        self.memory: members.Memory | None = None
        self.further: tuple[Belief, Tensor] | None = None
        self.seen: tuple[object, object, object] = None, None, None  # objects last checked by `_knows`
        self.noise: members.StepNoise | None = None  # result of that check

    def __call__(
        self, k: int, state: FilterState, row: Tensor | None, model: StepModel, length: float, time: Tensor
    ) -> tuple[FilterState, StepRecord]:
        """Return the state after step k, fused or not, and its record."""
        points = propagate(at(model.flow, state.time), self.points(state), length)
        done = self.step(k, state, points, time, model.chol_q, model.sensor)
        if done is None:
            single = stepper(self.kernel._replace(points=points), smoothing=self.smoothing)
            done = single(k, state, row, model, length, time)
        return done

    def points(self, state: FilterState) -> Tensor:
        """Return the sigma points (B, S, D) of a state, possibly drawn by the previous step."""
        if self.further is not None and self.further[0] is state.belief:
            return self.further[1]
        return draw(state.belief, self.weights)

    def step(
        self, k: int, state: FilterState, points: Tensor, time: Tensor, chol_q: Tensor, sensor: SensorModel
    ) -> tuple[FilterState, StepRecord] | None:
        """Return the state after step k from the points (B, S, D) after the flow, and its record.

        Returns:
            None if the step is unsupported by the library, or some result is invalid.
        """
        if not self.possible[k] or not self._knows(state, points, chol_q, sensor):
            return None
        if self.memory is None:
            self.memory = members.Memory(self.rows, points.shape[-1], self.weights)
        assert self.noise is not None
        whole = self.whole[k]
        further = self.memory.step(k, points, self.noise, measured=whole)
        if further is None:
            return None
        predicted, updated = self.memory.made(k)
        after = FilterState(predicted, time, state.steps + 1, *state[3:])
        after = taken(after, updated) if whole else after
        self.further = after.belief, further
        rejected = torch.zeros_like(updated.singular)
        told = (updated, rejected) if whole else (None, None)
        return after, StepRecord(predicted, after.belief, *told, None)

    def _knows(self, state: FilterState, points: Tensor, chol_q: Tensor, sensor: SensorModel) -> bool:
        """Return whether the library supports this step, and all members are active."""
        status, q, told = self.seen
        if not (status is state.status and q is chol_q and told is sensor):
            read = type(sensor.measurement) in READINGS and self.rows.shape[-1] <= points.shape[-1]
            if not read or bool(state.status.any()):
                return False
            if not members.apply_to(self.weights, chol_q, sensor.chol_r, self.rows):
                return False
            self.seen = state.status, chol_q, sensor
            limit = math.inf if sensor.thresholds is None else float(sensor.thresholds[-1])
            half = 0.5 * self.rows.new_tensor(periods(sensor.measurement))
            self.noise = members.StepNoise.of(chol_q, sensor.chol_r, limit, half)
        return members.apply_to(self.weights, points)
