"""Prepared training run: one value with all inputs of training and evaluation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from lightning import Trainer

from ahnn.data.datamodule import WindowDataModule
from ahnn.evaluation import EvaluationPlugin
from ahnn.models import AbstractModel
from ahnn.shooting.robust import RobustName


class Assessment(NamedTuple):
    """Options of the evaluation after training.

    Attributes:
        plugins: additional evaluations by name.
        seed: random seed for perturbed starts.
        report: options of `ahnn.evaluation.publish`.
        searched: keys varied by a search, for TensorBoard's comparison of runs.
        caveat: reason why the training cannot produce a good model; "" without one.
    """

    plugins: Mapping[str, EvaluationPlugin]
    seed: int
    report: Mapping[str, Any]
    searched: Mapping[str, Any]
    caveat: str = ""


@dataclass(frozen=True, kw_only=True)
class Prepared:
    """Training run with compatible parts, before anything is generated or written.

    Attributes:
        label: name in tables.
        seed: random seed for weights and batches.
        folder: run folder.
        config: content of the folder's config.yaml.
        data: source, splits, sensor, and batch sampling.
        model: dynamics, objectives, optimiser and scheduler, and checkpoint metadata; an `EnsembleModel` for
            members.
        trainer: epochs, devices, callbacks, loggers.
        checkpoint: checkpoint to resume from; None for a new run.
        weights: run or shipped model that provides initial weights.
        recorded: whether optimiser steps on a GPU may be recorded as CUDA graphs.
        robust: robust loss of measurement residuals.
        assessment: evaluation options of the trained model.
        members: runs that are trained together as this one, and evaluated each by itself; none for one model.
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
    members: Sequence[Prepared] = ()
