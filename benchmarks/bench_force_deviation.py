"""Predicted and actual error of the learned force of a run on orbits, over the distance.

    python benchmarks/bench_force_deviation.py RUN

RUN is the folder of a run trained on measurements of `system=molniya`, for example with
`experiment=molniya_positions`. Errors relative to the force, root mean squares over unseen trajectories.
"""

from __future__ import annotations

import sys
from itertools import pairwise

import torch

from ahnn import load
from ahnn.data.generate import generate
from ahnn.systems import Molniya
from ahnn.uncertainty import force_deviation

RADII = (6_300, 7_500, 11_000, 16_000, 25_000, 36_000, 50_000)
"""Bounds of the distances, km."""
SEED, COUNT, EVERY, WEIGHED = 12345, 25, 7, 500


@torch.no_grad()
def main() -> None:
    """Print a line for each range of distances."""
    run = load(sys.argv[1])
    system = Molniya(name="molniya", dt=60.0, steps=1440)
    x = generate(system, COUNT, SEED).states[:, ::EVERY].flatten(0, 1)
    assert run.uncertainty is not None, "expected a run that has a covariance"
    deviation = force_deviation(run.dynamics, run.uncertainty.spread, x[:: len(x) // WEIGHED])
    true, dof = system.force(x[:, :3]), 3
    off = (run.dynamics.field(x)[:, dof:] - true).norm(dim=1) / true.norm(dim=1) / dof**0.5
    believed, distance = deviation(x), x[:, :dof].norm(dim=1)
    for low, high in pairwise(RADII):
        here = (distance >= low) & (distance < high)
        rms = [float(part[here].square().mean().sqrt()) for part in (believed, off)]
        print(f"{low:6,} to {high:6,} km: believed {rms[0]:.2e}, off {rms[1]:.2e}")


if __name__ == "__main__":
    main()
