"""Sequences of filter steps in one library call, which calls the flow in C or in torch."""

from __future__ import annotations

import ctypes
import math
from functools import cache
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.compiled_libraries import NUMBER as N
from ahnn.compiled_libraries import PART, CompiledFlow
from ahnn.compiled_libraries import POINTER as P
from ahnn.compiled_libraries import REAL as R
from ahnn.dynamics.flow_at_time import at
from ahnn.estimation.estimator import SensorModel
from ahnn.estimation.kernel import propagate
from ahnn.estimation.state import FilterState
from ahnn.estimation.step_runs import FollowedRows, StepRun
from ahnn.measurements import periods
from ahnn.rollouts import clock_of
from ahnn.types import Flow
from ahnn_plugins.ukf import members
from ahnn_plugins.ukf.parameters import SigmaWeights
from ahnn_plugins.ukf.sigma_points import draw
from ahnn_plugins.ukf.unscented_kernel import READINGS, SigmaPoints

CALLED = ctypes.CFUNCTYPE(N, P, N, P, R, P)
"""Type of a flow that the library calls."""


class CalledFlow:
    """Flow in torch, called by the library step by step on points in fixed memory.

    Args:
        flow: the process model.
        starts: (S,) times at which the steps begin.
        weights: sigma point weights.
        points: (B, S, D) sigma points before a step.
        moved: (B, S, D) sigma points after the step.

    Attributes:
        left: (B, S, D) points that the library cannot use, such as those with a gradient.
        interrupt: exception, such as KeyboardInterrupt, that ended a call; errors of the flow are not stored,
            since a single step raises them again.
    """

    def __init__(
        self, flow: Flow, starts: Tensor, weights: SigmaWeights, points: Tensor, moved: Tensor
    ) -> None:
        self.flow, self.weights, self.points, self.moved = flow, weights, points, moved
        self.starts = iter(starts) if clock_of(flow) else None
        self.left: Tensor | None = None
        self.interrupt: BaseException | None = None

    def __call__(self, about: int, count: int, x: int, dt: float, out: int) -> int:
        """Write the points after a step dt; return 0, or 1 if there are none.

        x and out are the memory of `points` and `moved`.
        """
        try:
            flow = at(self.flow, next(self.starts)) if self.starts else self.flow
            found = propagate(flow, self.points.clone(), dt)
            if not members.apply_to(self.weights, found):
                self.left = found
                return 1
            self.moved.copy_(found)
        except Exception:
            return 1
        except BaseException as error:
            self.interrupt = error
            return 1
        return 0


class DoneSteps(NamedTuple):
    """Completed steps.

    Attributes:
        number: number n of steps.
        results: memory of `members.results`, of which the first n steps are valid.
        points: (B, S, D) points after the flow of the first step that was not completed; None if unknown.
    """

    number: int
    results: tuple[Tensor, ...]
    points: Tensor | None


def supported(state: FilterState, kernel: SigmaPoints, sensor: SensorModel, *tensors: Tensor) -> bool:
    """Return whether the library supports a sensor and plain tensors, and all members are active."""
    weights, (mean, chol) = kernel.weights, state.belief
    size = len(sensor.measurement.names)
    if type(sensor.measurement) not in READINGS or size > mean.shape[-1] or bool(state.status.any()):
        return False
    known = kernel.form.read is not None and weights.crowding is None
    return known and members.apply_to(weights, mean, chol, sensor.chol_r, *tensors)


@cache
def _half(periods: tuple[float, ...]) -> Tensor:
    return 0.5 * torch.tensor(periods, dtype=torch.float64)


def done_steps(
    state: FilterState,
    weights: SigmaWeights,
    flow: Flow,
    run: StepRun,
    sensor: SensorModel,
    most: float = math.inf,
) -> DoneSteps:
    """Execute steps that are supported, until one needs a decision, as a NIS above `most` does."""
    most = most if sensor.thresholds is None else min(most, float(sensor.thresholds[-1]))
    half = _half(periods(sensor.measurement))
    points = draw(state.belief, weights)
    moved, results = torch.empty_like(points), members.results(len(run.measured), half.numel(), points)
    known = getattr(flow, "as_compiled", None)
    compiled: CompiledFlow | None = None
    if known is not None and points.shape[0] * points.shape[1] <= PART:  # larger batches use several cores
        compiled = known()
    called = None
    if compiled is None:
        called = CalledFlow(flow, run.starts, weights, points, moved)
        function = CALLED(called)
        compiled = CompiledFlow(ctypes.cast(function, P).value or 0, 0, (function,))
    noise = run.chol_q, sensor.chol_r, most, half
    fixed = run.lengths, run.measured, run.rows
    code, count = members.follow(compiled, *fixed, weights, *noise, (points, moved), results)
    if called is not None and called.interrupt is not None:
        raise called.interrupt
    left = moved if code == members.UNSOUND else None if called is None else called.left
    return DoneSteps(count, results, left)


def follow(
    state: FilterState, kernel: SigmaPoints, flow: Flow, run: StepRun, sensor: SensorModel, most: float
) -> FollowedRows | None:
    """Filter the first rows of a sequence of one member; see `ahnn.estimation.step_runs.RunFilter`."""
    if not supported(state, kernel, sensor, run.chol_q, run.rows):
        return None
    done = done_steps(state, kernel.weights, flow, run, sensor, most)
    ends = torch.tensor(run.measured[: done.number], dtype=torch.bool).nonzero()[:, 0]
    parts = (part[ends, 0] for part in done.results)
    _, _, residuals, means, chols, deviations, nis, log_likelihoods, _ = parts
    return FollowedRows(means, chols, residuals, deviations, nis, log_likelihoods)
