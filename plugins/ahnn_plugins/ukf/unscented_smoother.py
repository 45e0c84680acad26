"""Backward distributions of the unscented Rauch-Tung-Striebel smoother (Särkkä 2008), in square-root form."""

from __future__ import annotations

from torch import Tensor

from ahnn.estimation.results import Backward
from ahnn.estimation.smoother import backward_law, smoother
from ahnn_plugins.ukf.parameters import SigmaWeights
from ahnn_plugins.ukf.square_root import joint_factor

unscented_smoother = smoother
"""Smoother that composes these laws, common to all filters."""


def backward_kernel(
    propagated: Tensor, chol: Tensor, weights: SigmaWeights, chol_q: Tensor
) -> tuple[Backward, Tensor | None]:
    """Return the distribution of the state before a step given the state after it, see `backward_law`.

    Args:
        propagated: (B, S, D) sigma points after the flow.
        chol: (B, D, D) factor from which the points were drawn.
        weights: sigma point weights.
        chol_q: (B, D, D) factor of the process noise.

    Returns:
        The distribution, and members with a repair or a singular covariance, (B,) bool, or None.
    """
    outer = propagated[:, 1:] - propagated[:, :1]
    shift = weights.outer * outer.sum(1, keepdim=True)
    joint, repaired = joint_factor(outer, shift, chol, weights, chol_q.mT)
    law, singular = backward_law(joint)
    if singular is not None:
        repaired = singular if repaired is None else singular | repaired
    return law, repaired
