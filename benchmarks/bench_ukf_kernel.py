"""Time of the filter against its flow only, and against filterpy on the same flow; medians in one run.

125 members, 13 sigma points, an update every 60th step, as in the paper, on one thread. Two flows, each
through one Runge-Kutta step of order four: a 3x128 network (float32, the gradient of a Hamiltonian in closed
form), and two bodies with J2, which filterpy receives in NumPy, point by point, as it requires.

    python benchmarks/bench_ukf_kernel.py [--steps 240] [--repeats 5]
"""

from __future__ import annotations

import argparse
import itertools
import math
import time
from collections.abc import Callable
from statistics import median
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ahnn.estimation import initial_belief
from ahnn.measurements import Position, every
from ahnn_plugins.ukf import SQUARE_ROOT, STANDARD, Form, unscented_filter

BATCH, SIZE, POINTS, CADENCE = 125, 6, 13, 60
AXES = torch.tensor((1.0, 1.0, 3.0), dtype=torch.float64)
AXES_NUMPY = AXES.numpy()
MU, J2, RADIUS = 398600.4418, 1.08262668e-3, 6378.137


def rk4(field: Callable, x: Any, dt: float) -> Any:
    """Return x after one classical Runge-Kutta step; for tensors and arrays alike."""
    k1 = field(x)
    k2 = field(x + 0.5 * dt * k1)
    k3 = field(x + 0.5 * dt * k2)
    k4 = field(x + dt * k3)
    return x + dt / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)


class NetworkFlow:
    """RK4 step of the canonical field of a 6-128-128-128-1 tanh network in float32."""

    def __init__(self) -> None:
        generator = torch.Generator().manual_seed(0)
        sizes = (SIZE, 128, 128, 128, 1)
        self.weights = [torch.randn(n, m, generator=generator) / m**0.5 for m, n in itertools.pairwise(sizes)]

    def field(self, x: Tensor) -> Tensor:
        """Return J grad H, (N, 6)."""
        layers = []
        h = x
        for weight in self.weights[:-1]:
            h = torch.tanh(h @ weight.mT)
            layers.append(h)
        gradient = self.weights[-1].expand(len(x), -1)
        for weight, h in zip(reversed(self.weights[:-1]), reversed(layers), strict=True):
            gradient = (gradient * (1.0 - h * h)) @ weight
        return torch.cat((gradient[:, 3:], -gradient[:, :3]), dim=1)

    def __call__(self, x: Tensor, dt: float) -> Tensor:
        """Return the states after dt, (N, 6) float64; the increment is formed in float32."""
        x32 = x.to(torch.float32)
        return x + (rk4(self.field, x32, dt) - x32)


def j2_flow(x: Tensor, dt: float) -> Tensor:
    """Return the orbits (N, 6), km and km/s, after dt."""

    def field(x: Tensor) -> Tensor:
        q = x[:, :3]
        r2 = (q * q).sum(-1, keepdim=True)
        z2 = 5.0 * q[:, 2:].square() / r2
        factor = 1.5 * J2 * RADIUS**2 / r2
        return torch.cat((x[:, 3:], q * (1.0 + factor * (AXES - z2)) * (-MU / (r2 * r2.sqrt()))), dim=-1)

    return rk4(field, x, dt)


def j2_flow_numpy(x: np.ndarray, dt: float) -> np.ndarray:
    """Return one orbit (6,), km and km/s, after dt."""

    def field(x: np.ndarray) -> np.ndarray:
        q = x[:3]
        r2 = q @ q
        z2 = 5.0 * q[2] * q[2] / r2
        factor = 1.5 * J2 * RADIUS**2 / r2
        return np.concatenate((x[3:], q * (1.0 + factor * (AXES_NUMPY - z2)) * (-MU / (r2 * math.sqrt(r2)))))

    return rk4(field, x, dt)


