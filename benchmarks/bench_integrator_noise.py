"""Error of an integrator, compared with the noise of positions.

    python benchmarks/bench_integrator_noise.py

The exact field of Molniya orbits, with several integrators and steps, is compared with the unseen positions
of `experiment=molniya_positions`, 100 m of noise every five minutes, each day from the best-fitting start.
Chi-square per degree of freedom is 1 if only noise remains.
"""

from __future__ import annotations

import tempfile
from typing import Any

import torch
from torch import Tensor, nn

from ahnn.cli.compose import composed
from ahnn.cli.prepare import prepare
from ahnn.evaluation.goodness_of_fit import explain
from ahnn.integrators import INTEGRATORS
from ahnn.types import TimeStep, VectorField

STEPS = (60.0, 150.0, 300.0)
METHODS = ("rk4", "dopri5", "dopri8")


class Exact(nn.Module):
    """The flow of a known field through an integrator."""

    def __init__(self, known: VectorField, method: str) -> None:
        super().__init__()
        self.known, self.method = known, INTEGRATORS[method]

    def increment(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return x(t + dt) - x(t), shape (B, D)."""
        return self.method.increment(self.known, x, dt)


def main() -> None:
    """Print what each integrator leaves."""
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        options = ["experiment=molniya_positions", "plugins=none", f"folder={folder}", f"run={folder}"]
        data: Any = prepare(composed("train", options)).data
        data.statistics()
        unseen = data.whole("val")
        for step in STEPS:
            measured = unseen._replace(instrument=unseen.instrument._replace(longest=step))
            for method in METHODS:
                found = explain(Exact(data.source.truth, method), measured)
                left = "no path" if found.lost == found.trajectories else f"{found.chi_square:.4f}"
                print(f"{method:8s} {step:4.0f} s  {left}", flush=True)


if __name__ == "__main__":
    main()
