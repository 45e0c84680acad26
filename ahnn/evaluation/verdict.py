"""Plain verdict on a trained model: good or not, why, and a remedy, in at most five findings."""

from __future__ import annotations

from collections.abc import Sequence

from ahnn.evaluation.baselines import Worth

LINES = 5
"""Findings of a verdict, at most; the others are in the notes."""
GRADES = {"good": 0.01, "fair": 0.1}
"""Largest relative errors of a grade, where no noise of measurements is part of them."""


def verdict(worth: Worth, faults: Sequence[str], others: Sequence[str], *, noisy: bool) -> list[str]:
    """Return the findings that decide whether a model is of use.

    Args:
        worth: of its prediction.
        faults: findings that ask for a remedy, the most severe first.
        others: findings on its standard deviations, and of plugins.
        noisy: whether the error includes the noise of measurements, which is no fault of the model.
    """
    head = worth.sentence()
    if not worth.worthless:
        grade = next((grade for grade, error in GRADES.items() if worth.model <= error), "poor")
        head = f"{'not good' if faults else 'good' if noisy else grade}: {head}"
    found = [head, *faults, *others]
    if len(found) <= LINES:
        return found
    return [*found[: LINES - 1], f"{len(found) - LINES + 1} more findings: evaluation.detail=true shows them"]
