"""The end of a run: best weights, evaluation, files, TensorBoard, table."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from lightning.pytorch.loggers import Logger, TensorBoardLogger

from ahnn.checkpoints import flatten, require_same
from ahnn.data import WindowDataModule
from ahnn.errors import UserError
from ahnn.evaluation.case import EvaluationPlugin, Findings
from ahnn.evaluation.run import evaluate, make_case, write_findings
from ahnn.evaluation.table import results_table, show
from ahnn.models import AbstractDynamics
from ahnn.pretrained import best_weights

log = logging.getLogger(__name__)


def finish(
    model: AbstractDynamics,
    data: WindowDataModule,
    plugins: Mapping[str, EvaluationPlugin],
    about: dict[str, Any],
    *,
    loggers: Iterable[Logger],
    label: str,
    folder: Path,
    seed: int,
    save_predictions: bool,
    figures: bool = True,
    settings: Mapping[str, Any] | None = None,
) -> float:
    """Evaluate the best weights of a run and return their validation loss.

    Args:
        model: the module that was trained.
        data: its data.
        plugins: evaluations to run after the open-loop one.
        about: numbers on the training, for metrics.json.
        loggers: of the training; figures and scores go to TensorBoard.
        label: name in tables.
        folder: the run directory, with its best weights.
        seed: of the perturbed starts.
        save_predictions: whether to keep the predicted trajectories.
        figures: whether to draw; the trials of a search are told apart by numbers.
        settings: of the training, nested plain values, beside those of the model in TensorBoard.

    Raises:
        UserError: the weights are damaged, or of a model with other arguments.
    """
    loss = restore(model, folder)
    about["assumes"] = assumptions(model)
    about["val_loss"] = loss = float(about.get("val_loss", "nan")) if loss is None else loss
    case = make_case(model, data, label, seed, folder)
    findings = evaluate(case, plugins, figures=figures)
    write_findings(findings, case, about, save_predictions=save_predictions)
    for logger in loggers:
        if isinstance(logger, TensorBoardLogger):
            publish(logger, {**model.hparams, **(settings or {})}, findings, about)
    title = f"{label} on {data.system.name}: {about['assumes']}"
    show(results_table(title, findings.rows, data.system))
    log.info("run folder: %s", folder)
    log.info("TensorBoard: tensorboard --logdir %s", folder)
    return loss


def assumptions(model: AbstractDynamics) -> str:
    """Return what a model takes as known of the dynamics; scores mean little without it."""
    if "hamiltonian" not in model.hparams:
        return "no Hamiltonian"
    return f"{model.hparams['hamiltonian']} Hamiltonian, {model.hparams['inputs']} inputs"


def restore(model: AbstractDynamics, folder: Path) -> float | None:
    """Give a model the best weights of a run and return their validation loss, where it is known.

    Raises:
        UserError: the weights are damaged, or of a model with other arguments.
    """
    best = best_weights(folder)
    asked = {key: value for key, value in model.hparams.items() if key in best.model}
    require_same(f"run {folder}", {"model": asked}, {"model": best.model})
    try:
        model.load_state_dict(best.state)
    except RuntimeError as error:
        reason = " ".join(str(error).split())
        message = f"run {folder}: expected the weights of its model; received others ({reason})"
        raise UserError(message) from error
    return best.loss


def publish(
    logger: TensorBoardLogger, settings: dict[str, Any], findings: Findings, about: dict[str, Any]
) -> None:
    """Write hyper-parameters with their scores, numbers of plugins, and the figures, into TensorBoard."""
    scores = {"hp/val_loss": about["val_loss"]}
    for row in findings.rows:
        if not row.floor:
            scores[f"hp/{row.name}_{row.start}_position"] = row.scores.position
            scores[f"hp/{row.name}_{row.start}_velocity"] = row.scores.velocity
    logger.log_hyperparams(flatten(settings), scores)
    numbers = flatten(findings.numbers)
    logger.log_metrics({key: float(v) for key, v in numbers.items() if isinstance(v, int | float)})
    for name, figure in findings.figures.items():
        logger.experiment.add_figure(name, figure, close=False)
    logger.finalize("success")
