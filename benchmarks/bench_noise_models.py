"""Bands of a run whose noise is biased, coloured or of another size, before and after it is estimated.

    python benchmarks/bench_noise_models.py [--draws 5] [--kinds bias,colour,size] [--run DIR]

Angles of a pendulum, 100 swings of 10 s, every 0.1 s, with a standard deviation of 0.01 rad. The epochs are
taken from one training run on white noise (`--run`, created if missing); the final steps, which lead to the
optimum, are taken on measurements of each draw, once as stated and once with the noise model. Errors refer to
rollouts of 32 unseen swings from their true start.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ahnn.checkpoints import read_weights
from ahnn.data.generate import generate
from ahnn.data.segments import whole
from ahnn.data.sensor import Sensor
from ahnn.evaluation.residual_diagnosis import invisible, remedy
from ahnn.loading import made, weights_path
from ahnn.measurements import NoiseEstimate, Observations, Segment, UnknownNoise
from ahnn.rollouts import rollout
from ahnn.systems import Pendulum
from ahnn.training.estimated_noise import conclude_with_noise
from ahnn.uncertainty import rollout_covariances

SD, EVERY, TRAIN, VALIDATION, UNSEEN = 0.01, 4, 100, 20, 32
SYSTEM = Pendulum(name="pendulum", dt=0.025, steps=400)
EPOCHS = ["experiment=pendulum_angles", "data.trajectories=250", "trainer.max_epochs=3", "plugins=none"]
ASKED = {
    "bias": UnknownNoise(bias_sd=torch.tensor([SD], dtype=torch.float64)),
    "colour": UnknownNoise(correlation=True),
    "size": UnknownNoise(sizes=True),
}


def noise(kind: str, shape: tuple[int, ...], draw: torch.Generator) -> Tensor:
    """Return noise of a kind in units of its stated standard deviation, (B, K, 1)."""
    e = torch.randn(shape, generator=draw, dtype=torch.float64)
    if kind == "bias":
        return e + 0.5
    if kind == "size":
        return e / 3
    for k in range(1, shape[1]):
        e[:, k] = 0.8 * e[:, k - 1] + 0.6 * e[:, k]
    return e


def measured(kind: str, seed: int) -> tuple[Segment, Segment]:
    """Return measurements for training and for validation."""
    exact = generate(SYSTEM, TRAIN + VALIDATION, seed)
    values, times = exact.states[:, ::EVERY, :1], exact.times[:, ::EVERY]
    values = values + SD * noise(kind, tuple(values.shape), torch.Generator().manual_seed(seed))
    instrument = Sensor(SYSTEM.space, measured="position", noise=SD, every=EVERY, stride=2).instrument(
        SYSTEM.dt
    )
    parts = (slice(0, TRAIN), slice(TRAIN, None))
    train, held_out = (whole(Observations(values[part], times[part]), instrument) for part in parts)
    return train, held_out


def scored(dynamics: Any, spread: Tensor, truth: Tensor) -> tuple[float, float, float]:
    """Return rms error over rms band, rms of errors in their own deviations, and coverage of 2 sigma."""
    off = (rollout(dynamics, truth[:, 0], SYSTEM.dt, truth.shape[1]) - truth)[:, 1:]
    lengths = torch.full((len(truth), truth.shape[1] - 1), SYSTEM.dt, dtype=torch.float64)
    variance = rollout_covariances(dynamics, truth[:, 0], lengths, spread).diagonal(dim1=-2, dim2=-1)[:, 1:]
    z = off / variance.sqrt()
    ratio = off.square().mean((0, 1)).sqrt() / variance.mean((0, 1)).sqrt()
    return float(ratio.mean()), float(z.square().mean().sqrt()), float((z.abs() <= 2).double().mean())


@torch.no_grad()
def main() -> None:
    """Print a line for each draw, and means."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--draws", type=int, default=5)
    parser.add_argument("--kinds", default="bias,colour,size")
    parser.add_argument("--run", type=Path, default=Path("runs/bench_noise_models"))
    asked = parser.parse_args()
    if not asked.run.exists():
        subprocess.run([sys.executable, "-m", "ahnn.train", *EPOCHS, f"run={asked.run}"], check=True)
    truth = generate(SYSTEM, UNSEEN, 4711).states
    for draw in range(asked.draws):
        for kind in asked.kinds.split(","):
            train, held_out = measured(kind, 1000 + draw)
            for unknown in (UnknownNoise(), ASKED[kind]):
                dynamics = made(read_weights(weights_path(asked.run)), asked.run).dynamics
                found, estimate = conclude_with_noise(dynamics, train, held_out, 0, "none", unknown)
                assert found is not None
                learned, known = found.taken(dynamics)
                ratio, z, held = scored(learned, known.spread, truth)
                which = "estimated" if unknown.anything else "as stated"
                print(
                    f"{kind} {draw} {which}: error over band {ratio:.2f}, z rms {z:.2f}, "
                    f"2 sigma {100 * held:.0f} %, chi-square {found.about['chi_square']:.3f}, "
                    f"inflation {known.inflation:.2f} | {said(learned, held_out, estimate, unknown)}",
                    flush=True,
                )


def said(learned: Any, unseen: Segment, estimate: NoiseEstimate | None, unknown: UnknownNoise) -> str:
    """Return the note of a training run on the noise."""
    seen, found = unseen.instrument, list[str]()
    if estimate is not None:
        found = estimate.sentences(seen.measurement.names, seen.measurement.units)
        unseen = unseen._replace(instrument=estimate.applied(seen, unknown))
    found += [remedy(learned, unseen, "none"), invisible(learned, unseen, estimate)]
    return "; ".join(filter(None, found))


if __name__ == "__main__":
    main()
