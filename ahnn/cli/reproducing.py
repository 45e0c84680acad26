"""Task of `python -m ahnn.reproduce`: runs of a plan; finished ones are skipped, unfinished ones resumed."""

from __future__ import annotations

import logging
import math
import os
import sys
from pathlib import Path

from omegaconf import DictConfig

from ahnn.cli.early_stops import ended
from ahnn.cli.entry import start
from ahnn.cli.importing import importing
from ahnn.cli.preflight import begin, require_new
from ahnn.cli.reproduction_plan import is_finished, plan, require_same_settings
from ahnn.cli.training import train_once
from ahnn.errors import Occupied
from ahnn.files import claimed

log = logging.getLogger("ahnn")


def reproduce(arguments: list[str]) -> None:
    """Train and evaluate unfinished runs, and show the complete table.

    Raises:
        UserError: an invalid command, or a folder with another reproduction.
    """
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra then raises, so that we show the message
    made = plan(arguments)
    require_same_settings(made)
    with importing():
        from ahnn.evaluation.seed_summary import summary
        from ahnn.evaluation.terminal import show
    log.info(made.announcement())
    sys.argv[1:] = ["--multirun", *made.overrides]
    try:
        with ended(lambda: "repeat the command to resume"):
            start(one)
    finally:  # after a failure, the table of the finished runs is still shown
        if made.finished():
            show(summary(made.folder, made.runs))


def one(cfg: DictConfig) -> float:
    """Train and evaluate one model with one seed, resuming after an interruption.

    Finished runs are kept, and runs locked by another process are skipped.
    """
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
        log.info("%s: in use by another process", folder.name)
        return math.nan
