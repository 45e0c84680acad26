"""Are the bands of `ahnn.predict` calibrated on motion like the training data?

    python benchmarks/bench_predicted_bands.py RUN [RUN ...]

RUN is the folder of a run trained on simulated measurements. Its unseen trajectories are predicted from their
true starts, in the steps of the training. The output lists the fractions of their states within 1, 2 and 3
standard deviations; the ratio of these deviations to `run.band`, which ignores novelty, at the end of each
trajectory, median and maximum; and the fraction of novel states, with the largest novelty. For motion like
the training data the ratio is 1 and one state in a hundred is novel.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch
from omegaconf import OmegaConf

from ahnn import load
from ahnn.cli.parts import build_sensor, build_source
from ahnn.data import SplitData


def sentence(folder: Path) -> str:
    """Return a line on the calibration of the bands of a run."""
    run = load(folder)
    cfg = OmegaConf.create(run.config)
    source = build_source(cfg)
    truth = SplitData(source, list(cfg.data.split), build_sensor(cfg, source))["test"]
    every = max(1, round(run.dt / float(truth.times[0, 1] - truth.times[0, 0])))
    states, times = truth.states[:, ::every], truth.times[0, ::every]
    found = run.predict(states[:, 0], times)
    assert found.deviations is not None
    assert found.novelty is not None
    off, sd = (found.states - states)[:, 1:].abs(), found.deviations[:, 1:]
    shares = ", ".join(f"{100 * float((off <= k * sd).double().mean()):.3g}" for k in (1, 2, 3))
    wider = sd[:, -1] / run.band(states[:, 0], len(times) - 1)[:, -1]
    novel = 100 * float((found.novelty > 1).double().mean())
    return (
        f"{folder.name}: {len(states)} trajectories, {shares} %; {float(wider.median()):.3g} of the band, "
        f"at most {float(wider.max()):.3g}; {novel:.2g} % novel, at most {float(found.novelty.max()):.3g}"
    )


@torch.no_grad()
def main() -> None:
    """Print a line for each run."""
    kind = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=kind)
    parser.add_argument("runs", type=Path, nargs="+")
    for folder in parser.parse_args().runs:
        print(sentence(folder), flush=True)


if __name__ == "__main__":
    main()
