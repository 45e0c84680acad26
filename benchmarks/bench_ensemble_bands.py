"""Which bands of a training on few measurements are right: Laplace's, an ensemble's, or those of both?

    python benchmarks/bench_ensemble_bands.py FOLDER experiment=pendulum_angles [--members 8] [--draws 5]

The words are those of `python -m ahnn.train` for a training on simulated measurements. Each draw has its
own trajectories, noise and weights (data.seed and seed), and leaves an ensemble in FOLDER/draw_K, which a
repeated command reads. The unseen trajectories are 100 of another seed, from their true starts. Printed, for
each draw and in the mean, are of all later states of the first position: the continuous ranked probability
score, the fraction within two standard deviations, and the rms error, for

- laplace: a member with its own band, the mean over the members;
- median: the same, the median over the members, so that failed trainings count little;
- ensemble: the members as points;
- mixture: the members with their bands.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from statistics import fmean, median

import torch
from torch import Tensor

from ahnn import load_ensemble
from ahnn.cli.compose import compose_job
from ahnn.cli.ensemble_training import prepare_members
from ahnn.cli.parts import build_source
from ahnn.cli.preflight import quiet
from ahnn.data import Simulated
from ahnn.jobs.closing import conclude_on_measurements
from ahnn.jobs.fitting import fit
from ahnn.loading import member_folders
from ahnn.types import Trajectories
from ahnn.uncertainty import mixture_crps
from ahnn.uncertainty.posterior import FILE

UNSEEN, SEED = 100, 90_000
"""Number of unseen trajectories and their seed."""
KINDS = ("laplace", "median", "ensemble", "mixture")


def trained(words: list[str], folder: Path) -> Trajectories:
    """Train an ensemble unless it is there, and return the unseen trajectories."""
    cfg = compose_job([*words, "logger=none"], folder)
    source = build_source(cfg)
    assert isinstance(source, Simulated)
    if sum((member / FILE).exists() for member in member_folders(folder)) < cfg.members:
        quiet()
        prepared = prepare_members(cfg)
        fit(prepared)
        for member in prepared.members:
            conclude_on_measurements(member)
    return Simulated(source.truth, trajectories=UNSEEN, seed=SEED, cache=cfg.data.cache).read()


def score(truth: Tensor, means: Tensor, deviations: Tensor | None, total: Tensor) -> tuple[float, ...]:
    """Return score, fraction within two standard deviations and rms error of a mixture.

    Args:
        truth: true values, (B, T).
        means: means of the S members, (S, B, T).
        deviations: their standard deviations, or None.
        total: standard deviation of the mixture, (B, T).
    """
    off = means.mean(0) - truth
    crps = float(mixture_crps(truth, means, deviations).mean())
    return crps, float((off.abs() <= 2 * total).double().mean()), float(off.square().mean().sqrt())


def compared(folder: Path, unseen: Trajectories) -> dict[str, tuple[float, ...]]:
    """Return the scores of each kind of bands."""
    ensemble = load_ensemble(folder)
    start, steps = unseen.states[:, 0], unseen.states.shape[1] - 1
    dt = float(unseen.times[0, 1] - unseen.times[0, 0])
    truth = unseen.states[:, 1:, 0]
    means = ensemble.rollouts(start, steps, dt)[:, :, 1:, 0]
    own = torch.stack([run.band(start, steps, dt)[:, 1:, 0] for run in ensemble.runs])
    spread = means.std(0)
    singly = [score(truth, m[None], s[None], s) for m, s in zip(means, own, strict=True)]
    return {
        "laplace": tuple(fmean(column) for column in zip(*singly, strict=True)),
        "median": tuple(median(column) for column in zip(*singly, strict=True)),
        "ensemble": score(truth, means, None, spread),
        "mixture": score(truth, means, own, (spread.square() + own.square().mean(0)).sqrt()),
    }


def line(name: str, found: dict[str, tuple[float, ...]]) -> str:
    """Return the scores of a draw as a line."""
    cells = (f"{kind} {c:.3g}, {100 * w:.3g} %, {e:.3g}" for kind, (c, w, e) in found.items())
    return f"{name}: {'; '.join(cells)}"


@torch.no_grad()
def main() -> None:
    """Print a line for each draw, and the means."""
    kind = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=kind)
    parser.add_argument("folder", type=Path)
    parser.add_argument("words", nargs="+")
    parser.add_argument("--members", type=int, default=8)
    parser.add_argument("--draws", type=int, default=5)
    asked, found = parser.parse_args(), []
    for k in range(1, asked.draws + 1):
        own = [f"members={asked.members}", f"seed={100 * k}", f"data.seed={k}"]
        folder = asked.folder / f"draw_{k}"
        with torch.enable_grad():
            unseen = trained([*asked.words, *own], folder)
        found.append(compared(folder, unseen))
        print(line(f"draw {k}", found[-1]), flush=True)
    columns = {kind: zip(*(one[kind] for one in found), strict=True) for kind in KINDS}
    print(line("mean", {kind: tuple(map(fmean, column)) for kind, column in columns.items()}))


if __name__ == "__main__":
    main()
