"""Position fixes of a Molniya satellite in order of arrival, with noise, a gap, outliers and late lines.

The truth is the exact flow of the simulated system, 12 hours from perigee, a fix every 20 s on average, noise
0.1 km, seed 0.

    python benchmarks/simulate_fixes.py FILE
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch

import ahnn
from ahnn.systems import Molniya
from ahnn.systems.truth import exact_flow

START, HOURS, SD = [0.0, -3145.0, -6173.0, 10.0, 0.0, 0.0], 12, 0.1


def main() -> None:
    """Write the fixes."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("file", type=Path)
    path = parser.parse_args().file
    draw = np.random.default_rng(0)
    system = {
        name: value
        for name, value in ahnn.load("molniya_mechanical").config["system"].items()
        if name[0] != "_"
    }
    flow = exact_flow(Molniya(**system))
    x, now, lines = torch.tensor([START], dtype=torch.float64), 0.0, []
    while (dt := float(draw.exponential(20.0)) + 0.1) + now < 3600 * HOURS:
        x, now = flow(x, dt), now + dt
        if 5.0 < now / 3600 < 6.0:  # no reception
            continue
        q = x[0, :3].numpy() + SD * draw.normal(size=3)
        q += 50.0 * (draw.uniform() < 0.01) * draw.normal(size=3)
        cells = ["" if draw.uniform() < 0.01 else f"{value:.4f}" for value in q]
        lines.append(f"{now:.3f},{','.join(cells)}")
    for k in range(25, len(lines), 50):  # two change places
        lines[k - 1], lines[k] = lines[k], lines[k - 1]
    path.write_text("\n".join(["time [s],x [km],y [km],z [km]", *lines]) + "\n")


if __name__ == "__main__":
    main()
