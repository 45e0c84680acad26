"""Reproduce the paper's tables: `python -m ahnn.reproduce system=mass_spring budget=laptop`.

MLP, NODE, HNN, AHNN3 and AHNN5 with the seeds 7, 201 and 719, each without and with the unscented Kalman
filter, from the true and from a perturbed start: 15 trainings of equally many steps, each in a folder of its
own, and a table. The same command goes on where it was stopped.

system=mass_spring        Table 1; system=molniya is Table 2
budget=smoke              does it run?  laptop: two cores; paper: a GPU
run=DIR                   of the runs; runs/reproduce/SYSTEM_BUDGET without it
experiment=paper_hnn,...  some of paper_mlp, paper_node, paper_hnn, paper_ahnn3, paper_ahnn5
seed=7                    some of the seeds
GROUP=OPTION KEY=VALUE    as of python -m ahnn.train, for all models: scaling=minmax, loss=recursive_state
hydra/launcher=joblib hydra.launcher.n_jobs=2     runs side by side
"""

from __future__ import annotations

if __name__ == "__main__":  # until `guard` listens, Ctrl-C ends this process without a traceback
    import signal

    signal.signal(signal.SIGINT, signal.SIG_DFL)

import logging
import math
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from ahnn.cli.entry import start
from ahnn.cli.guard import run_command
from ahnn.cli.importing import importing
from ahnn.cli.stops import ended

if TYPE_CHECKING:
    from omegaconf import DictConfig

log = logging.getLogger("ahnn")

USAGE = "usage: python -m ahnn.reproduce system=. budget=. [run=DIR] [GROUP=OPTION] [KEY=VALUE]"


def reproduce(arguments: list[str]) -> None:
    """Train and evaluate what is not finished yet, and show the table of all.

    Raises:
        UserError: a command that makes no reproduction, or a folder with another one.
    """
    from ahnn.reproduction import plan, require_same_settings

    os.environ["HYDRA_FULL_ERROR"] = "1"  # makes Hydra raise, so that the messages are ours
    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stderr)
    log.setLevel(logging.INFO)
    made = plan(arguments, USAGE)
    require_same_settings(made)
    with importing():
        from ahnn.evaluation.over_seeds import summary
        from ahnn.evaluation.terminal import show
    log.info(made.announcement())
    sys.argv[1:] = ["--multirun", *made.overrides]
    try:
        with ended(lambda: "the same command goes on where it was stopped"):
            start(one, "train")
    finally:  # one that failed leaves the others their table
        if made.finished():
            show(summary(made.folder, made.runs))


def one(cfg: DictConfig) -> float:
    """Train and evaluate one model with one seed, or what an interruption left of that.

    A run that is finished is kept, and one that another process works on is left to it.
    """
    from ahnn.cli.before import begin, require_new
    from ahnn.cli.training import train_once
    from ahnn.errors import Occupied
    from ahnn.files import claimed
    from ahnn.reproduction import is_finished

    folder = Path(cfg.folder)
    begin(cfg)
    try:
        with claimed(folder, ".turn"):
            if is_finished(folder, cfg):
                log.info("%s: finished", folder.name)
                return math.nan
            cfg.ckpt = "last" if (folder / "checkpoints" / "last.ckpt").exists() else None
            log.info("%s: %s", folder.name, "begins" if cfg.ckpt is None else "goes on")
            require_new(folder, cfg.ckpt)
            return train_once(cfg)
    except Occupied:
        log.info("%s: another process works on it", folder.name)
        return math.nan


def main() -> None:
    """Entry point of `python -m ahnn.reproduce` and `ahnn-reproduce`."""
    run_command(reproduce, __doc__)


if __name__ == "__main__":
    main()
