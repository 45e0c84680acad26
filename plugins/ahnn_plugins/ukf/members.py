"""Square-root form in C, batched over members, with the same results as in torch, up to rounding.

This form is used on the CPU without gradients. Between two calls of the flow, torch executes about a hundred
small operations dominated by overhead; this form executes three or four.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

import torch
from torch import Tensor

from ahnn.compiled_libraries import CompiledFlow, followed, plain
from ahnn.estimation.belief import Belief
from ahnn.estimation.results import Predicted, Updated
from ahnn_plugins.ukf.library import library
from ahnn_plugins.ukf.parameters import Residual, SigmaWeights

SOUND, UNSOUND, NO_MEMORY = 0, 1, 2
"""Return codes of the library's functions."""


def apply_to(weights: SigmaWeights, *tensors: Tensor) -> bool:
    """Return whether the library supports tensors: plain float64 on the CPU, without derivatives."""
    if weights.downdate is not None or followed():
        return False
    graph, given = torch.is_grad_enabled(), (*tensors, weights.outer)
    known = all(plain(t, torch.float64) and not (graph and t.requires_grad) for t in given)
    return known and library() is not None


def draw(belief: Belief, weights: SigmaWeights) -> Tensor:
    """Return the sigma points (B, 2 D + 1, D), see `sigma_points.draw`."""
    mean, (chol, step) = belief.mean.contiguous(), _members(belief.chol)
    batch, size = mean.shape
    points = mean.new_empty(batch, 2 * size + 1, size)
    radius, weight_step = weights.radius, _step(weights.radius)
    _call("ahnn_draw", batch, size, mean, chol, step, radius, weight_step, points)
    return points


def predict(propagated: Tensor, weights: SigmaWeights, chol_q: Tensor) -> Predicted:
    """Return the predicted belief, see `square_root.predict`."""
    points, (q, step) = propagated.contiguous(), _members(chol_q)
    batch, _, size = points.shape
    mean, chol = points.new_empty(batch, size), points.new_empty(batch, size, size)
    outer, recentring = weights.outer, weights.recentring
    sound = _call("ahnn_predict", batch, size, points, outer, recentring, _step(outer), q, step, mean, chol)
    return Predicted(Belief(mean, chol), None, sound)


def update(
    prior: Belief, images: Tensor, y: Tensor, residual: Residual, weights: SigmaWeights, chol_r: Tensor
) -> Updated:
    """Return the posterior, see `square_root.update`."""
    y, present = y.contiguous(), ~torch.isnan(y)
    complete = bool(present.all())
    (batch, size), width = prior.mean.shape, y.shape[-1]
    outer = residual(images[:, 1:], images[:, :1]).to(y.dtype).contiguous()
    (chol, step), (noise, noise_step) = _members(prior.chol), _members(chol_r)
    shift, joint = y.new_empty(batch, width), y.new_empty(batch, width + size, width + size)
    shapes, own = (batch, size, width), (weights.outer, weights.recentring, _step(weights.outer))
    _call("ahnn_joint", *shapes, outer, y, complete, chol, step, *own, noise, noise_step, shift, joint)
    y_pred = images[:, 0] + shift
    # Missing components are filled in, since a residual may mix components.
    difference = residual(y if complete else torch.where(present, y, y_pred), y_pred)
    innovation = torch.empty_like(y).copy_(difference)
    results = _results(prior, innovation)
    given = joint, y, prior.mean.contiguous(), noise, noise_step
    return _updated(_call("ahnn_condition", *shapes, *given, *results), results)


def read(prior: Belief, y: Tensor, chol_r: Tensor) -> Updated:
    """Return the posterior given a row y (B, M) of the first M state components, NaN where missing."""
    y, mean = y.contiguous(), prior.mean.contiguous()
    (chol, step), (noise, noise_step) = _members(prior.chol), _members(chol_r)
    results = _results(prior, torch.empty_like(y))
    shapes = (*mean.shape, y.shape[-1])
    return _updated(_call("ahnn_read", *shapes, y, mean, chol, step, noise, noise_step, *results), results)


