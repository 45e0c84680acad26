"""Names of result rows for readers and TensorBoard, derived from their identity."""

from __future__ import annotations

from ahnn.evaluation.case import Who

MODEL = "model"
"""Process name in the rows of the trained model."""
TEXTBOOK = "two bodies and J2"
"""Process name in the rows of textbook physics for recorded orbits."""

SPANS = {"whole": "", "settled": "settled"}


TITLES = {"enkf": "EnKF", "particle": "particle filter"}
"""Estimator names that are not acronyms."""


def title(who: Who, label: str) -> str:
    """Return the name of the predictor, for example `ahnn5`, `exact flow + UKF` or `ahnn5 + UKF tuned`.

    Args:
        who: identity of a row.
        label: name of the model.
    """
    process = label if who.process == MODEL else who.process
    return process if who.estimator is None else f"{process} + {estimator_title(who.estimator)}"


def estimator_title(estimator: str) -> str:
    """Return the name of an estimator for readers: `ukf_tuned` is `UKF tuned`."""
    first, *rest = estimator.split("_")
    return " ".join((TITLES.get(first, first.upper() if len(first) <= 4 else first), *rest))


def described(who: Who, label: str) -> str:
    """Describe the predictor, its start and span."""
    parts = title(who, label), f"{who.start} start", SPANS[who.span]
    return ", ".join(part for part in parts if part)


def metric_name(who: Who, quantity: str) -> str:
    """Return the name of a score in TensorBoard, without the model's label, so that runs are comparable.

    The default case has the shortest name: `score/position` is the score of the model from the true start
    without measurements, `score/position/ukf/perturbed/settled` that of a filter.
    """
    process = None if who.process == MODEL else who.process.replace(", ", "_").replace(" ", "_")
    start = None if who.start == "true" else who.start
    span = None if who.span == "whole" else who.span
    return "/".join(part for part in ("score", quantity, process, who.estimator, start, span) if part)
