"""Runtime estimate of the evaluation after training, from a few steps of its flows."""

from __future__ import annotations

import time
from statistics import median
from typing import Any

import torch

from ahnn.clock import Clock, extended
from ahnn.jobs.prepared import Prepared
from ahnn.rollouts import clock_of
from ahnn.systems import exact_flow
from ahnn.training.closing_estimate import ShootingCost, work
from ahnn.training.timers import sum_seconds
from ahnn.types import Flow

TIMED = 5
"""Number of timed steps."""
FILTERED = 6.0
"""Measured cost of a filter evaluation (4.7 on Molniya orbits, 8.8 on a spring), in units of a prediction."""
TESTS = 50.0
"""Measured cost of tests on unseen measurements, in iterations of their initial states."""
FIGURES = 850.0
"""Measured cost of figures and their imports, in units of a sum in Python."""


def evaluation_seconds(prepared: Prepared, shooting: ShootingCost | None = None) -> float:
    """Estimate the time of predictions, filters, tests and figures in seconds.

    A plugin's method `rollouts` returns its cost for a given number of samples, in rollouts over them.
    `shooting` is the measured cost of shooting, for a training on measurements.
    """
    data, dynamics = prepared.data, prepared.model.dynamics.frozen().cpu()
    test, plugins = data.splits["test"], prepared.plugins.values()
    seconds = FIGURES * sum_seconds() if prepared.report.get("figures", True) else 0.0
    count, samples = test.states.shape[:2]
    flows: list[tuple[Flow, int]] = [(dynamics, 2 * count)]
    truth = None if data.source.truth is None else exact_flow(data.source.truth)
    if truth is not None:
        flows.append((truth, count))
    states, dt = data.examples(), float(data.statistics().dt)
    each = sum(_step_seconds(flow, states, rows, dt) for flow, rows in flows)
    filters = sum(hasattr(plugin, "estimator") for plugin in plugins)
    costs = (getattr(plugin, "rollouts", None) for plugin in plugins)
    more = sum(cost(samples) for cost in costs if cost is not None)
    seconds += samples * each * (1 + FILTERED * filters + more)
    if shooting is not None:
        seconds += TESTS * shooting.iteration * work(data.measured("test").times)
    return seconds


@torch.no_grad()
def _step_seconds(flow: Any, states: torch.Tensor, rows: int, dt: float) -> float:
    """Return the median time of a step of `rows` states, after a warm-up call."""
    x, times = states[torch.arange(rows) % len(states)], list[float]()
    clock = x.new_zeros(clock_of(flow))
    x = extended(x, Clock(clock, clock))
    for _ in range(TIMED + 1):
        begin = time.perf_counter()
        flow(x, dt)
        times.append(time.perf_counter() - begin)
    return median(times[1:])
