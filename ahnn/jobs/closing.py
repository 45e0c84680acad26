"""Closing stage of training: final steps on measurements, saved results, and evaluation."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from lightning.pytorch.loggers import TensorBoardLogger

from ahnn.checkpoints import as_stored, checksum, read_weights, replace_weights
from ahnn.data.loader import CPU
from ahnn.errors import TrainingError
from ahnn.evaluation import report
from ahnn.evaluation.case import Case
from ahnn.evaluation.make_case import make_case
from ahnn.evaluation.results import FILE, load_results
from ahnn.evaluation.run import band_tests
from ahnn.jobs.prepared import Prepared
from ahnn.loading import Run, load, made, weights_path
from ahnn.measurements import UnknownNoise
from ahnn.progress import stage
from ahnn.training import Shooting
from ahnn.training.closing_journal import ClosingJournal
from ahnn.training.estimated_noise import conclude_with_noise
from ahnn.training.fitted_paths import fitted_states
from ahnn.uncertainty import find_domain, save_uncertainty

log = logging.getLogger("ahnn")


def conclude_on_measurements(prepared: Prepared) -> float:
    """Take the final steps, save weights, uncertainty and training domain, and return the time in seconds.

    A call after an interruption continues from the journal; a call after completion does nothing.
    """
    started, best = time.monotonic(), weights_path(prepared.folder)
    if is_concluded(prepared):
        return 0.0
    journal = ClosingJournal(best.parent / "closing", checksum(read_weights(best).state, ""))
    steps = prepared.model.curriculum.closing
    after = f" after at most {steps} closing steps" if steps else ""
    log.info("closing stage on all measurements: computes the prior and covariance of the weights%s", after)
    with stage("closing stage"), journal.active():
        _conclude(prepared, best, steps)
    journal.remove()
    return time.monotonic() - started


def is_concluded(prepared: Prepared) -> bool:
    """Return whether the closing stage is complete or not needed."""
    best = weights_path(prepared.folder)
    if prepared.data.stages is None:
        return True
    return best.exists() and bool(read_weights(best).about.get("concluded"))


def _conclude(prepared: Prepared, best: Path, steps: int) -> None:
    folder, data, robust = prepared.folder, prepared.data, prepared.robust
    dynamics = made(read_weights(best), folder).dynamics
    train = data.whole("train")
    unknown = UnknownNoise() if data.sensor is None else data.sensor.unknown
    found, noise = conclude_with_noise(dynamics, train, data.whole("val"), steps, robust, unknown)
    reached = {"loss": read_weights(best).about.get("val_loss"), "epochs": prepared.trainer.max_epochs}
    about: dict[str, Any] = {"concluded": True, "trained": reached}
    if found is not None:
        learned, _ = found.taken(dynamics)
        batch = next(iter(data.val_dataloader())).to(CPU)
        if noise is not None:
            about["noise"] = noise.about()
            seen = noise.applied(train.instrument, unknown)
            train, batch = (part._replace(instrument=seen) for part in (train, batch))
        about["val_loss"] = float(Shooting(None, robust).validation(learned, batch)["loss"])
        if len(states := fitted_states(dynamics, train, robust)) > 1:
            about["domain"] = find_domain(dynamics, states).about()
        # Saved before the weights, which refer to it.
        save_uncertainty(folder, found, as_stored(dynamics.state_dict(), best))
    replace_weights(best, {} if found is None else dynamics.state_dict(), about)


def judge(prepared: Prepared, seconds: float, steps: int | None = None) -> float:
    """Evaluate the best weights of a run, write and show the results, and return the validation loss.

    Args:
        prepared: prepared training run.
        seconds: duration of the training steps.
        steps: number of training steps; None for that of the trainer.
    """
    folder, data, trainer = prepared.folder, prepared.data, prepared.trainer
    if data.stages is not None:
        seconds += conclude_on_measurements(prepared)
    run = load(folder)
    case = case_of(prepared, run)
    loss = math.nan if (found := run.about.get("val_loss")) is None else float(found)
    training = {
        "seed": prepared.seed,
        "seconds": round(seconds, 1),
        "window": data.window,
        "steps": trainer.global_step if steps is None else steps,
        "parameters": sum(p.numel() for p in prepared.model.parameters()),
        "val_loss": loss,
    }
    loggers = [logger for logger in trainer.loggers if isinstance(logger, TensorBoardLogger)]
    boards = [(logger, prepared.searched) for logger in loggers]
    report(case, prepared.plugins, training, boards=boards, **prepared.report)
    if boards:
        log.info("TensorBoard: tensorboard --logdir %s", folder)
    return loss


def judge_members(prepared: Prepared, seconds: float) -> float:
    """Evaluate the best weights of each member, and return the mean of the validation losses.

    Args:
        prepared: prepared ensemble.
        seconds: duration of the steps of all members.
    """
    each, steps = seconds / len(prepared.members), prepared.trainer.global_step
    losses = [judge(member, each, steps) for member in prepared.members]
    return sum(losses) / len(losses)


def case_of(prepared: Prepared, run: Run) -> Case:
    """Return the evaluation case of a training run."""
    named = {"label": prepared.label, "seed": prepared.evaluation_seed, "folder": prepared.folder}
    learned: dict[str, Any] = {"uncertainty": run.uncertainty, "domain": run.domain, "about": run.about}
    learned |= {"robust": prepared.robust, "caveat": prepared.caveat}
    return make_case(run.dynamics, prepared.data.splits, **learned, **named)


def bands_of(prepared: Prepared, fitted: float, samples: int) -> dict[str, Any]:
    """Take the final steps, and return the tests of bands and forecasts by name, without other scores.

    Args:
        prepared: training run after its steps.
        fitted: fraction of the measurements of an unseen trajectory to which its start is fitted.
        samples: number of sampled paths of each forecast; 0: none.
    """
    conclude_on_measurements(prepared)
    return band_tests(case_of(prepared, load(prepared.folder)), fitted, samples)


def require_converged(folders: Iterable[Path]) -> None:
    """Raise TrainingError if no prediction of a trained model stays finite; the results are kept."""
    for folder in folders:
        rows = load_results(folder).rows[:1] if (folder / FILE).exists() else ()
        if any(row.extra["lost"] == 1 for row in rows):
            message = (
                "training diverged: all predictions of unseen trajectories run to infinity; weights, results "
                f"and figures are kept in {folder}. Try a smaller optimizer.lr, or more epochs"
            )
            raise TrainingError(message)
