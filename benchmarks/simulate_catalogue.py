"""Position fixes of 200 Molniya satellites in one table, in order of arrival, and a table of their starts.

The truth is the exact flow of the simulated system: each satellite is measured 40 times, about once a minute,
with noise of 0.1 km. Some lines are late, the start of one satellite has an error of 5,000 km, and one
satellite has no start.

    python benchmarks/simulate_catalogue.py FOLDER
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch

import ahnn
from ahnn.systems import Molniya
from ahnn.systems.truth import exact_flow

COUNT, FIXES, SD, START_SD = 200, 40, 0.1, (1.0, 1e-3)
HEAD = "id,t [s],x [km],y [km],z [km],vx [km/s],vy [km/s],vz [km/s],sd_x,sd_y,sd_z,sd_vx,sd_vy,sd_vz"


def main() -> None:
    """Write both tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    draw = np.random.default_rng(0)
    options = ahnn.load("molniya_mechanical").config["system"]
    system = Molniya(**{name: value for name, value in options.items() if name[0] != "_"})
    flow, names = exact_flow(system), [f"sat-{k + 1}" for k in range(COUNT)]
    x = system.initial_states(COUNT, torch.Generator().manual_seed(0))
    sds, times, lines = np.repeat(START_SD, 3), np.zeros(COUNT), []
    starts = x.numpy() + sds * draw.normal(size=(COUNT, 6))
    starts[6, 0] += 5000.0
    rows = [f"{name},0,{','.join(map(str, (*row, *sds)))}" for name, row in zip(names, starts, strict=True)]
    (folder / "starts.csv").write_text("\n".join([HEAD, *rows[:-1]]) + "\n")
    for _ in range(FIXES):
        steps = draw.uniform(40.0, 60.0, COUNT)
        x, times = flow(x, torch.from_numpy(steps)), times + steps
        fixes = x[:, :3].numpy() + SD * draw.normal(size=(COUNT, 3))
        for name, time, fix in zip(names, times, fixes, strict=True):
            late = 90.0 * (draw.uniform() < 0.02)
            cells = ",".join(f"{value:.4f}" for value in fix)
            lines.append((time + late, f"{time:.3f},{name},{cells}"))
    table = ["time [s],satellite,x [km],y [km],z [km]", *(line for _, line in sorted(lines))]
    (folder / "fixes.csv").write_text("\n".join(table) + "\n")


if __name__ == "__main__":
    main()
