"""Planned sessions of five stations compared with equally spaced sessions, over draws of the start.

    python benchmarks/bench_plan.py [--draws 20] [--choose 4] [--run DIR]

A satellite on a Molniya orbit (the pretrained mechanical model) with a random phase and ascending node, known
to within 1 km and 1 m/s, is measured in sessions of one hour within two days; the forecast is for the fifth
day. With a run, whose parameters are uncertain, too, the starts are states of its training data. The number
of equally spaced sessions is increased until they are as good as the plan.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from pathlib import Path

import numpy as np
import torch

import ahnn
from ahnn.data.files.object_name import ObjectName
from ahnn.data.starts import Starts
from ahnn.jobs.planning import candidates, stations_of
from ahnn.prediction.measurement_plan import evenly_spaced, plan_measurements, variance_with
from ahnn.prediction.propagation import prediction_factors

WHOLE = {"range": 0.01, "azimuth": 0.006, "elevation": 0.006}
STATIONS = {
    "kiruna": {"latitude": 67.86, "longitude": 20.96, "min_elevation": 10, "noise": WHOLE},
    "dongara": {"latitude": -29.05, "longitude": 115.35, "min_elevation": 10, "noise": WHOLE},
    "kourou": {"latitude": 5.25, "longitude": -52.8, "min_elevation": 10, "noise": WHOLE},
    "hawaii": {"latitude": 19.0, "longitude": -155.7, "min_elevation": 10, "noise": WHOLE},
    "troll": {
        **{"latitude": -72.0, "longitude": 2.5, "min_elevation": 10},
        **{"noise": {"range": 0.01}, "bias_sd": {"range": 0.02}},
    },
}
PERIGEE = [0.0, -3145.0, -6173.0, 10.0, 0.0, 0.0]
DAY, EVERY, SESSION = 86_400.0, 600.0, 6
SD = [1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-3]


def start_of(run: ahnn.Run, seed: int) -> torch.Tensor:
    """Return a state at a random time of the orbit, turned about the Earth's axis by a random angle."""
    random = np.random.default_rng(seed)
    if run.uncertainty is not None and run.domain is not None:
        return run.domain.states[random.integers(len(run.domain.states))]
    later = run.predict(PERIGEE, [0.0, random.uniform(600.0, 43_000.0)]).states[0, 1]
    angle = random.uniform(0, math.tau)
    cosine, sine = math.cos(angle), math.sin(angle)
    turn = torch.tensor([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]], dtype=torch.float64)
    return torch.cat([turn @ part for part in later.chunk(2)])


def drawn(run: ahnn.Run, stations: str, seed: int, count: int) -> tuple[float, float, int, int]:
    """Return the deviation with a plan and with equal spacing, and the equally spaced number as good."""
    start = start_of(run, seed)
    grid = torch.arange(0.0, 2 * DAY + 1, EVERY, dtype=torch.float64)
    times = torch.cat((grid, torch.tensor([5 * DAY], dtype=torch.float64)))
    known = run.knowledge(torch.tensor(SD).double().square().diag())
    states, factors = prediction_factors(run.dynamics, start, times, run.dt, known)
    begin = Starts((ObjectName("0"),), start.unsqueeze(0), torch.zeros(1, dtype=torch.float64))
    sensors = stations_of(stations, begin, run)
    rows = [one.rows for one in candidates(sensors, states[:-1], factors[:-1], grid, SESSION)]
    moved = factors[-1, :3]
    forecast = torch.nn.functional.pad(moved, (0, rows[0].shape[1] - moved.shape[1]))
    planned = float(plan_measurements(rows, forecast, count).variances[-1].sqrt())
    equal = [
        float(variance_with([rows[k] for k in evenly_spaced(len(rows), more)], forecast).sqrt())
        for more in range(count, len(rows) + 1)
    ]
    good = next((count + k for k, spread in enumerate(equal) if spread <= planned), len(rows))
    return planned, equal[0], good, len(rows)


def main() -> None:
    """Print a row for each draw, and medians with ranges."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--choose", type=int, default=4)
    parser.add_argument("--run", default="molniya_mechanical")
    options = parser.parse_args()
    torch.set_num_threads(1)
    run, found = ahnn.load(options.run), []
    with tempfile.TemporaryDirectory() as folder:
        stations = Path(folder) / "stations.yaml"
        stations.write_text(json.dumps(STATIONS))
        for seed in range(options.draws):
            found.append(drawn(run, str(stations), seed, options.choose))
            text = "draw {:2d}: {:.4f} km planned, {:.4f} km equal, {} of {} as good"
            print(text.format(seed, *found[-1]), flush=True)
    table = np.array(found)
    for name, values in (("equal / planned", table[:, 1] / table[:, 0]), ("sessions as good", table[:, 2])):
        print(f"{name}: median {np.median(values):.2f}, range {values.min():.2f} to {values.max():.2f}")


if __name__ == "__main__":
    main()
