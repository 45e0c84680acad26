"""Where an assimilation begins: a belief from values, a plain file, or an orbit ephemeris message."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
import yaml

from ahnn.data.files import read_oem
from ahnn.data.files.plain import loaded
from ahnn.deviations import state_deviations
from ahnn.errors import UserError
from ahnn.estimation import Belief, initial_belief
from ahnn.types import Space

Deviations = list[float] | tuple[float, ...] | None


def start_of(given: str | list[float] | None, deviations: Deviations, space: Space) -> Belief:
    """Return the belief that an assimilation starts from.

    Args:
        given: the mean, or the path of a file that holds it: `mean` with `sd` or `covariance` in YAML or
            JSON, or an orbit ephemeris message, whose last state and covariance count.
        deviations: standard deviations where nothing else says them: 2n, or one for positions and one for
            velocities.
        space: what the numbers of a state mean.

    Raises:
        UserError: no such file, numbers that are missing or of another count, or no covariance.
    """
    known = _read(Path(given), space) if isinstance(given, str) else {"mean": given}
    size, covariance = 2 * space.dof, known.get("covariance")
    if covariance is None:
        covariance = state_deviations(known.get("sd", deviations), space, "start_sd").square().diag()
    try:
        return initial_belief(torch.tensor([known["mean"]], dtype=torch.float64).reshape(1, size), covariance)
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        names = ", ".join(space.components)
        reason = str(error) if isinstance(error, ValueError) else "another count, or no numbers"
        message = f"start: expected [{names}] with its covariance; received {given} ({reason})"
        raise UserError(message) from error


def _read(path: Path, space: Space) -> dict[str, Any]:
    """Return what a file says of a state: `mean`, and `sd` or `covariance` if it has them."""
    if path.suffix in (".oem", ".xml"):
        last = read_oem(path)[-1]
        scale = torch.tensor([1.0] * 3 + [space.inertia] * 3, dtype=torch.float64)
        known: dict[str, Any] = {"mean": (torch.from_numpy(last.states[-1].copy()) * scale).tolist()}
        if last.covariances:
            known["covariance"] = torch.from_numpy(last.covariances[-1].matrix) * torch.outer(scale, scale)
        return known
    try:
        content = loaded(path.read_text())
    except (OSError, yaml.YAMLError, ValueError) as error:
        message = f"start: expected a file with mean and sd or covariance; received {path} ({error})"
        raise UserError(message) from error
    unknown = content.keys() - {"mean", "sd", "covariance"} if isinstance(content, dict) else {"no keys"}
    if unknown or "mean" not in content:
        received = ", ".join(sorted(unknown)) or "no mean"
        message = f"start: expected mean and sd or covariance in {path}; received {received}"
        raise UserError(message)
    return content
