"""Defects of measurements and their diagnoses: a table of simulated cases.

    python benchmarks/bench_diagnosis.py [--cases 200] [--seed 0]

Exact dynamics, or dynamics with one wrong constant, are compared with positions of a spring, a pendulum or
Hénon-Heiles, whose noise has one defect or none. Rows are defects, columns are diagnoses.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections import Counter

import torch
from torch import Tensor, nn

from ahnn.data.generate import generate
from ahnn.data.segments import Segments
from ahnn.data.sensor import Sensor
from ahnn.evaluation.residual_diagnosis import remedy
from ahnn.integrators import INTEGRATORS
from ahnn.measurements import Segment
from ahnn.systems import HenonHeiles, MassSpring, Pendulum, System

SYSTEMS: dict[str, tuple[System, str]] = {
    "spring": (MassSpring(name="spring", dt=0.02, steps=400, mass=2.0), "stiffness"),
    "pendulum": (Pendulum(name="pendulum", dt=0.02, steps=400), "gravity"),
    "Hénon-Heiles": (HenonHeiles(name="henon_heiles", dt=0.05, steps=400), ""),
}
SAID = {
    "depends on the state": "dynamics",
    "coloured": "colour",
    "biased": "bias",
    "its own bias": "biases",
    "outliers": "tails",
    "times too": "size",
}
"""Words of a diagnosis, the first of which decides."""
KINDS = ("nothing", "bias", "biases", "colour", "tails", "size", "dynamics")
SD, EVERY = 0.01, 5


class Exact(nn.Module):
    """The flow of a system by RK4."""

    def __init__(self, system: System) -> None:
        super().__init__()
        self.system = system

    def increment(self, x: Tensor, dt: Tensor) -> Tensor:
        """Return x(t + dt) - x(t)."""
        return INTEGRATORS["rk4"].increment(self.system, x, dt)


def noise(kind: str, shape: tuple[int, ...], draw: torch.Generator) -> Tensor:
    """Return noise of a kind in units of its stated standard deviation, (B, K, M)."""
    uniform = float(torch.rand((), generator=draw))
    e = torch.randn(shape, generator=draw, dtype=torch.float64)
    if kind == "bias":
        return e + 0.4 + 0.6 * uniform
    if kind == "biases":
        return e + (0.5 + uniform) * torch.randn(shape[0], 1, shape[2], generator=draw, dtype=torch.float64)
    if kind == "colour":
        memory = 0.4 + 0.45 * uniform
        for k in range(1, shape[1]):
            e[:, k] = memory * e[:, k - 1] + (1 - memory**2) ** 0.5 * e[:, k]
        return e
    if kind == "tails":
        far = torch.rand(shape, generator=draw) < 0.01 + 0.09 * uniform
        return torch.where(far, 20 * e, e)
    if kind == "size":
        return e * (1.6 + uniform if uniform > 0.5 else 0.6 - 0.4 * uniform)
    return e


def case(kind: str, seed: int) -> tuple[nn.Module, Segment]:
    """Return dynamics and measurements."""
    draw = torch.Generator().manual_seed(seed)
    name = list(SYSTEMS)[seed % (2 if kind == "dynamics" else 3)]
    system, constant = SYSTEMS[name]
    count = 8 + int(torch.randint(0, 25, (), generator=draw))
    exact = generate(system, count, seed)
    sensor = Sensor(system.space, measured="position", noise=SD, every=EVERY)
    segment = Segments(sensor.measure(exact, 0), None, sensor.instrument(system.dt)).gather(
        torch.arange(count)
    )
    true = exact.states[:, ::EVERY, : system.dof][:, : segment.values.shape[1]]
    if kind == "dynamics":
        factor = 1.01 + 0.04 * float(torch.rand((), generator=draw))
        system = dataclasses.replace(system, **{constant: factor * getattr(system, constant)})
    return Exact(system), segment._replace(values=true + SD * noise(kind, tuple(true.shape), draw))


def said(kind: str, seed: int) -> str:
    """Return the first diagnosis of a case."""
    dynamics, segment = case(kind, seed)
    text = remedy(dynamics, segment, "none")
    found = [(text.index(words), word) for words, word in SAID.items() if words in text]
    word = min(found)[1] if found else "nothing"
    return "dynamics" if "depends on the state" in text else word


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    torch.set_num_threads(1)
    table: Counter[tuple[str, str]] = Counter()
    for number in range(asked.cases):
        kind = KINDS[number % len(KINDS)]
        table[kind, said(kind, 100_000 * asked.seed + number // len(KINDS))] += 1
    print(f"| was | {' | '.join(KINDS)} | right |")
    print("|---|" + "--:|" * (len(KINDS) + 1))
    for was in KINDS:
        row = [table[was, word] for word in KINDS]
        print(
            f"| {was} | {' | '.join(str(n or '') for n in row)} | {100 * table[was, was] / sum(row):.0f} % |"
        )
    right = sum(table[kind, kind] for kind in KINDS)
    print(f"{right} of {asked.cases} right")


if __name__ == "__main__":
    main()
