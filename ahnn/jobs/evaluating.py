"""Re-evaluation of a finished run in a separate folder, without building a training run."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ahnn.arguments import flatten
from ahnn.data import SplitData
from ahnn.data.splits import SAME
from ahnn.errors import UserError
from ahnn.evaluation import EvaluationPlugin, evaluation_folder, load_results, report
from ahnn.evaluation.make_case import make_case
from ahnn.evaluation.sinks.board import EventBoard
from ahnn.loading import weights_path
from ahnn.runs import Run
from ahnn.shooting.robust import ROBUST, RobustName

log = logging.getLogger("ahnn")


@dataclass(frozen=True, kw_only=True)
class Reevaluation:
    """Run to evaluate again, with data and options.

    Attributes:
        run: run with the weights to evaluate.
        ckpt: selection of the weights: `best`, `last`, or a path.
        folder: run folder, which contains its evaluations.
        name: name of the new evaluation; None for date and time.
        label: name in tables.
        splits: data splits.
        plugins: additional evaluations by name.
        seed: random seed for perturbed starts.
        report: options of `ahnn.evaluation.publish`.
    """

    run: Run
    ckpt: str
    folder: Path
    name: str | None
    label: str
    splits: SplitData
    plugins: Mapping[str, EvaluationPlugin]
    seed: int
    report: Mapping[str, Any]


def evaluate(asked: Reevaluation) -> None:
    """Evaluate the weights of a run and write the results to a separate folder."""
    run, splits = asked.run, asked.splits
    robust = robust_of(run)
    note = splits.beside(run.about.get("data"), run.about.get("seen") or ())
    remark = "" if note == SAME else f"test data: {note}"
    training = load_results(run.folder).training if (run.folder / "metrics.json").exists() else {}
    learned = {"uncertainty": run.uncertainty, "domain": run.domain, "robust": robust}
    named = {"label": asked.label, "seed": asked.seed, "remark": remark, "about": run.about}
    if remark:
        log.warning(remark)
    last = asked.ckpt == "best" and weights_path(run.folder).stem == "last"
    about = {"ckpt": "last" if last else asked.ckpt, "data": note}
    known: dict[str, Any] = {**training, "val_loss": run.about.get("val_loss"), **about}
    with evaluation_folder(asked.folder, asked.name) as folder:
        case = make_case(run.dynamics, splits, folder=folder, **named, **learned)
        name, count = case.space.name, len(case.test.states)
        log.info("evaluating %s on %d trajectories of %s", asked.label, count, name)
        boards = [(EventBoard(folder), about)] if asked.report["figures"] else []
        report(case, asked.plugins, known, boards=boards, **asked.report)


def robust_of(run: Run) -> RobustName:
    """Return the robust loss of a run from the metadata of its weights.

    Raises:
        UserError: unknown loss.
    """
    name = flatten(run.about).get("settings.loss.robust", "none")
    if name not in [*ROBUST]:
        message = f"loss.robust: expected one of {', '.join(ROBUST)}; received {name!r}"
        raise UserError(message)
    return name
