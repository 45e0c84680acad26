"""Output of scores and figures to TensorBoard."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, final

from ahnn.arguments import flatten
from ahnn.evaluation.case import Findings
from ahnn.evaluation.results import Results
from ahnn.evaluation.score_table import QUANTITIES
from ahnn.evaluation.sinks.base import TensorBoardLike
from ahnn.evaluation.sinks.figure_files import drawn
from ahnn.evaluation.titles import metric_name


@final
@dataclass(frozen=True)
class TensorBoardSink:
    """Writes hyper-parameters with the resulting scores, and figures.

    Scores have names without the model's label, so that runs of several models share a column.

    Attributes:
        logger: Lightning's TensorBoard logger, or a compatible one.
        settings: nested hyper-parameters in addition to system, model and its assumptions.
    """

    logger: TensorBoardLike
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __call__(self, results: Results, findings: Findings) -> None:
        """Write figures and the HPARAMS entry with the scores of all rows except floors."""
        self.logger.log_hyperparams(hyperparameters(results, self.settings), scores(results))
        for name, figure in findings.figures.items():
            self.logger.experiment.file_writer.add_summary(image(name, drawn(figure, ".png")), 0)
        self.logger.finalize("success")


def image(name: str, png: bytes) -> Any:
    """Return a TensorBoard image summary from the content of a PNG file."""
    from tensorboard.compat.proto.summary_pb2 import Summary  # pyright: ignore[reportAttributeAccessIssue]

    width, height = struct.unpack(">II", png[16:24])  # from its header
    shown = Summary.Image(encoded_image_string=png, width=width, height=height, colorspace=4)  # RGBA
    return Summary(value=[Summary.Value(tag=name, image=shown)])


def hyperparameters(results: Results, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings under dotted names, beginning with system, model and its assumptions."""
    about = {"system": results.space.name, "model": results.label, "assumes": results.assumes}
    return {**about, **{k: v for k, v in flatten(settings).items() if k not in about}}


def scores(results: Results) -> dict[str, float]:
    """Return the scores of all rows except floors, under names common to all runs."""
    found: dict[str, float] = {}
    loss = results.training.get("val_loss")
    if isinstance(loss, int | float):
        found["score/val_loss"] = float(loss)
    for row in results.rows:
        values = {q: getattr(row.scores, q) for q in QUANTITIES} if not row.who.floor else {}
        found |= {metric_name(row.who, q): value for q, value in values.items() if value is not None}
    return found
