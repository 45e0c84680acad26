"""Is the default filter consistent after training on recorded fixes? A satellite on a transfer orbit.

    python benchmarks/bench_transfer_orbit.py simulate FOLDER
    python -m ahnn.train system=files system.path=FOLDER/fixes.csv system.cut=720 data.noise=0.02 \
        hamiltonian=central_body inputs=isotropic run=RUN
    python benchmarks/bench_transfer_orbit.py judge FOLDER RUN --draws 8

The truth is the motion about an oblate planet, from 250 km at an eccentricity of 0.73. Fixes with noise of
20 m come every minute: 20 days for the training run, and two later days, which `ahnn.assimilate` follows from
`start=fit` with default options, once for each draw of their noise. Errors along a track are correlated, so
the mean NEES of a single track scatters widely even if the filter is right; for comparison, the same is done
with the exact dynamics.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

import numpy as np
import torch

from ahnn.estimation import initial_belief
from ahnn.estimation.consistency import nees
from ahnn.measurements import Position
from ahnn.systems import Molniya
from ahnn.systems.truth import exact_flow
from ahnn_plugins.ukf import unscented_filter

SYSTEM = Molniya(
    name="transfer",
    dt=60.0,
    steps=1440,
    altitude=(250.0, 250.0),
    eccentricity=(0.73, 0.73),
    inclination=(7.0, 7.0),
    raan=(0.0, 360.0),
)
TRAINED, FOLLOWED, SD, DT = 28_800, 2880, 0.02, 60.0
STATE = ("x", "y", "z", "vx", "vy", "vz")
SETTLED = 20
"""Measurements that fit the start."""


def truth(seed: int) -> torch.Tensor:
    """Return the states (N, 6) at every minute, in km and km/s."""
    x, flow = SYSTEM.initial_states(1, torch.Generator().manual_seed(seed)).double(), exact_flow(SYSTEM)
    states = [x[0]]
    for _ in range(TRAINED + FOLLOWED):
        x = flow(x, DT)
        states.append(x[0])
    return torch.stack(states)


def write(path: Path, first: int, places: np.ndarray, draw: np.random.Generator) -> None:
    """Write fixes of positions (N, 3), the first at a minute."""
    fixes = places + SD * draw.normal(size=places.shape)
    seconds = DT * (first + np.arange(len(places)))
    heading = "time [s],x [km],y [km],z [km]"
    np.savetxt(
        path, np.column_stack((seconds, fixes)), fmt="%.6f", delimiter=",", header=heading, comments=""
    )


def simulate(folder: Path, seed: int) -> None:
    """Write the truth and the fixes of the training."""
    folder.mkdir(parents=True, exist_ok=True)
    states = truth(seed).numpy()
    np.save(folder / "truth.npy", states)
    write(folder / "fixes.csv", 0, states[:TRAINED, :3], np.random.default_rng(seed))


def consistency(track: Path, states: np.ndarray) -> tuple[float, float]:
    """Return the mean NEES of a track, and the rms of its position errors in km."""
    rows = np.genfromtxt(track, delimiter=",", names=True, dtype=None, encoding=None)
    rows = rows[rows["outcome"] == "taken"]
    errors = np.stack([rows[name] for name in STATE], axis=1) - states[np.rint(rows["time"] / DT).astype(int)]
    covariances = np.zeros((len(rows), 6, 6))
    for i, a in enumerate(STATE):
        for j, b in enumerate(STATE[: i + 1]):
            covariances[:, i, j] = covariances[:, j, i] = rows[f"cov_{a}_{b}"]
    squares = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(covariances), errors)
    return float(squares.mean()), float(np.sqrt((errors[:, :3] ** 2).sum(1).mean()))


def exact(states: torch.Tensor, draws: int) -> torch.Tensor:
    """Return the mean NEES (draws,) of the filter with the exact dynamics and no process noise."""
    generator = torch.Generator().manual_seed(0)
    followed, spread = states[TRAINED:], torch.tensor([1.0] * 3 + [1e-3] * 3, dtype=torch.float64)
    noise = torch.randn(draws, len(followed), 3, generator=generator, dtype=torch.float64)
    starts = followed[:1] + spread * torch.randn(draws, 6, generator=generator, dtype=torch.float64)
    belief, seen = initial_belief(starts, torch.diag(spread**2)), (followed[:, :3] + SD * noise)[:, 1:]
    nothing, given = torch.zeros(6, 6, dtype=torch.float64), SD**2 * torch.eye(3, dtype=torch.float64)
    found = unscented_filter(exact_flow(SYSTEM), belief, seen, Position(3), nothing, given, DT)
    return nees(found.means - followed[1:], found.chols)[:, SETTLED:].mean(1)


def judge(folder: Path, run: str, draws: int) -> None:
    """Follow the later fixes with new noise in each draw, and print the NEES of the tracks."""
    states, found = np.load(folder / "truth.npy"), []
    for k in range(1, draws + 1):
        later, track = folder / f"later_{k}.csv", folder / f"track_{k}.csv"
        write(later, TRAINED, states[TRAINED:, :3], np.random.default_rng(1000 + k))
        track.unlink(missing_ok=True)
        words = [
            f"run={run}",
            f"measurements={later}",
            f"measurement.sd={SD}",
            "start=fit",
            f"output={track}",
        ]
        subprocess.run(
            [sys.executable, "-m", "ahnn.assimilate", *words], check=True, stderr=subprocess.DEVNULL
        )
        found.append(consistency(track, states))
        print(f"draw {k}: NEES {found[-1][0]:.1f} of 6, position {1000 * found[-1][1]:.1f} m", flush=True)
    squares = np.array(found)[:, 0]
    print(f"learned: mean NEES {squares.mean():.1f}, {squares.min():.1f} to {squares.max():.1f}")
    known = exact(torch.as_tensor(states), draws)
    print(f"exact dynamics: mean NEES {known.mean():.1f}, {known.min():.1f} to {known.max():.1f}")


def main() -> None:
    """Simulate, or judge."""
    kind = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=kind)
    doors = parser.add_subparsers(dest="door", required=True)
    making = doors.add_parser("simulate")
    making.add_argument("folder", type=Path)
    making.add_argument("--seed", type=int, default=0)
    judging = doors.add_parser("judge")
    judging.add_argument("folder", type=Path)
    judging.add_argument("run")
    judging.add_argument("--draws", type=int, default=8)
    args = parser.parse_args()
    if args.door == "simulate":
        simulate(args.folder, args.seed)
    else:
        judge(args.folder, args.run, args.draws)


if __name__ == "__main__":
    main()
