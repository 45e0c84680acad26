"""The end of a training: last steps on measurements, what a run keeps of them, and whether it diverged."""

from __future__ import annotations

import logging
import time
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from ahnn.checkpoints import read_weights, replace_weights
from ahnn.data.datamodule import WindowDataModule
from ahnn.errors import TrainingError
from ahnn.evaluation.results import FILE, load_results
from ahnn.runs import made, weights_path
from ahnn.training import Shooting
from ahnn.training.laplace import conclude
from ahnn.training.visited import visited
from ahnn.uncertainty import find_domain, save_uncertainty

log = logging.getLogger(__name__)


def concluded(cfg: DictConfig, data: WindowDataModule) -> float:
    """Take the last steps, keep weights, uncertainty and where the training was, return the seconds."""
    folder, steps, robust = Path(cfg.folder), cfg.loss.closing, cfg.loss.robust
    started, best = time.monotonic(), weights_path(folder)
    dynamics = made(read_weights(best), folder).dynamics
    after = f" after at most {steps} last steps" if steps else ""
    log.info("what all measurements leave open%s: prior and covariance of the weights", after)
    train = data.whole("train")
    found = conclude(dynamics, train, data.whole("val"), steps, robust)
    if found is not None:
        learned, _ = found.taken(dynamics)
        loss = Shooting(None, robust).validation(learned, next(iter(data.val_dataloader())))["loss"]
        about: dict[str, Any] = {"val_loss": float(loss)}
        if len(states := visited(dynamics, train, robust)) > 1:
            about["domain"] = find_domain(dynamics, states).about()
        replace_weights(best, dynamics.state_dict(), about)
        save_uncertainty(folder, found, made(read_weights(best), folder).dynamics.state_dict())
    return time.monotonic() - started


def require_converged(folders: list[Path]) -> None:
    """Raise TrainingError where no prediction of a trained model stays finite; its results are kept."""
    for folder in folders:
        rows = load_results(folder).rows[:1] if (folder / FILE).exists() else ()
        if any(row.extra["lost"] == 1 for row in rows):
            message = (
                "training diverged: all predictions of unseen trajectories run to infinity; weights, results "
                f"and figures are kept in {folder}. Try a smaller optimizer.lr, or more epochs"
            )
            raise TrainingError(message)
