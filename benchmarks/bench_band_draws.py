"""Are bands calibrated? The final steps of training on measurements, repeated with new noise.

    python benchmarks/bench_band_draws.py RUN --draws 20

With --anew, training and test trajectories are drawn again, too.

RUN is the folder of a run trained on simulated measurements. A run is one draw: its errors are correlated, so
a band contains nearly all of them or few. Therefore measurements on the same trajectories are drawn again,
the final steps are repeated from the weights of the run, and the new covariance is compared with unseen
trajectories from their true starts. Each draw is a row, followed by a summary. With calibrated bands, errors
are 1 in units of the Cramer-Rao bound (rms over the draws), 68, 95 and 99.7 % are within 1, 2 and 3 standard
deviations, and chi-square of unseen measurements is in its 95 % band in 19 of 20 draws.
"""

from __future__ import annotations

import argparse
import copy
from pathlib import Path
from typing import NamedTuple

import torch
from omegaconf import OmegaConf

from ahnn import load
from ahnn.cli.parts import build_sensor, build_source
from ahnn.data import SplitData
from ahnn.data.segments import whole
from ahnn.evaluation.bands import banded
from ahnn.evaluation.goodness_of_fit import explain
from ahnn.evaluation.independent_directions import DirectionTest, together
from ahnn.evaluation.make_case import make_case
from ahnn.jobs.evaluating import robust_of
from ahnn.rollouts import rollout
from ahnn.runs import Run
from ahnn.training.laplace import conclude


class Drawn(NamedTuple):
    """What one draw of the noise led to.

    Attributes:
        efficiency: rms position error in units of the Cramer-Rao bound.
        coverage: shares of unseen states within 1, 2 and 3 standard deviations.
        chi_square: of unseen measurements, with its 95 % band.
        remaining, determined: squared length of the step that is left, and of the one that noise gives.
        held_out, own: factors on the covariance by validation, and chi-square of the training.
        test: of the width of the bands along the independent directions of errors.
    """

    efficiency: float
    coverage: tuple[float, ...]
    chi_square: float
    band: tuple[float, float]
    remaining: float
    determined: float
    held_out: float
    own: float
    test: DirectionTest

    @property
    def inside(self) -> bool:
        """Whether chi-square is in its band."""
        return self.band[0] <= self.chi_square <= self.band[1]


def drawn(run: Run, seed: int, *, anew: bool) -> Drawn | None:
    """Return the results for measurements of another seed; None if no trajectory is explained."""
    cfg, robust = OmegaConf.create(run.config), robust_of(run)
    source = build_source(cfg)
    cfg.data.seed = seed
    source = build_source(cfg) if anew else source
    data = SplitData(source, list(cfg.data.split), build_sensor(cfg, source))
    dynamics = copy.deepcopy(run.trained).requires_grad_(True)
    train, val = (whole(data.measured(split), data.instrument()) for split in ("train", "val"))
    found = conclude(dynamics, train, val, 0, robust)
    if found is None:
        return None
    learned, found = found.taken(dynamics)
    about = {"label": "", "seed": 0, "folder": run.folder}
    case = make_case(learned, data, uncertainty=found, robust=robust, **about)
    truth = case.test.states
    assert case.measured is not None
    band = banded(case, found, rollout(learned, truth[:, 0], case.dt, truth.shape[1]))
    left = explain(learned, case.measured, robust)
    sizes = (found.about[name] for name in ("remaining", "determined", "held_out", "chi_square"))
    return Drawn(band.efficiency[0], band.coverage, left.chi_square, left.band, *sizes, test=band.test)


def main() -> None:
    """Print a row for each draw, and their means."""
    kind = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=kind)
    parser.add_argument("run", type=Path)
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--first", type=int, default=1001, help="seed of the first draw")
    parser.add_argument("--anew", action="store_true", help="draw trajectories again, too")
    args = parser.parse_args()
    run, draws = load(args.run), []
    for seed in range(args.first, args.first + args.draws):
        one = drawn(run, seed, anew=args.anew)
        if one is None:
            print(f"{seed}: fits no trajectory", flush=True)
            continue
        draws.append(one)
        shares = ", ".join(f"{100 * share:5.1f}" for share in one.coverage)
        print(
            f"{seed}: {one.efficiency:.2f} of the bound; {shares} %; {one.test.scatter:.2f} along "
            f"{one.test.directions} directions; chi-square {one.chi_square:.4f} "
            f"({one.band[0]:.4f} to {one.band[1]:.4f}); left {one.remaining:.2g} of {one.determined:.0f}; "
            f"inflation {one.held_out:.3g} x {max(one.own, 1.0):.3g}",
            flush=True,
        )
    means = torch.tensor([one.coverage for one in draws]).mean(0)
    efficiency = torch.tensor([one.efficiency for one in draws]).square().mean().sqrt()
    shares = ", ".join(f"{100 * share:.1f}" for share in means.tolist())
    every = together([one.test for one in draws])
    print(
        f"{len(draws)} draws: {efficiency:.2f} of the bound (rms); {shares} %; {every.sentence()}", end="; "
    )
    print(f"chi-square in its band in {sum(one.inside for one in draws)} of them")


if __name__ == "__main__":
    main()
