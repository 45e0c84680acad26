"""Output of scores and figures to TensorBoard."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ahnn.arguments import flatten
from ahnn.evaluation.results import Results
from ahnn.evaluation.score_table import QUANTITIES
from ahnn.evaluation.sinks.figure_files import drawn
from ahnn.evaluation.titles import metric_name

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def log_scores(
    logger: Any, settings: Mapping[str, Any], results: Results, figures: Mapping[str, Figure]
) -> None:
    """Write figures and the HPARAMS entry with the scores of all rows except floors.

    Scores have names without the model's label, so that runs of several models share a column.

    Args:
        logger: Lightning's TensorBoard logger, or an `EventBoard`, which shows the methods needed.
        settings: nested hyper-parameters in addition to system, model and its assumptions.
        results: results with the scores.
        figures: figures by name.
    """
    logger.log_hyperparams(hyperparameters(results, settings), scores(results))
    for name, figure in figures.items():
        logger.experiment.file_writer.add_summary(image(name, drawn(figure, ".png")), 0)
    logger.finalize("success")


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
