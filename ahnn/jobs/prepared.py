"""Between configuration and training: one value that says all that the training and its evaluation need."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from lightning import Trainer

from ahnn.data.datamodule import WindowDataModule
from ahnn.evaluation import EvaluationPlugin
from ahnn.models import AbstractModel
from ahnn.shooting.robust import RobustName


class Assessment(NamedTuple):
    """How the trained model is evaluated.

    Attributes:
        plugins: evaluations beside the open-loop one, by name.
        seed: of the perturbed starts.
        report: options of `ahnn.evaluation.publish`.
        searched: what a search varies, for TensorBoard's comparison of runs.
    """

    plugins: Mapping[str, EvaluationPlugin]
    seed: int
    report: Mapping[str, Any]
    searched: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class Prepared:
    """A training whose parts fit each other; nothing is generated or written yet.

    Attributes:
        label: name in tables.
        seed: of weights and batches.
        folder: of the run.
        config: content of its config.yaml.
        data: source, splits, sensor, and how batches are drawn.
        model: dynamics, objectives, optimiser and scheduler, and what its checkpoints say of it.
        trainer: epochs, devices, callbacks, loggers.
        checkpoint: to resume from; None begins.
        weights: a run, or a shipped model, whose weights a new training begins at.
        recorded: whether optimiser steps on a GPU may be recorded.
        robust: loss of single residuals of measurements.
        assessment: of the trained model.
    """

    label: str
    seed: int
    folder: Path
    config: bytes
    data: WindowDataModule
    model: AbstractModel
    trainer: Trainer
    checkpoint: Path | None
    weights: str | None
    recorded: bool
    robust: RobustName
    assessment: Assessment
