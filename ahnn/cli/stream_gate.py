"""Gate of a stream, which is on by default and reopens after consecutive rejections."""

from __future__ import annotations

from typing import Any, Literal, cast

from ahnn.errors import UserError
from ahnn.estimation import Estimator, Gate, RecursiveEstimator

GATE = 0.999999
"""Default gate of a stream: one in a million valid measurements is rejected."""
AskedGate = float | Literal["none"] | None


def with_gate(
    estimator: RecursiveEstimator[Any], plugin: object, asked: AskedGate
) -> RecursiveEstimator[Any]:
    """Return an estimator with a gate that reopens; one that supports no gate is returned unchanged.

    Args:
        estimator: estimator of the plugin, with a gate if configured.
        plugin: plugin that sets the number of rejections after which the gate reopens.
        asked: gate of the stream; None: the gate of the estimator, or the default.

    Raises:
        UserError: a gate for an estimator that supports none.
    """
    if not hasattr(estimator, "gated"):
        if asked is not None:
            message = f"gate: expected null, as {type(estimator).__name__} has no gate; received {asked}"
            raise UserError(message)
        return estimator
    patience = getattr(plugin, "patience", Gate().patience)
    own = getattr(estimator, "gate", None) or Gate(GATE, patience)
    chosen = None if asked == "none" else own if asked is None else Gate(asked, patience)
    return cast("Estimator[Any]", estimator).gated(chosen and chosen._replace(reopens=True))
