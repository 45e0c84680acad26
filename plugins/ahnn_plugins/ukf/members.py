"""Square-root form in C, batched over members, with the same results as in torch, to rounding.

Used on the CPU without gradients. Between two calls of the flow torch executes about a hundred small
operations dominated by overhead; here there are three or four.
"""

from __future__ import annotations

import ctypes
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.compiled_libraries import CompiledFlow, followed, plain
from ahnn.estimation.belief import Belief
from ahnn.estimation.results import Predicted, Updated
from ahnn.estimation.step_runs import StepRun
from ahnn_plugins.ukf.library import library
from ahnn_plugins.ukf.parameters import Residual, SigmaWeights

SOUND, NO_MEMORY = 0, 2
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
    told = residual(y if complete else torch.where(present, y, y_pred), y_pred)
    innovation = torch.empty_like(y).copy_(told)
    results = _results(prior, innovation)
    given = joint, y, prior.mean.contiguous(), noise, noise_step
    return _updated(_call("ahnn_condition", *shapes, *given, *results), results)


def read(prior: Belief, y: Tensor, chol_r: Tensor) -> Updated:
    """Return the posterior given a row y (B, M) of the first M components of the state, NaN where missing."""
    y, mean = y.contiguous(), prior.mean.contiguous()
    (chol, step), (noise, noise_step) = _members(prior.chol), _members(chol_r)
    results = _results(prior, torch.empty_like(y))
    shapes = (*mean.shape, y.shape[-1])
    return _updated(_call("ahnn_read", *shapes, y, mean, chol, step, noise, noise_step, *results), results)


class StepNoise(NamedTuple):
    """Noise and limits of a step in the library's format.

    Attributes:
        process: address of the factor of the process noise, and the step between members.
        measured: the same for the measurement noise, the largest accepted NIS, and the address of the
            half-periods.
        tensors: tensors that own the memory.
    """

    process: tuple[int, int]
    measured: tuple[int, int, float, int]
    tensors: tuple[Tensor, ...]

    @classmethod
    def of(cls, chol_q: Tensor, chol_r: Tensor, limit: float, half: Tensor) -> StepNoise:
        """Build the noise of a step.

        Args:
            chol_q: (B, D, D) lower factor of the process noise.
            chol_r: (B, M, M) lower factor of the measurement noise.
            limit: largest accepted NIS.
            half: (M,) half-periods of the components, inf for non-angles; larger residuals are wrapped.
        """
        (q, q_step), (r, r_step) = _members(chol_q), _members(chol_r)
        read = r.data_ptr(), r_step, limit, half.data_ptr()
        return cls((q.data_ptr(), q_step), read, (q, r, half))


class Memory:
    """Storage for the results of fused steps of a run.

    Args:
        rows: (B, T, M) measurements.
        size: dimension D.
        weights: sigma point weights.
    """

    def __init__(self, rows: Tensor, size: int, weights: SigmaWeights) -> None:
        (batch, steps, width), new = rows.shape, rows.new_empty
        self.rows, self.weights, self.shape = rows.transpose(0, 1).contiguous(), weights, (batch, size, width)
        beliefs = [new(steps, batch, *((size,) * k)) for k in (1, 2, 1, 2)]
        told = [new(steps, batch, width), new(steps, batch, width), new(steps, batch), new(steps, batch)]
        singular = new(steps, batch, dtype=torch.bool)
        parts = (*beliefs[:2], told[0], *beliefs[2:], *told[1:], singular)
        kept = self.rows, *parts
        self.places = [(part.data_ptr(), part[0].numel() * part.element_size()) for part in kept]
        self.steps = list(zip(*(part.unbind() for part in parts), strict=True))
        scales = weights.outer, weights.recentring, weights.radius
        self.scales = *(scale.data_ptr() for scale in scales), _step(weights.outer)

    def step(self, k: int, points: Tensor, noise: StepNoise, *, measured: bool) -> Tensor | None:
        """Execute `predict`, `read` and `draw` in sequence.

        Args:
            k: step index.
            points: (B, S, D) sigma points after the flow.
            noise: noise of the step.
            measured: whether there is a complete row.

        Returns:
            The sigma points of the next step; None if a member is invalid.
        """
        points = points.contiguous()
        further = torch.empty_like(points)
        row, *places = [place + k * length for place, length in self.places]
        read = row if measured else 0, *noise.measured
        own = points.data_ptr(), *self.scales, *noise.process, *read, *places, further.data_ptr()
        return further if _done("ahnn_whole", *self.shape, *own) else None

    def made(self, k: int) -> tuple[Belief, Updated]:
        """Return prediction and update of step k."""
        mean, chol, *results = self.steps[k]
        return Belief(mean, chol), _updated(True, tuple(results))


def results(steps: int, width: int, mean: Tensor) -> tuple[Tensor, ...]:
    """Allocate memory for S steps of members like `mean`, (B, D), with rows of M components.

    Returns:
        Means and factors of the predictions, innovations, means and factors of the posteriors, deviations,
        NIS, log-likelihoods and flags of singular members, each (S, B, ...).
    """
    (batch, size), new = mean.shape, mean.new_empty
    vector, matrix, row, one = (
        (steps, batch, size),
        (steps, batch, size, size),
        (steps, batch, width),
        (steps, batch),
    )
    floats = tuple(new(shape) for shape in (vector, matrix, row, vector, matrix, row, one, one))
    return *floats, new(one, dtype=torch.bool)


def follow(
    flow: CompiledFlow,
    run: StepRun,
    weights: SigmaWeights,
    noise: StepNoise,
    points: tuple[Tensor, Tensor],
    results: tuple[Tensor, ...],
) -> int:
    """Execute steps until one needs a decision; return how many are done.

    Args:
        flow: the process model.
        run: steps and rows of one member.
        weights: sigma point weights.
        noise: noise of the steps; process noise is that of a step each.
        points: (1, S, D) sigma points before the run, overwritten, and memory for those after the flow.
        results: memory of `results`.
    """
    (before, moved), done, rows = points, ctypes.c_long(0), run.rows.contiguous()
    scales = (weights.outer, weights.recentring, weights.radius)
    fixed = 1, before.shape[-1], rows.shape[-1], len(run.measured), flow.function, flow.about
    q, q_next = noise.process
    chol_r, r_step, limit, half = noise.measured
    steps = run.lengths.data_ptr(), bytes(run.measured), *(scale.data_ptr() for scale in scales), 0
    own = q, 0, q_next, rows.data_ptr(), chol_r, r_step, limit, half, before.data_ptr(), moved.data_ptr()
    _done("ahnn_follow", *fixed, *steps, *own, *(part.data_ptr() for part in results), ctypes.addressof(done))
    return done.value


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
        MemoryError: no memory for a block of members.
    """
    return _done(name, *(a.data_ptr() if isinstance(a, Tensor) else a for a in arguments))


def _done(name: str, batch: float, *arguments: float | bytes) -> bool:
    """Call a function of the library with addresses; see `_call`."""
    found = library()
    assert found is not None
    told = getattr(found, name)(batch, *arguments)
    if told == NO_MEMORY:
        message = f"filter: not enough memory for {batch} members"
        raise MemoryError(message)
    return told == SOUND
