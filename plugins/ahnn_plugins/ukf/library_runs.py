"""Runs of filter steps in one library call, which calls the flow: in C, or back in torch."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence

import torch
from torch import Tensor

from ahnn.compiled_libraries import NUMBER as N
from ahnn.compiled_libraries import POINTER as P
from ahnn.compiled_libraries import REAL as R
from ahnn.compiled_libraries import CompiledFlow
from ahnn.dynamics.flow_at_time import at
from ahnn.estimation.estimator import SensorModel
from ahnn.estimation.kernel import propagate
from ahnn.estimation.state import FilterState
from ahnn.estimation.step_runs import FollowedRows, StepRun
from ahnn.measurements import periods
from ahnn.rollouts import clock_of
from ahnn.types import Flow
from ahnn_plugins.ukf import members
from ahnn_plugins.ukf.sigma_points import draw
from ahnn_plugins.ukf.unscented_kernel import READINGS, SigmaPoints

CALLED = ctypes.CFUNCTYPE(N, P, N, P, R, P)
"""Type of a flow that the library calls."""


class CalledFlow:
    """Flow in torch, called by the library step by step on points in fixed memory.

    Args:
        flow: the process model.
        starts: times at which the steps begin.
        points: (1, S, D) sigma points before a step.
        moved: (1, S, D) sigma points after it.

    Attributes:
        interrupt: what ended a call other than an error of the flow, which single steps raise again.
    """

    def __init__(self, flow: Flow, starts: Sequence[float], points: Tensor, moved: Tensor) -> None:
        self.flow, self.points, self.moved = flow, points, moved
        self.timed, self.starts = bool(clock_of(flow)), iter(starts)
        self.interrupt: BaseException | None = None

    def __call__(self, about: int, count: int, x: int, dt: float, out: int) -> int:
        """Write the points after a step dt; return 0, or 1 if there are none."""
        del about, count, x, out  # those of the tensors
        try:
            start = next(self.starts)
            flow = at(self.flow, torch.tensor(start, dtype=torch.float64)) if self.timed else self.flow
            self.moved.copy_(propagate(flow, self.points.clone(), dt))
        except Exception:
            return 1
        except BaseException as error:
            self.interrupt = error
            return 1
        return 0


def follow(
    state: FilterState, kernel: SigmaPoints, flow: Flow, run: StepRun, sensor: SensorModel, most: float
) -> FollowedRows | None:
    """Filter the first rows of a run of one member; see `ahnn.estimation.step_runs.RunFilter`."""
    weights, (mean, chol) = kernel.weights, state.belief
    given = mean, chol, run.chol_q, sensor.chol_r, run.rows
    reads = type(sensor.measurement) in READINGS and run.rows.shape[-1] <= mean.shape[-1]
    if not reads or kernel.form.read is None or weights.crowding is not None or bool(state.status.any()):
        return None
    if not members.apply_to(weights, *given):
        return None
    limit = math.inf if sensor.thresholds is None else float(sensor.thresholds[-1])
    half = 0.5 * run.rows.new_tensor(periods(sensor.measurement))
    noise = members.StepNoise.of(run.chol_q, sensor.chol_r, min(limit, most), half)
    points = draw(state.belief, weights)
    moved, results = torch.empty_like(points), members.results(len(run.lengths), run.rows.shape[-1], mean)
    known = getattr(flow, "as_compiled", None)
    compiled: CompiledFlow | None = None if known is None else known()
    called = None
    if compiled is None:
        called = CalledFlow(flow, run.starts, points, moved)
        function = CALLED(called)
        compiled = CompiledFlow(ctypes.cast(function, P).value or 0, 0, (function,))
    done = members.follow(compiled, run, weights, noise, (points, moved), results)
    if called is not None and called.interrupt is not None:
        raise called.interrupt
    ends = torch.tensor(run.measured[:done], dtype=torch.bool).nonzero()[:, 0]
    _, _, residuals, means, chols, deviations, nis, log_likelihoods, _ = (part[ends, 0] for part in results)
    return FollowedRows(means, chols, residuals, deviations, nis, log_likelihoods)
