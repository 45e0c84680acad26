"""Scenarios for estimators: true flows, trajectories, measurements, and the best possible estimates.

The floor is the best possible estimate from the same measurements. If a motion is nearly linear over its
uncertainty, it is the filter linearised along the truth: its covariance is the posterior Cramér-Rao bound of
such a motion (Tichavský, Muravchik & Nehorai 1998), without outliers. Elsewhere it is a bootstrap particle
filter (Gordon, Salmond & Smith 1993) of many particles, which tends to the exact posterior mean.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ahnn.dynamics.transition import transition
from ahnn.estimation import initial_belief
from ahnn.estimation.estimator import Estimator
from ahnn.estimation.results import FilterResult
from ahnn.integrators import INTEGRATORS
from ahnn.jacobians import pointwise_jacobian
from ahnn.measurements import GroundStation, Position, observe, residual
from ahnn.measurements.base import Measurement
from ahnn.measurements.several import Several
from ahnn.systems import ChainPendulum, Molniya, exact_flow
from ahnn.types import Flow, TimeStep

F64 = torch.float64
STATIONS = ((67.86, 20.96), (65.12, 212.57), (-7.95, 345.60), (-46.53, 168.38), (-63.32, 302.10))
"""Latitudes and longitudes of the stations of `measurement=tracking`."""
EVERY = 600.0
"""Seconds between two measurements of a satellite."""
OUTLIER = 20.0
"""Standard deviation of an outlier, relative to the noise."""


class Scenario(NamedTuple):
    """What happens, and how it is measured.

    Attributes:
        name: in the table.
        unit: of its error.
        flow: the true one, which all estimators have.
        dt: length of a step.
        steps: how many.
        starts: (count, generator) -> (count, D) true states.
        start_sd: (D,) of the initial error.
        step_sd: (D,) of the process noise of a step.
        measurement: the model.
        sd: (M,) of its noise.
        updates: steps after which it is measured.
        scored: components whose errors are compared.
        outliers: fraction of rows whose noise is `OUTLIER` times as large; they call for a gate.
        linear: whether the floor is the filter along the truth.
        members: how many are drawn at once.
    """

    name: str
    unit: str
    flow: Flow
    dt: float
    steps: int
    starts: Callable[[int, torch.Generator], Tensor]
    start_sd: Tensor
    step_sd: Tensor
    measurement: Measurement
    sd: Tensor
    updates: tuple[int, ...]
    scored: slice
    outliers: float = 0.0
    linear: bool = True
    members: int = 10


class Drawn(NamedTuple):
    """One draw of a scenario for B members.

    Attributes:
        truth: (B, T + 1, D).
        believed: (B, D) means of the starts.
        rows: (B, T, M), NaN where nothing is measured.
        outlying: (B, T) bool.
    """

    truth: Tensor
    believed: Tensor
    rows: Tensor
    outlying: Tensor


def drawn(scenario: Scenario, seed: int) -> Drawn:
    """Return trajectories with process noise, wrong starts and noisy rows."""
    generator, members = torch.Generator().manual_seed(seed), scenario.members

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator, dtype=F64)

    states = [scenario.starts(members, generator)]
    size, width = states[0].shape[-1], len(scenario.sd)
    for _ in range(scenario.steps):
        states.append(scenario.flow(states[-1], scenario.dt) + scenario.step_sd * normal(members, size))
    truth = torch.stack(states, 1)
    rows = torch.full((members, scenario.steps, width), torch.nan, dtype=F64)
    outlying = torch.zeros(members, scenario.steps, dtype=torch.bool)
    for k in scenario.updates:
        noise = scenario.sd * normal(members, width)
        bad = torch.rand(members, generator=generator, dtype=F64) < scenario.outliers
        noise = torch.where(bad.unsqueeze(-1), OUTLIER * noise, noise)
        rows[:, k - 1] = observe(scenario.measurement, truth[:, k], k * scenario.dt) + noise
        outlying[:, k - 1] = bad
    return Drawn(truth, truth[:, 0] + scenario.start_sd * normal(members, size), rows, outlying)


def run(scenario: Scenario, estimator: Estimator[Any], case: Drawn) -> FilterResult:
    """Return the result of an estimator on a draw."""
    belief = initial_belief(case.believed, torch.diag(scenario.start_sd**2))
    noise = torch.diag(scenario.step_sd**2), torch.diag(scenario.sd**2)
    return estimator.run(scenario.flow, belief, case.rows, scenario.measurement, *noise, scenario.dt)


class Affine(NamedTuple):
    """A function of the states (B, D) or (B, S, D) of B members, each by its own line through a point.

    Attributes:
        at: (B, D).
        value: (B, N) there.
        slope: (B, N, D).
    """

    at: Tensor
    value: Tensor
    slope: Tensor

    def __call__(self, x: Tensor, _: TimeStep) -> Tensor:
        """Return the values; measurements of several points a member have an axis more."""
        if x.ndim == self.at.ndim:
            return self.value + (self.slope @ (x - self.at).unsqueeze(-1)).squeeze(-1)
        return self.value.unsqueeze(1) + (x - self.at.unsqueeze(1)) @ self.slope.mT


class Linear:
    """A measurement model linearised at the true states, with the differences of the model."""

    def __init__(self, model: Measurement, x: Tensor, t: float) -> None:
        self.model, self.names, self.units = model, model.names, model.units
        self.line = Affine(x, model(x, t), pointwise_jacobian(lambda z: model(z, t), x))

    def __call__(self, x: Tensor, t: Any) -> Tensor:
        """Return the measurements (B, M) or (B, S, M)."""
        return self.line(x, t)

    def residual(self, y: Tensor, y_pred: Tensor) -> Tensor:
        """Return y - y_pred as the model has it."""
        return residual(self.model, y, y_pred)


def along_truth(scenario: Scenario, estimator: Estimator[Any], case: Drawn) -> Tensor:
    """Return the means (B, T, D) of the filter that is linearised along the truth and knows the outliers.

    Args:
        scenario: scenario.
        estimator: any estimator that is exact on linear systems.
        case: the draw.
    """
    q, r = torch.diag(scenario.step_sd**2), torch.diag(scenario.sd**2)
    state = estimator.start(initial_belief(case.believed, torch.diag(scenario.start_sd**2)))
    rows = case.rows.masked_fill(case.outlying.unsqueeze(-1), torch.nan)
    means = []
    for k in range(scenario.steps):
        x, time = case.truth[:, k], (k + 1) * scenario.dt
        line = Affine(x, *transition(scenario.flow, x, scenario.dt))
        # The sigma points of a member follow one another.
        state = estimator.predict(state, _each(line), scenario.dt, q)
        if not bool(rows[:, k].isnan().all()):
            seen = Linear(scenario.measurement, case.truth[:, k + 1], time)
            state, _ = estimator.update(state, rows[:, k], seen, r)
        means.append(state.moments.mean)
    return torch.stack(means, 1)


def _each(line: Affine) -> Flow:
    """Return a line of members as a flow of all their points, (B S, D)."""
    members = len(line.at)
    return lambda x, dt: line(x.unflatten(0, (members, -1)), dt).flatten(0, 1)


def stations(least: float = 10.0) -> tuple[Measurement, Tensor]:
    """Return the network of `measurement=tracking` and its standard deviations, 50 m and 0.02 degrees."""
    seen = Several([GroundStation(*place, min_elevation=least) for place in STATIONS])
    return seen, torch.tensor([0.05, 3.5e-4, 3.5e-4] * len(STATIONS), dtype=F64)


def spring() -> Scenario:
    """A spring of 1 N/m and 1 kg, its position every half second: linear, so all Kalman filters are one."""
    c, s = math.cos(0.5), math.sin(0.5)
    turn = torch.tensor([[c, s], [-s, c]], dtype=F64)
    nothing, start = torch.zeros(2, dtype=F64), torch.tensor([0.05, 0.05], dtype=F64)

    def starts(count: int, generator: torch.Generator) -> Tensor:
        return torch.randn(count, 2, generator=generator, dtype=F64)

    moved = (lambda x, _: x @ turn.mT, 0.5, 40, starts, start, nothing)
    seen = Position(1, "m"), torch.tensor([0.01], dtype=F64), tuple(range(1, 41))
    return Scenario("spring, positions", "m", *moved, *seen, slice(0, 1))


def orbit(name: str, system: Molniya, updates: tuple[int, ...], outliers: float = 0.0) -> Scenario:
    """A satellite of an oblate planet, seen by stations, from a start that is 3.2 km and 32 m/s uncertain."""
    seen, sd = stations()
    start = torch.tensor([10**0.5] * 3 + [1e-3**0.5] * 3, dtype=F64)
    nothing = torch.zeros(6, dtype=F64)
    moved = (exact_flow(system), EVERY, system.steps, system.initial_states, start, nothing)
    return Scenario(name, "km", *moved, seen, sd, updates, slice(0, 3), outliers, members=4)


def tracking() -> Scenario:
    """Half a day of a Molniya satellite, every ten minutes."""
    return orbit("Molniya, stations", Molniya(name="molniya", dt=60.0, steps=72), tuple(range(1, 73)))


def transfer() -> Scenario:
    """A transfer orbit to the geostationary one for 21 h: a twentieth outliers, and no row for six hours."""
    shape = {"altitude": (250.0, 250.0), "eccentricity": (0.73, 0.73), "inclination": (7.0, 7.0)}
    system = Molniya(name="transfer", dt=60.0, steps=126, raan=(0.0, 360.0), **shape)
    updates = tuple(k for k in range(1, 127) if not 40 <= k < 76)
    start = torch.tensor([3.0] * 3 + [1e-2] * 3, dtype=F64)
    return orbit("GTO, outliers and gaps", system, updates, 0.05)._replace(start_sd=start)


class Stepped(NamedTuple):
    """Steps of a field by Runge-Kutta's rule of order four, each cut into parts."""

    field: Callable[[Tensor], Tensor]
    parts: int

    def __call__(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the states after dt."""
        step = INTEGRATORS["rk4"].step
        for _ in range(self.parts):
            x = step(self.field, x, dt / self.parts)
        return x


class First:
    """The first component of a state."""

    def __init__(self, name: str, unit: str) -> None:
        self.names, self.units = (name,), (unit,)

    def __call__(self, x: Tensor, _: Any) -> Tensor:
        """Return the measurements (..., 1) of the states (..., D)."""
        return x[..., :1]


def double_pendulum_field(x: Tensor) -> Tensor:
    """Return Hamilton's field of `system=double_pendulum`, two links of 1 m and 1 kg, in closed form."""
    a, b, p, r = x.unbind(-1)
    c, s = (a - b).cos(), (a - b).sin()
    det = 2.0 - c * c
    v, w = (p - c * r) / det, (2.0 * r - c * p) / det
    turning = s * v * w
    return torch.stack((v, w, -turning - 19.62 * a.sin(), turning - 9.81 * b.sin()), -1)


def pendulum() -> Scenario:
    """A double pendulum for 7.2 s that hardly turns over, the angle of its upper link every 1.2 s."""
    system = ChainPendulum(name="pendulum", dt=0.06, steps=120, q0=(0.8, 1.2))
    start = torch.tensor([0.2, 0.2, 0.5, 0.5], dtype=F64)
    noise, sd = torch.tensor([2e-3, 2e-3, 3e-2, 3e-2], dtype=F64), torch.tensor([0.05], dtype=F64)
    moved = (Stepped(double_pendulum_field, 3), 0.06, 120, system.initial_states, start, noise)
    seen = First("q1", "rad"), sd, tuple(range(20, 121, 20))
    return Scenario("double pendulum", "rad", *moved, *seen, slice(0, 2), linear=False)


def lorenz_field(x: Tensor) -> Tensor:
    """Return the field of Lorenz (1963), sigma 10, rho 28, beta 8/3."""
    a, b, c = x.unbind(-1)
    return torch.stack((10.0 * (b - a), a * (28.0 - c) - b, a * b - 8.0 / 3.0 * c), -1)


def lorenz() -> Scenario:
    """Lorenz-63, x once per unit of time, in which errors grow by a factor of 2.5."""
    flow = Stepped(lorenz_field, 8)

    def starts(count: int, generator: torch.Generator) -> Tensor:
        x = torch.randn(count, 3, generator=generator, dtype=F64) + torch.tensor([0.0, 0.0, 25.0])
        for _ in range(50):
            x = flow(x, 0.2)
        return x

    ones, sd = torch.ones(3, dtype=F64), torch.ones(1, dtype=F64)
    moved = (flow, 0.2, 75, starts, ones, 0.2 * ones)
    seen = First("x", "1"), sd, tuple(range(5, 76, 5))
    return Scenario("Lorenz-63", "1", *moved, *seen, slice(0, 3), linear=False)


SCENARIOS = (spring, tracking, transfer, pendulum, lorenz)
