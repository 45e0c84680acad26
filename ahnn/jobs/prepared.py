"""Prepared training run: one value with all inputs of training and evaluation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lightning import Trainer

from ahnn.data.datamodule import WindowDataModule
from ahnn.evaluation import EvaluationPlugin
from ahnn.models import AbstractModel
from ahnn.shooting.robust import RobustName


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
        plugins: additional evaluations by name.
        evaluation_seed: random seed for perturbed starts.
        report: options of `ahnn.evaluation.publish`.
        searched: keys varied by a search, for TensorBoard's comparison of runs.
        caveat: reason why the training cannot produce a good model; "" without one.
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
    plugins: Mapping[str, EvaluationPlugin]
    evaluation_seed: int
    report: Mapping[str, Any]
    searched: Mapping[str, Any]
    caveat: str = ""
    members: Sequence[Prepared] = ()
