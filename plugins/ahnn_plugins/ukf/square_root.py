"""Square-root form: covariances are represented by triangular factors only.

The form follows van der Merwe & Wan 2001, with two changes for numerical robustness: the negative centre
weight is absorbed into the deviations (`SigmaWeights`), and the update triangularises state and measurement
together, as in array filters (Kailath, Sayed & Hassibi 2000, chapter 12), instead of downdating column by
column.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.estimation.belief import Belief
from ahnn.estimation.conditioning import conditioned, present_noise
from ahnn.estimation.linalg import downdate, tria
from ahnn.estimation.results import Predicted, Updated
from ahnn_plugins.ukf import members
from ahnn_plugins.ukf.parameters import Form, Residual, SigmaWeights


def predict(propagated: Tensor, weights: SigmaWeights, chol_q: Tensor) -> Predicted:
    """Return the belief with the moments of the propagated sigma points, plus Q.

    Args:
        propagated: (B, S, D) sigma points after the flow.
        weights: sigma point weights.
        chol_q: (B, D, D) lower factor of the process noise.
    """
    if members.apply_to(weights, propagated, chol_q):
        return members.predict(propagated, weights, chol_q)
    centre = propagated[:, :1]
    outer = propagated[:, 1:] - centre
    shift = weights.outer * outer.sum(1, keepdim=True)
    deviations = weights.outer.sqrt() * (outer - weights.recentring * shift)
    chol = tria(torch.cat((deviations, chol_q.mT), dim=1))
    chol, repaired = _lowered(chol, shift[:, 0], weights)
    return Predicted(Belief((centre + shift)[:, 0], chol), repaired)


def update(
    prior: Belief, images: Tensor, y: Tensor, residual: Residual, weights: SigmaWeights, chol_r: Tensor
) -> Updated:
    """Return the posterior given the components of y that are not NaN.

    A missing component has deviation zero and variance one, hence no correlation: the result is the same as
    without the component, and the batch stays rectangular.

    Args:
        prior: belief from which the points were drawn.
        images: (B, S, M) sigma points through the measurement model.
        y: (B, M), NaN where missing.
        residual: difference of two measurements.
        weights: sigma point weights.
        chol_r: (B, M, M) lower factor of the measurement noise.
    """
    if members.apply_to(weights, prior.mean, prior.chol, images, y, chol_r):
        return members.update(prior, images, y, residual, weights, chol_r)
    present = ~torch.isnan(y)
    column, complete = present.unsqueeze(1), bool(present.all())
    outer = residual(images[:, 1:], images[:, :1])
    if not complete:
        outer = torch.where(column, outer, 0.0)
    shift = weights.outer * outer.sum(1, keepdim=True)
    y_pred = images[:, 0] + shift[:, 0]
    # Missing components are filled in: a residual may mix components, and NaN would invalidate its gradient.
    innovation = residual(y if complete else torch.where(present, y, y_pred), y_pred)
    if not complete:
        innovation = torch.where(present, innovation, 0.0)
    joint, repaired = joint_factor(outer, shift, prior.chol, weights, present_noise(chol_r, present))
    return conditioned(prior, joint, innovation, y, repaired)


def read(prior: Belief, y: Tensor, weights: SigmaWeights, chol_r: Tensor) -> Updated | None:
    """Return the posterior given a measurement of the first state components, without sigma points.

    Args:
        prior: prior belief.
        y: (B, M), NaN where missing.
        weights: weights of the sigma points that `update` would use.
        chol_r: (B, M, M) lower factor of the measurement noise.

    Returns:
        None if the library does not support the update.
    """
    if weights.crowding is not None or y.shape[-1] > prior.mean.shape[-1]:
        return None
    if not members.apply_to(weights, *prior, y, chol_r):
        return None
    return members.read(prior, y, chol_r)


def joint_factor(
    outer: Tensor, shift: Tensor, chol: Tensor, weights: SigmaWeights, noise_rows: Tensor
) -> tuple[Tensor, Tensor | None]:
    """Return the lower factor (B, N + D, N + D) of the joint covariance of an image and the state.

    Its blocks are [[chol_z, 0], [cross, chol_given]]: chol_z factors the covariance of the image z,
    cross chol_zᵀ is the covariance of state and image, and chol_given factors the covariance of the state
    given the image. Sums and differences of opposite points keep the state block exactly `chol`.

    Args:
        outer: (B, 2 D, N) deviations of the images of the outer points from the image of the centre.
        shift: (B, 1, N) mean of the image minus the image of the centre.
        chol: (B, D, D) lower factor of the state from which the points were drawn.
        weights: sigma point weights.
        noise_rows: (B, K, N); the noise covariance is noise_rowsᵀ noise_rows.

    Returns:
        The factor, and repaired members, (B,) bool, or None.
    """
    deviations = outer - weights.recentring * shift
    plus, minus = (deviations * (0.5 * weights.outer).sqrt()).chunk(2, dim=1)
    image = torch.cat((plus - minus, plus + minus, noise_rows), dim=1)
    state = torch.nn.functional.pad(chol.mT, (0, 0, 0, image.shape[1] - chol.shape[1]))
    joint = tria(torch.cat((image, state), dim=-1))
    return _lowered(joint, torch.nn.functional.pad(shift[:, 0], (0, chol.shape[-1])), weights)


def _lowered(chol: Tensor, shift: Tensor, weights: SigmaWeights) -> tuple[Tensor, Tensor | None]:
    """Subtract the remaining negative term; if this is impossible, omit the term and report a repair.

    If a variance would not be positive, the factor is zero and no repair is reported, as in the standard
    form.
    """
    if weights.downdate is None:
        return chol, None
    needed = (weights.downdate > 0.0).flatten()
    lowered, possible = downdate(chol, weights.downdate.sqrt().squeeze(-1) * shift)
    chol = torch.where(needed[:, None, None], lowered, chol)
    impossible = needed & ~possible
    if not bool(impossible.any()):
        return chol, impossible
    variance = chol.square().sum(-1) - weights.downdate.squeeze(-1) * shift.square()
    lost = impossible & (variance <= 0.0).any(-1)
    return torch.where(lost[:, None, None], 0.0, chol), impossible & (variance > 0.0).all(-1)


SQUARE_ROOT = Form("square-root", predict, update, squares=False, read=read)