def seconds(work: Callable[[], object]) -> float:
    """Return the wall-clock seconds of one call."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def flow_alone(flow: Callable, start: Tensor, dt: float, steps: int) -> Callable[[], None]:
    """Return work: the same number of flow calls on the same number of points."""
    points = start.repeat(POINTS, 1)

    def work() -> None:
        x = points
        with torch.no_grad():
            for _ in range(steps):
                x = flow(x, dt)

    return work


def batched_filter(flow: Callable, start: Tensor, dt: float, steps: int, form: Form) -> Callable[[], None]:
    """Return work: our filter."""
    belief = initial_belief(start, 1e-4 * torch.eye(SIZE))
    measurements = every(start[:, None, :3].expand(-1, steps, -1), CADENCE)
    noise = 1e-8 * torch.eye(SIZE), 0.01 * torch.eye(3)

    def work() -> None:
        result = unscented_filter(flow, belief, measurements, Position(3), *noise, dt, form=form)
        assert int(result.status.abs().sum()) == 0

    return work


def filterpy_filter(flow: Callable, start: np.ndarray, dt: float, steps: int) -> Callable[[], None]:
    """Return work: filterpy on one member."""
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    points = MerweScaledSigmaPoints(SIZE, alpha=1.0, beta=2.0, kappa=0.0)

    def work() -> None:
        ukf = UnscentedKalmanFilter(SIZE, 3, dt, hx=lambda x: x[:3], fx=flow, points=points)
        ukf.x, ukf.P, ukf.Q, ukf.R = start, 1e-4 * np.eye(SIZE), 1e-8 * np.eye(SIZE), 0.01 * np.eye(3)
        for k in range(steps):
            ukf.predict()
            if (k + 1) % CADENCE == 0:
                ukf.update(start[:3])

    return work


def measure(works: dict[str, tuple[Callable[[], None], int]], repeats: int) -> dict[str, list[float]]:
    """Return seconds per filter-step; interleaved, so that a slow spell of the machine meets all."""
    for work, _ in works.values():
        work()
    times: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(repeats):
        for name, (work, count) in works.items():
            times[name].append(seconds(work) / count)
    return times


def report(title: str, times: dict[str, list[float]]) -> None:
    """Print the medians, and the medians of the ratios of each repeat."""
    print(title)
    for name, values in times.items():
        ratio = median(v / f for v, f in zip(values, times["flow only"], strict=True))
        print(f"  {name:12s} {median(values) * 1e6:9.2f} us per filter-step  {ratio:8.3f} x flow")
    if "filterpy" in times:
        pairs = zip(times["filterpy"], times["square-root"], strict=True)
        print(f"  square-root is {median(a / b for a, b in pairs):.0f} times faster than filterpy")


def main() -> None:
    """Print the ratios."""
    parser = argparse.ArgumentParser(description="Time of the filter against its flow and filterpy.")
    parser.add_argument("--steps", type=int, default=240)
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    steps, count = arguments.steps, arguments.steps * BATCH
    scaled = torch.randn(BATCH, SIZE, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    network = NetworkFlow(), scaled, 0.01, steps
    orbit = torch.tensor((26600.0, 0.0, 0.0, 0.0, 2.7, 2.7), dtype=torch.float64).repeat(BATCH, 1)
    two_body = j2_flow, orbit, 60.0, steps
    times = {
        "flow only": (flow_alone(*network), count),
        "square-root": (batched_filter(*network, SQUARE_ROOT), count),
        "standard": (batched_filter(*network, STANDARD), count),
    }
    report("3x128 Hamiltonian network, float32", measure(times, arguments.repeats))
    times = {
        "flow only": (flow_alone(*two_body), count),
        "square-root": (batched_filter(*two_body, SQUARE_ROOT), count),
        "standard": (batched_filter(*two_body, STANDARD), count),
        "filterpy": (filterpy_filter(j2_flow_numpy, orbit[0].numpy(), 60.0, CADENCE), CADENCE),
    }
    report("two bodies with J2, float64", measure(times, arguments.repeats))


if __name__ == "__main__":
    main()
