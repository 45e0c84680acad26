"""What is gained by estimating the tails of the noise? Draws of swings measured with Student's noise.

    python benchmarks/bench_tails.py RUN --freedom 3 5 30 --draws 5

RUN is the folder of a training with experiment=pendulum_angles, whose weights are the start. Each draw has 80
swings of 4 s, half of them for the training and 32 for the test, and noise with the scale 0.004 rad. The last
step of a training is taken twice: with squares of residuals in units of that scale, and with
data.tails=estimate. Each line: the estimate with its 95 % interval; unseen measurements and true states of
forecasts, and states of predictions from true starts, within 1, 2 and 3 standard deviations; the rms error of
these predictions; and the scatter of their errors along independent directions, 1 for calibrated bands.
"""

from __future__ import annotations

import argparse
import copy
from pathlib import Path

from omegaconf import OmegaConf

from ahnn import load
from ahnn.cli.parts import build_sensor, build_source
from ahnn.data import SplitData
from ahnn.data.segments import whole
from ahnn.evaluation.bands import banded, percent
from ahnn.evaluation.forecast import forecast
from ahnn.evaluation.make_case import make_case
from ahnn.rollouts import rollout
from ahnn.runs import Run
from ahnn.training.estimated_noise import conclude_with_noise

CHANGED = {"trajectories": 80, "noise": 0.004, "split": [0.5, 0.1, 0.4]}


def line(run: Run, freedom: float, seed: int, tails: str | None) -> str:
    """Return what one draw led to."""
    cfg = OmegaConf.create(run.config)
    OmegaConf.set_struct(cfg, False)
    cfg.system.steps = 160
    for key, value in {**CHANGED, "seed": seed, "freedom": freedom, "tails": tails}.items():
        cfg.data[key] = value
    source = build_source(cfg)
    sensor = build_sensor(cfg, source)
    assert sensor is not None
    data = SplitData(source, list(cfg.data.split), sensor)
    train, val = (whole(data.measured(split), data.instrument()) for split in ("train", "val"))
    dynamics = copy.deepcopy(run.trained).requires_grad_(True)
    found, noise = conclude_with_noise(dynamics, train, val, 0, "none", sensor.unknown)
    assert found is not None
    learned, found = found.taken(dynamics)
    known = {"uncertainty": found, "noise": None if noise is None else noise.about()}
    case = make_case(learned, data, label="", seed=0, folder=run.folder, **known)
    band = banded(case, found, rollout(learned, case.test.states[:, 0], case.dt, case.test.states.shape[1]))
    assert case.measured is not None
    ahead = forecast(learned, case.measured, found.spread, "none", case.test)
    assert ahead is not None
    assert ahead.states is not None
    said = "squares" if noise is None else "normal, more than {1:.2g}"
    if noise is not None:
        ends = noise.freedom[0], noise.freedom_low[0], noise.freedom_high[0]
        said = ("{0:.2f} ({1:.2f} to {2:.2f})" if noise.freedom[0] else said).format(*ends)
        said += f", scale {noise.deviations[0]:.5f} ± {noise.scale_sd[0]:.1g}"
    return (
        f"{freedom:g}, draw {seed}: {said}; measurements {percent(ahead.coverage)} %, forecasts "
        f"{percent(ahead.states)} %, predictions {percent(band.coverage)} %, error "
        f"{band.efficiency[0] * band.bound[0]:.2e} rad, {band.test.scatter:.2f} along {band.test.directions}"
    )


def main() -> None:
    """Print two lines for each draw."""
    kind = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=kind)
    parser.add_argument("run", type=Path)
    parser.add_argument("--freedom", type=float, nargs="+", default=[3, 5, 30])
    parser.add_argument("--draws", type=int, default=5)
    args = parser.parse_args()
    run = load(args.run)
    for freedom in args.freedom:
        for seed in range(1, args.draws + 1):
            for tails in (None, "estimate"):
                print(line(run, freedom, seed, tails), flush=True)


if __name__ == "__main__":
    main()
