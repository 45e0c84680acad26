"""Linear problems, whose exact answer the Kalman filter knows, and cases of small systems."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
import torch
from evaluating import case_of
from precise import LinearMeasurement
from torch import Tensor

from ahnn.evaluation import Case
from ahnn.evaluation.case import perturbations
from ahnn.systems import System
from ahnn.types import Flow


class Linear(NamedTuple):
    """x' = A x + noise of covariance Q, y = H x + noise of covariance R, start N(mean, P0)."""

    a: Tensor
    h: Tensor
    q: Tensor
    r: Tensor
    mean: Tensor
    p0: Tensor
    states: Tensor
    measurements: Tensor

    def flow(self, x: Tensor, dt: float) -> Tensor:
        return x @ self.a.mT


def random_covariance(rng: np.random.Generator, size: int, scale: float) -> np.ndarray:
    root = rng.normal(size=(size, size))
    return scale * (root @ root.T / size + 0.3 * np.eye(size))


@pytest.fixture
def make_linear() -> Callable[..., tuple[Linear, LinearMeasurement]]:
    """Return a factory of random stable linear problems, simulated from their own law."""

    def make(size: int, width: int, steps: int, batch: int = 1, seed: int = 0) -> tuple:
        rng = np.random.default_rng(seed)
        a = rng.normal(size=(size, size))
        a *= 0.95 / np.abs(np.linalg.eigvals(a)).max()
        h = rng.normal(size=(width, size))
        q, r = random_covariance(rng, size, 0.5), random_covariance(rng, width, 1.0)
        p0 = random_covariance(rng, size, 2.0)
        mean = rng.normal(size=(batch, size))
        x = mean + rng.normal(size=(batch, size)) @ np.linalg.cholesky(p0).T
        states, measurements = [], []
        for _ in range(steps):
            x = x @ a.T + rng.normal(size=(batch, size)) @ np.linalg.cholesky(q).T
            states.append(x)
            measurements.append(x @ h.T + rng.normal(size=(batch, width)) @ np.linalg.cholesky(r).T)
        arrays = (a, h, q, r, mean, p0, np.stack(states, 1), np.stack(measurements, 1))
        problem = Linear(*(torch.from_numpy(value) for value in arrays))
        return problem, LinearMeasurement(problem.h)

    return make


@pytest.fixture
def close() -> Callable[[Tensor, Tensor, float], bool]:
    """Return a comparison relative to the size of each trailing vector or matrix of the expected value."""

    def compare(actual: Tensor, expected: Tensor, tolerance: float, trailing: int = 1) -> bool:
        assert actual.shape == expected.shape
        dims = tuple(range(-trailing, 0))
        size = expected.abs().amax(dims)
        return bool(((actual - expected).abs().amax(dims) <= tolerance * size).all())

    return compare


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw none, where none are looked at."""
    monkeypatch.setattr("ahnn.evaluation.estimators.plugin.filter_figures", lambda *_: ({}, {}))


@pytest.fixture(scope="module")
def make_case(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Case]:
    """Return a factory of cases on six trajectories of a system."""
    folder = tmp_path_factory.mktemp("cases")

    def make(system: System, flow: Flow) -> Case:
        return case_of(system, flow, perturbations(system, 6, seed=0), folder, validation=4)

    return make
