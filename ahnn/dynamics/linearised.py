"""Dynamics linearised in a step of their parameters.

N(z; theta) + dN/dtheta s is represented by three parallel networks, one at theta and two displaced along +s
and -s, which form a network of three times the width. A step that fails in parameter space, because
predictions are nonlinear in theta, can thus still be taken in function space.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from ahnn.dynamics import Dynamics, make_dynamics
from ahnn.dynamics.gaussian_process import Waves
from ahnn.dynamics.layered import Network

REACH = 1e-3
"""Displacement of the finite difference, as a fraction of the step."""
WEIGHTS = (1.0, 0.5 / REACH, -0.5 / REACH)
"""Output weights of the networks at theta, theta + REACH s and theta - REACH s."""


def linearised(dynamics: Dynamics, step: Tensor) -> tuple[Dynamics, Tensor] | None:
    """Return dynamics with networks N + dN/dtheta s, and the indices of theta in their parameters, (P,).

    To first order, the result depends on the indexed parameters as `dynamics` does on theta. The step is
    added to parameters outside networks.

    Args:
        dynamics: result of `make_dynamics`, with networks.
        step: s, shape (P,), in the order of `dynamics.parameters()`.

    Returns:
        None if the dynamics cannot be rebuilt with wider networks.
    """
    spec = getattr(dynamics, "spec", {})
    network = spec.get("network")
    if network is None:
        return None
    wide = make_dynamics(**{**spec, "network": {**network, "width": len(WEIGHTS) * network["width"]}})
    theta = parameters_to_vector(dynamics.parameters()).detach()
    moved = _side_by_side(dynamics, (theta, theta + REACH * step, theta - REACH * step), WEIGHTS)
    if any(moved[name].shape != p.shape for name, p in wide.named_parameters()):
        return None  # parameters outside networks whose shape depends on the width
    wide.to(theta.dtype).load_state_dict({**dynamics.state_dict(), **moved})
    numbers = torch.arange(1, len(theta) + 1).to(theta)
    numbered = _side_by_side(dynamics, (numbers, 0 * theta, 0 * theta), (1.0, 0.0, 0.0))
    flat = torch.cat([numbered[name].flatten() for name, _ in wide.named_parameters()])
    return wide, flat.argsort()[-len(theta) :]


def tangent(dynamics: Dynamics, wide: Dynamics, places: Tensor) -> Dynamics:
    """Return dynamics with the derivatives of `wide` with respect to its P indexed parameters.

    The networks are those of `dynamics`; parameters outside networks, such as the logarithm of mu, have the
    values after the step. Only the parameter derivatives are meaningful, not the motion.

    Args:
        dynamics: argument of `linearised`.
        wide: dynamics returned by `linearised`.
        places: indices returned by `linearised`, (P,).
    """
    found = copy.deepcopy(dynamics)
    vector_to_parameters(parameters_to_vector(wide.parameters()).detach()[places], found.parameters())
    return found


def _side_by_side(
    dynamics: Dynamics, copies: Sequence[Tensor], weights: Sequence[float]
) -> dict[str, Tensor]:
    """Return the tensors, by name, of dynamics whose networks are weighted sums of the copies."""
    found, begin = dict[str, Tensor](), 0
    networks = [name for name, module in dynamics.named_modules() if isinstance(module, Network)]
    for name, parameter in dynamics.named_parameters():
        end = begin + parameter.numel()
        parts = [copy[begin:end].view_as(parameter) for copy in copies]
        own = next((name.removeprefix(f"{n}.") for n in networks if name.startswith(f"{n}.")), "")
        scaled = [weight * part for weight, part in zip(weights, parts, strict=True)]
        if own == "output.weight":
            found[name] = torch.cat(scaled, dim=1)
        elif isinstance(waves := dynamics.get_submodule(name.rpartition(".")[0]), Waves):
            found |= _copied(waves, name.removesuffix("log_lengths"), parts)
        elif own in ("", "output.bias"):
            found[name] = torch.stack(scaled).sum(0)
        elif own.endswith("weight") and not own.startswith("hidden.0."):
            found[name] = torch.block_diag(*parts)
        else:
            found[name] = torch.cat(parts)
        begin = end
    return found


def _copied(waves: Waves, prefix: str, log_lengths: Sequence[Tensor]) -> dict[str, Tensor]:
    """Return concatenated wave tensors; only the first copy depends on the learned lengths."""
    first, *others = log_lengths
    kept = [waves.weight_at(other)[::2] for other in others]
    return {
        f"{prefix}log_lengths": first,
        f"{prefix}frequencies": torch.cat((waves.frequencies, *kept)),
        f"{prefix}free": torch.cat((waves.free, *(torch.zeros_like(waves.free) for _ in others))),
    }
