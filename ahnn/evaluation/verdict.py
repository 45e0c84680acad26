"""Verdict on a trained model: whether it is good, why, and a remedy, in at most five findings."""

from __future__ import annotations

from collections.abc import Sequence

from ahnn.evaluation.baselines import Worth

LINES = 5
"""Maximum number of findings in a verdict; more are in the notes."""
GRADES = {"good": 0.01, "fair": 0.1}
"""Maximum relative error for each grade, without measurement noise."""


BELOW = ("worse than a linear map",)
ADVICE = "Train longer, or use another model"
"""Default remedy for a worthless model."""


def verdict(
    worth: Worth, faults: Sequence[str], others: Sequence[str], *, noisy: bool, caveat: str = ""
) -> list[str]:
    """Return the findings that decide whether a model is useful.

    Args:
        worth: comparison of its prediction with the baselines.
        faults: findings that need a remedy, the most severe first.
        others: findings on its standard deviations, and findings of plugins.
        noisy: whether the error includes measurement noise, which is no fault of the model.
        caveat: reason why the training cannot have produced a good model; "" without one. A good model
            disproves it.
    """
    head = worth.sentence()
    if not (worth.worthless or worth.below_linear or faults) and grade(worth, noisy=noisy) == "good":
        caveat = ""
    if not worth.worthless:
        words = ["not good"] if faults else [] if worth.below_linear else [grade(worth, noisy=noisy)]
        head = f"{', '.join([*words, *BELOW * worth.below_linear])}: {head}"
    elif not faults and not caveat:
        head = f"{head}. {ADVICE}"
    found = [head, *filter(None, [caveat]), *faults, *others]
    if len(found) <= LINES:
        return found
    return [*found[: LINES - 1], f"{len(found) - LINES + 1} more findings: evaluation.detail=true shows them"]


def grade(worth: Worth, *, noisy: bool) -> str:
    """Return the grade of a model that is better than the baselines."""
    if worth.at_floor or noisy:
        return "good"
    return next((grade for grade, error in GRADES.items() if worth.model <= error), "poor")
