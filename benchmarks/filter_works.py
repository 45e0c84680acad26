"""The filter by ahnn and its peers on the same work: two bodies with J2, a position after every step.

    python benchmarks/filter_works.py [repeats]

Float64, alpha = 1, one step per minute. `ahnn` uses the flow of system=molniya, a composition of order eight
in C; `torch` is its filter with one Runge-Kutta step in torch, as in the peers, and `compiled` is `torch`
through torch.compile, whose compilation is not counted. The floor is only the compiled flow on all sigma
points.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from statistics import median

import torch
from bench_ukf_kernel import j2_flow, j2_flow_numpy
from timing import Row, Work, has, in_turn, left_out, ratio, settle
from torch import Tensor

from ahnn.estimation import initial_belief
from ahnn.measurements import Position
from ahnn.systems import Molniya, exact_flow
from ahnn_plugins.ukf import unscented_filter

SIZE, DT, START, Q, R = 6, 60.0, 1e-4, 1e-8, 1e-2
NEEDS = {"dynamax": ("jax", "dynamax"), "cuthbert": ("jax", "cuthbertlib"), "filterpy": ("filterpy",)}
OWN = ("ahnn", "torch", "compiled")
AMOUNTS = ((1, 60), (125, 60), (10_000, 4))
"""Members and steps of each row."""


def problem(members: int, steps: int) -> tuple[Tensor, Tensor]:
    """Return starts (B, 6) and measured positions (B, T, 3) of orbits near one another, km and km/s."""
    generator = torch.Generator().manual_seed(0)
    start = torch.tensor((26600.0, 0.0, 0.0, 0.0, 2.7, 2.7), dtype=torch.float64).repeat(members, 1)
    start = start + START**0.5 * torch.randn(start.shape, generator=generator, dtype=torch.float64)
    x, rows = start, []
    for _ in range(steps):
        x = j2_flow(x, DT)
        rows.append(x[:, :3] + R**0.5 * torch.randn(members, 3, generator=generator, dtype=torch.float64))
    return start, torch.stack(rows, dim=1)


def own_filter(flow: Callable, start: Tensor, rows: Tensor) -> Work:
    """Return work: the filter of ahnn."""
    belief = initial_belief(start, START * torch.eye(SIZE))
    noise = Q * torch.eye(SIZE), R * torch.eye(3)

    def work() -> None:
        result = unscented_filter(flow, belief, rows, Position(3), *noise, DT)
        assert not bool(result.status.any())

    return work


def flow_alone(flow: Callable, start: Tensor, steps: int) -> Work:
    """Return work: the flow on all sigma points."""
    points = start.repeat_interleave(2 * SIZE + 1, dim=0)

    def work() -> None:
        x = points
        with torch.no_grad():
            for _ in range(steps):
                x = flow(x, DT)

    return work


def filterpy_filter(start: Tensor, rows: Tensor) -> Work:
    """Return work: filterpy on one member, as it has no batches."""
    import numpy as np
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    points = MerweScaledSigmaPoints(SIZE, alpha=1.0, beta=2.0, kappa=0.0)

    def work() -> None:
        ukf = UnscentedKalmanFilter(SIZE, 3, DT, hx=lambda x: x[:3], fx=j2_flow_numpy, points=points)
        ukf.x, ukf.P, ukf.Q, ukf.R = start[0].numpy(), START * np.eye(SIZE), Q * np.eye(SIZE), R * np.eye(3)
        for y in rows[0].numpy():
            ukf.predict()
            ukf.update(y)

    return work


def filters(repeats: int) -> Iterator[Row]:
    """Yield a row for each number of members, times of one step of one member."""
    compiled = torch.compile(j2_flow, dynamic=True)
    flows = exact_flow(Molniya(name="molniya", dt=DT, steps=60)), j2_flow, compiled
    for members, steps in AMOUNTS:
        start, rows = problem(members, steps)
        works = {name: own_filter(flow, start, rows) for name, flow in zip(OWN, flows, strict=True)}
        counts = dict.fromkeys(works, members * steps)
        for peer in ("dynamax", "cuthbert"):
            if has(NEEDS[peer]):
                import jax_filter

                make = getattr(jax_filter, f"{peer}_filter")
                works[peer] = make(start.numpy(), rows.numpy(), (START, Q, R), DT)
                counts[peer] = members * steps
        if has(NEEDS["filterpy"]):
            works["filterpy"], counts["filterpy"] = filterpy_filter(start, rows), steps
        name = f"{members:,} member{'s' * (members > 1)}"
        row = in_turn(name, works, repeats, flow_alone(compiled, start, steps))
        times = {who: [t / counts[who] for t in found] for who, found in row.times.items()}
        yield Row(row.name, times, row.floor and [t / (members * steps) for t in row.floor])


def table(rows: list[Row]) -> str:
    """Return rows as a Markdown table."""
    peers = [peer for peer in NEEDS if peer in rows[0].times]
    who = (*OWN, *peers)
    ratios = [f"{own} / {peer}" for peer in peers for own in OWN]
    heads = ["one step of one member [us]", *who, "floor", *ratios]
    lines = ["| " + " | ".join(heads) + " |", "|---" + "|--:" * (len(heads) - 1) + "|"]
    for row in rows:
        cells = [row.name, *(f"{1e6 * median(row.times[name]):.3g}" for name in who)]
        cells.append(f"{1e6 * median(row.floor or []):.3g}")
        cells += [f"{ratio(row.times[own], row.times[peer]):.3g}" for peer in peers for own in OWN]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Print the table."""
    settle()
    left_out(NEEDS)
    print(table(list(filters(int(sys.argv[1]) if len(sys.argv) > 1 else 9))))


if __name__ == "__main__":
    main()
