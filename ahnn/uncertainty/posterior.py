"""Covariance of learned parameters, stored in a file next to the weights."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ahnn.checkpoints import FORMAT, Weights, checksum, read_weights, write_weights
from ahnn.dynamics import Dynamics
from ahnn.dynamics.linearised import linearised, tangent
from ahnn.errors import UserError
from ahnn.stored import Spread, read

FILE = "covariance.safetensors"
PARTS = ("factor", "offset", "directions", "step")


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Learned parameters as a normal distribution (Laplace's approximation).

    Attributes:
        factor: L, shape (P, R), float64; L L^T is the covariance for unit noise.
        offset: (P,) remaining step from the learned parameters to the optimum.
        inflation: factor on the covariance, at least 1, for errors not explained by noise.
        about: plain values: `determined` (effective number of parameters), `strengths` of the prior,
            `chi_square` of the training, `remaining` (squared length of the offset in standard deviations),
            `held_out` (the part of the inflation required by validation measurements), `log_evidence`.
        directions: (P, K) parameter directions least observable by a filter from similar measurements, in
            order of importance; None if not computed.
        step: (P,) step in function space (`ahnn.dynamics.linearised`), if any.
        before: dynamics before that step, if it was taken.
        tangent: dynamics with a third of the network and the distribution of their parameters, which describe
            the same uncertainty of the force (`ahnn.dynamics.linearised.tangent`), if the step was taken.
    """

    factor: Tensor
    offset: Tensor
    inflation: float
    about: dict[str, Any]
    directions: Tensor | None = None
    step: Tensor | None = None
    before: Dynamics | None = None
    tangent: tuple[Dynamics, Uncertainty] | None = None

    @property
    def spread(self) -> Tensor:
        """Factor, shape (P, R + 1), of the second moment of true minus learned parameters, inflated."""
        return self.inflation**0.5 * torch.cat((self.factor, self.offset.unsqueeze(-1)), dim=-1)

    @property
    def covariance(self) -> Tensor:
        """Second moment of true minus learned parameters, (P, P), ordered as `dynamics.parameters()`."""
        return self.spread @ self.spread.mT

    def to(self, device: torch.device | str | None) -> Uncertainty:
        """Return a copy on a device, in float64."""
        moved = {name: part.to(device) for name in PARTS if (part := getattr(self, name)) is not None}
        before = self.before and copy.deepcopy(self.before).to(device)
        narrow = self.tangent and (copy.deepcopy(self.tangent[0]).to(device), self.tangent[1].to(device))
        return replace(self, **moved, before=before, tangent=narrow)

    @property
    def unfinished(self) -> str:
        """Warning about a training that ended before its optimum; "" if its bands are meaningful."""
        if not is_unfinished(self.about):
            return ""
        remaining, determined = self.about["remaining"], self.about["determined"]
        return (
            f"the training ended before its optimum: the remaining step is {remaining**0.5:.2g} standard "
            f"deviations long (noise alone: {determined**0.5:.2g}), so its bands are too wide or void. "
            "Train for more epochs (trainer.max_epochs) or with more closing steps (loss.closing)"
        )

    @property
    def least_observable(self) -> Tensor | None:
        """Saved least observable directions of the parameters before the function-space step."""
        return (self if self.tangent is None else self.tangent[1]).directions

    def taken(self, dynamics: Dynamics) -> tuple[Dynamics, Uncertainty]:
        """Return dynamics after the function-space step, and the distribution of their parameters."""
        found = None if self.step is None else linearised(dynamics, self.step)
        if found is None:
            return dynamics, self
        wide, places = found
        size = sum(p.numel() for p in wide.parameters())
        factor = self.factor.new_zeros(size, self.factor.shape[1]).index_copy(0, places, self.factor)
        offset = self.offset.new_zeros(size).index_copy(0, places, self.offset)
        here = {"factor": factor, "offset": offset, "directions": None, "step": None}
        return wide, replace(self, **here, before=dynamics, tangent=(tangent(dynamics, wide, places), self))


def is_unfinished(about: Mapping[str, Any]) -> bool:
    """Return whether a training ended before its optimum, from the numbers that describe its covariance.

    Noise contributes 1 to the squared length of the error for each determined parameter. If the squared
    remaining step, which is only a linear estimate, exceeds their number, it dominates the band.
    """
    return bool(about.get("remaining", 0.0) > about.get("determined", 0.0))


def save_uncertainty(folder: Path, uncertainty: Uncertainty, state: dict[str, Tensor]) -> None:
    """Write the covariance into a run folder, with the checksum of the run's weights."""
    about = {"format": FORMAT, "weights": checksum(state, ""), "inflation": uncertainty.inflation}
    about["found"] = uncertainty.about
    parts = {name: getattr(uncertainty, name) for name in PARTS}
    tensors = {name: part for name, part in parts.items() if part is not None}
    write_weights(folder / FILE, Weights(tensors, about))


def load_uncertainty(folder: Path, state: dict[str, Tensor]) -> Uncertainty | None:
    """Load the covariance in a run folder; None if it is missing or belongs to other weights.

    Raises:
        UserError: the file is damaged.
    """
    if not (folder / FILE).exists():
        return None
    tensors, content = read_weights(folder / FILE)
    about = read(f"{folder / FILE}", Spread, content)
    if about.weights != checksum(state, ""):
        return None
    factor, offset, directions, step = (tensors.get(name) for name in PARTS)
    if (
        factor is None
        or offset is None
        or factor.shape != (len(offset), len(offset))
        or (step is not None and step.shape != offset.shape)
        or (directions is not None and (directions.ndim != 2 or len(directions) != len(offset)))
        or not all(t.dtype == torch.float64 and bool(t.isfinite().all()) for t in tensors.values())
    ):
        message = (
            f"{folder / FILE}: expected a square factor, steps and directions of its length, finite "
            "float64; received tensors that do not fit"
        )
        raise UserError(message)
    return Uncertainty(factor, offset, about.inflation, about.found, directions, step)