def results(steps: int, width: int, points: Tensor) -> tuple[Tensor, ...]:
    """Allocate memory for S steps of members with points (B, 2 D + 1, D), and rows of M components.

    Returns:
        Means and factors of the predictions, innovations, means and factors of the posteriors, deviations,
        NIS, log-likelihoods and flags of singular members, each (S, B, ...).
    """
    (batch, _, size), new = points.shape, points.new_empty
    vector, matrix = (steps, batch, size), (steps, batch, size, size)
    row, one = (steps, batch, width), (steps, batch)
    floats = tuple(new(shape) for shape in (vector, matrix, row, vector, matrix, row, one, one))
    return *floats, new(one, dtype=torch.bool)


def follow(
    flow: CompiledFlow,
    lengths: Tensor,
    measured: Sequence[bool],
    rows: Tensor,
    weights: SigmaWeights,
    chol_q: Tensor,
    chol_r: Tensor,
    limit: float,
    half: Tensor,
    points: tuple[Tensor, Tensor],
    results: tuple[Tensor, ...],
) -> tuple[int, int]:
    """Execute steps until one needs a decision; return the library's code, and the number of completed steps.

    Args:
        flow: the process model.
        lengths: (S,) lengths of the steps.
        measured: S flags, whether a row is measured at the end of the step.
        rows: (K, B, M) the rows, without missing components.
        weights: sigma point weights.
        chol_q: (S or 1, B or 1, D, D) lower factors of the process noise.
        chol_r: (B, M, M) lower factors of the measurement noise.
        limit: largest accepted NIS.
        half: (M,) half-periods of the components, inf for non-angles; larger residuals are wrapped.
        points: (B, 2 D + 1, D) sigma points before the steps, overwritten, and memory for those
            after the flow.
        results: memory allocated by `results`.
    """
    (before, moved), done = points, ctypes.c_long(0)
    (batch, _, size), rows = before.shape, rows.contiguous()
    noise, noise_step = _members(chol_r)
    if chol_q.stride()[2:] != (size, 1):
        chol_q = chol_q.contiguous()
    q_next, q_step = (chol_q.stride(k) if chol_q.shape[k] > 1 else 0 for k in range(2))
    scales = (weights.outer, weights.recentring, weights.radius)
    fixed = batch, size, rows.shape[-1], len(measured), flow.function, flow.about, lengths.data_ptr()
    own = bytes(measured), *(scale.data_ptr() for scale in scales), _step(weights.outer)
    given = chol_q.data_ptr(), q_step, q_next, rows.data_ptr(), noise.data_ptr(), noise_step, limit
    places = half.data_ptr(), before.data_ptr(), moved.data_ptr(), *(part.data_ptr() for part in results)
    code = _called("ahnn_follow", *fixed, *own, *given, *places, ctypes.addressof(done))
    return code, done.value


def _results(prior: Belief, innovation: Tensor) -> tuple[Tensor, ...]:
    """Allocate memory for the results of an update, innovations first."""
    (batch, size), new = prior.mean.shape, innovation.new_empty
    state = new(batch, size), new(batch, size, size)
    singular = new(batch, dtype=torch.bool)
    return innovation, *state, torch.empty_like(innovation), new(batch), new(batch), singular


def _updated(sound: bool, results: tuple[Tensor, ...]) -> Updated:
    innovation, mean, chol, deviation, nis, log_likelihood, singular = results
    return Updated(Belief(mean, chol), innovation, deviation, nis, log_likelihood, singular, None, sound)


def _members(matrices: Tensor) -> tuple[Tensor, int]:
    """Return contiguous matrices, and the stride between members, 0 if shared."""
    size = matrices.shape[-1]
    if matrices.stride()[1:] != (size, 1):
        matrices = matrices.contiguous()
    return matrices, matrices.stride(0)


def _step(weight: Tensor) -> int:
    """Return the stride between the members' weights, 0 if shared."""
    return int(len(weight) > 1)


def _call(name: str, *arguments: Tensor | float) -> bool:
    """Call a function of the library with the addresses of tensors; return whether all members are valid.

    Raises:
        MemoryError: not enough memory for a block of members.
    """
    return _called(name, *(a.data_ptr() if isinstance(a, Tensor) else a for a in arguments)) == SOUND


def _called(name: str, batch: float, *arguments: float | bytes) -> int:
    """Call a function of the library with addresses, and return its code; see `_call`."""
    found = library()
    assert found is not None
    status = getattr(found, name)(batch, *arguments)
    if status == NO_MEMORY:
        message = f"filter: not enough memory for {batch} members"
        raise MemoryError(message)
    return status
