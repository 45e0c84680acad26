"""Problems and oracles for filters of samples: linear, a spring, and sums over a grid."""

from __future__ import annotations

import math

import numpy as np
import torch

from ahnn.estimation import Setting, initial_belief, nees, perturbed_arcs
from ahnn.estimation.trial import Filter, assimilate
from ahnn.evaluation.open_loop import Integrated
from ahnn.integrators import INTEGRATORS
from ahnn.measurements import Position
from ahnn.systems import MassSpring

F64, NAN = torch.float64, float("nan")
A = torch.tensor([[1.0, 0.1, 0.0], [-0.2, 0.97, 0.05], [0.0, 0.1, 0.9]], dtype=F64)
H = torch.tensor([[1.0, 0.0, 0.5], [0.0, 1.0, 0.0]], dtype=F64)
P0 = torch.diag(torch.tensor([1.0, 2.0, 0.5], dtype=F64))
R = torch.tensor([[0.1, 0.02], [0.02, 0.2]], dtype=F64)


class Linear:
    names, units = ("a", "b"), ("1", "1")

    def __call__(self, x, t):
        return x @ H.mT


def draw(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=F64)


def linear(x, dt):  # noqa: ARG001
    return x @ A.mT


def linear_problem(q, steps=25, batch=2):
    """Arguments of a run over rows of the system itself, some numbers missing."""
    x, rows = draw(batch, 3, seed=1), []
    truth = x + draw(batch, 3, seed=2) @ P0.sqrt()
    for k in range(steps):
        truth = truth @ A.mT + q**0.5 * draw(batch, 3, seed=10 + k)
        rows.append(truth @ H.mT + draw(batch, 2, seed=100 + k) @ torch.linalg.cholesky(R).mT)
    rows = torch.stack(rows, 1)
    rows[0, 4, 0], rows[1, min(7, steps - 2)] = NAN, NAN
    return linear, initial_belief(x, P0), rows, Linear(), q * torch.eye(3, dtype=F64), R, 0.125


def kalman(q, rows, mean):
    """The textbook Kalman filter of each member: means, covariances, log-likelihoods."""
    means, covariances, likelihoods = [], [], []
    for b in range(len(rows)):
        m, p, told = mean[b], P0, 0.0
        for row in rows[b]:
            m, p = A @ m, A @ p @ A.mT + q * torch.eye(3, dtype=F64)
            there = ~row.isnan()
            if bool(there.any()):
                h = H[there]
                s = h @ p @ h.mT + R[there][:, there]
                off, gain = row[there] - h @ m, p @ h.mT @ torch.linalg.inv(s)
                law = torch.distributions.MultivariateNormal(torch.zeros_like(off), s)
                told += float(law.log_prob(off))
                m, p = m + gain @ off, (torch.eye(3, dtype=F64) - gain @ h) @ p
            means.append(m)
            covariances.append(p)
        likelihoods.append(told)
    shape = (len(rows), rows.shape[1])
    return (
        torch.stack(means).unflatten(0, shape),
        torch.stack(covariances).unflatten(0, shape),
        torch.tensor(likelihoods, dtype=F64),
    )


def spring_nees(estimator, members):
    """NEES (B, T) of a filter of the exact flow of a spring, and its status."""
    spring = MassSpring(name="spring", dt=0.05, steps=60)
    flow = Integrated(spring, INTEGRATORS["kahan_li8"])
    states = [spring.initial_states(members, torch.Generator().manual_seed(3))]
    for _ in range(spring.steps):
        states.append(flow(states[-1], spring.dt))
    sd, start = torch.tensor([0.01], dtype=F64), torch.tensor([0.05, 0.05], dtype=F64)
    setting = Setting(Position(1), sd, start, tuple(range(5, 61, 5)))
    arcs = perturbed_arcs(setting, torch.stack(states, 1), spring.dt, members, None, seed=4)
    nothing = torch.zeros(2, 2, dtype=F64)
    result = assimilate(Filter("f", flow, nothing, setting.measurement_noise, estimator), setting, arcs)
    return nees(result.means - arcs.truth[:, 1:], result.chols), result.status


def same(one, other):
    """Whether two states have the same bits."""
    parts = zip((*one.belief, *one[1:]), (*other.belief, *other[1:]), strict=True)
    return all(torch.equal(a, b) for a, b in parts)


def steps_of(estimator, state, flow, rows, measurement, q, r, dt):
    """The states after each step, one call of `predict` and `update` each."""
    for row in rows.unbind(1):
        state = estimator.predict(state, flow, dt, q)
        state, _ = estimator.update(state, row, measurement, r)
        yield state


class Square:
    names, units = ("square",), ("1",)

    def __call__(self, x, t):
        return x.square() / 20


def growth(x, dt):  # noqa: ARG001
    return 0.5 * x + 25 * x / (1 + x.square())


def grid_filter(rows, q, r, points=2001):
    """Means, variances and log-likelihood of one member by sums over a grid, from N(0.1, 2)."""
    x = np.linspace(-40, 40, points)
    step = x[1] - x[0]
    density = np.exp(-((x - 0.1) ** 2) / 4) / math.sqrt(4 * math.pi)
    ahead = 0.5 * x + 25 * x / (1 + x**2)
    kernel = np.exp(-((x[:, None] - ahead[None]) ** 2) / (2 * q)) / math.sqrt(2 * math.pi * q)
    means, variances, told = [], [], 0.0
    for row in rows:
        density = kernel @ density * step
        density = density * np.exp(-((row - x**2 / 20) ** 2) / (2 * r)) / math.sqrt(2 * math.pi * r)
        total = density.sum() * step
        told, density = told + math.log(total), density / total
        means.append((x * density).sum() * step)
        variances.append((x**2 * density).sum() * step - means[-1] ** 2)
    return np.array(means), np.array(variances), told
