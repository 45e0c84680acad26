"""Per-sample Jacobians of a perceptron's gradient with respect to its parameters, in closed form.

The backward pass of `gradients` sums over samples. Here the R rows of each sample are kept. In layer l a row
is delta_l (x) along_l + back_l (x) a_{l-1}, two outer products per gradient evaluation. The products of all
stages of a Runge-Kutta step form one batched product, written in place.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.dynamics.gradients import LayerRecord, Layers
from ahnn.dynamics.layered import Network


class Stage(NamedTuple):
    """One gradient evaluation with R cotangents for each of B samples; F inputs, L layers of H units.

    Attributes:
        records: result of `recorded_gradient`, L layers.
        along: L + 1 tangents: the cotangents themselves (B, R, F), then after each layer (B, R, H).
        back: gradients propagated back to each layer, (B, R, H).
    """

    records: list[LayerRecord]
    along: list[Tensor]
    back: list[Tensor]


def layers_at(network: Network, theta: Tensor) -> Layers:
    """Return the layers of a single-output perceptron with parameters theta, (P,)."""
    parameters = list(network.parameters())
    parts = theta.split([p.numel() for p in parameters])
    *hidden, last, _ = [part.view_as(p) for part, p in zip(parts, parameters, strict=True)]
    return Layers(hidden[::2], hidden[1::2], last[0], hidden[0])


def reversed_rows(t: Tensor, records: list[LayerRecord], weights: list[Tensor]) -> tuple[Stage, Tensor]:
    """Return the backward pass of g = grad N(z) for all cotangents, and t . dg/dz, shape (B, R, F).

    Args:
        t: cotangents of g, (B, R, F).
        records: result of `recorded_gradient` at z, (B, F).
        weights: weights of the hidden layers.
    """
    along, bends = [t], []
    for weight, record in zip(weights, records, strict=True):
        tangent = along[-1] @ weight.T
        bends.append(record.bend.unsqueeze(1) * tangent)
        along.append(tangent.mul_(record.slope.unsqueeze(1)))
    back = [bends.pop()]
    for weight, bend, record in zip(weights[:0:-1], bends[::-1], records[-2::-1], strict=True):
        back.append(bend.addcmul_(back[-1] @ weight, record.slope.unsqueeze(1)))
    return Stage(records, along, back[::-1]), back[-1] @ weights[0]


def curvature(records: list[LayerRecord], weights: list[Tensor]) -> Tensor:
    """Return the second derivatives of N with respect to z, shape (B, F, F).

    Args:
        records: result of `recorded_gradient` at z, (B, F).
        weights: weights of the hidden layers.
    """
    first, *further = weights
    # The curvature of the first layer is a contraction of products of its weights, common to all samples.
    products = (first.unsqueeze(2) * first.unsqueeze(1)).flatten(1)
    found = (records[0].bend @ products).unflatten(1, (first.shape[1], -1))
    if not further:
        return found
    seen = first.T * records[0].slope.unsqueeze(1)
    _, back = reversed_rows(seen, records[1:], further)
    return found + (back * records[0].slope.unsqueeze(1)) @ first


def with_value(stage: Stage, v: Tensor, last: Tensor) -> Stage:
    """Return a stage extended by the backward pass of v N(z), except for the output bias of N.

    Args:
        stage: stage of cotangents of grad N(z).
        v: cotangents of N(z), (B, R).
        last: inputs of the output layer, (B, H).
    """
    v = v.unsqueeze(-1)
    back = [b + v * record.delta.unsqueeze(1) for b, record in zip(stage.back, stage.records, strict=True)]
    along = [*stage.along[:-1], stage.along[-1] + v * last.unsqueeze(1)]
    return stage._replace(back=back, along=along)


def write_rows(stages: list[Stage], out: Tensor) -> None:
    """Write the sum over the stages of t . dg/dparameters to `out`, (B, R, P), contiguous.

    Columns are in the order of the parameters: weight and bias of each layer, then of the output.
    """
    rows, column = out.flatten(0, 1), 0
    for k in range(len(stages[0].records)):
        left = _interleaved([s.records[k].delta for s in stages], [s.back[k] for s in stages])
        right = _interleaved([s.records[k].entered for s in stages], [s.along[k] for s in stages], swap=True)
        units, inputs = left.shape[-1], right.shape[-1]
        part = rows[:, column : column + units * inputs].unflatten(1, (units, inputs))
        torch.bmm(left.mT, right, out=part)
        column += units * inputs
        out[..., column : column + units] = sum(s.back[k] for s in stages)
        column += units
    last = sum(s.along[-1] for s in stages)
    out[..., column:-1] = last
    out[..., -1] = 0.0  # the gradient does not depend on the output bias


def _interleaved(shared: list[Tensor], own: list[Tensor], *, swap: bool = False) -> Tensor:
    """Return factors of outer products, (B R, 2S, H), from S per-sample (B, H) and S per-row (B, R, H) ones.

    Per-row factors follow the per-sample factors, or precede them with `swap`.
    """
    wide = [t.unsqueeze(1).expand_as(own[0]) for t in shared]
    return torch.stack([*own, *wide] if swap else [*wide, *own], dim=2).flatten(0, 1)
