"""Measurements of a pushed cart with a pole: positions and angles with noise, and pushes in between.

The truth is the exact flow of the simulated system, from rest, 10 s; a measurement every 0.1 s on average
with noise of 1 mm and 1 mrad, and a new push of about 1 N every 0.3 s on average, between them; seed 0. The
folder receives `pushed.csv` with both, `seen.csv` with the measurements, and `pushes.csv` with the pushes.

    python benchmarks/simulate_pushes.py FOLDER
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch

from ahnn.dynamics.flow_at_time import at, steered
from ahnn.systems import CartPole
from ahnn.systems.truth import exact_flow

START, SECONDS, SD, PUSH = [0.2, 1.3, 0.0, 0.0], 10.0, 1e-3, 1.0


def main() -> None:
    """Write the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    draw = np.random.default_rng(0)
    pushed = np.cumsum(draw.exponential(0.3, 300)).round(3)
    pushed = np.unique(np.concatenate(([0.0], pushed[pushed < SECONDS])))
    pushes = (PUSH * draw.normal(size=len(pushed))).round(3)
    seen = np.unique(np.cumsum(draw.exponential(0.1, 1000)).round(3) + 0.0005)
    seen = seen[seen < SECONDS]
    flow = steered(exact_flow(CartPole(name="cart", dt=0.02, steps=1)), pushed, pushes[:, None])
    x, now = torch.tensor([START], dtype=torch.float64), 0.0
    lines, rows = [f"0,,,{pushes[0]}"], []
    for time in np.sort(np.concatenate((pushed[1:], seen))).tolist():
        x, now = at(flow, now)(x, time - now), time
        if time in pushed:
            lines.append(f"{time:.4f},,,{pushes[pushed == time][0]}")
        else:
            position, angle = (x[0, :2].numpy() + SD * draw.normal(size=2)).round(5)
            lines.append(f"{time:.4f},{position},{angle},")
            rows.append(f"{time:.4f},{position},{angle}")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "pushed.csv").write_text("\n".join(["time [s],x [m],theta [rad],u [N]", *lines]) + "\n")
    (folder / "seen.csv").write_text("\n".join(["time [s],x [m],theta [rad]", *rows]) + "\n")
    table = [f"{time:.4f},{push}" for time, push in zip(pushed, pushes, strict=True)]
    (folder / "pushes.csv").write_text("\n".join(["t [s],u [N]", *table]) + "\n")


if __name__ == "__main__":
    main()
