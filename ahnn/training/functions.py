"""The last step of a training, taken by the functions that were learned: their residuals hardly bend.

A Gauss-Newton step of networks that are linear in their parameters leads to the optimum, up to what normal
points leave out of J and what paths themselves bend. So the gradient is found again where the step leads, by
reverse mode, and steps with the same matrix follow, mixed so that what is left is least (Anderson 1965; of
linear equations that is GMRES).
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn.utils import parameters_to_vector

from ahnn.dynamics import Dynamics
from ahnn.dynamics.linearised import linearised
from ahnn.training.levenberg_marquardt import SUFFICIENT
from ahnn.training.posterior import Place, WideProblem, after

ARRIVED = 0.05
"""Squared length of the step that is left, or decrease by the last one, that is not worth another step.

As a share of what noise alone gives: 1 for each parameter that the data determine.
"""
STEPS = 4
"""Steps of functions, at most."""


def whole_step(problem: WideProblem, dynamics: Dynamics, start: Place) -> tuple[Dynamics, Place] | None:
    """Return dynamics whose functions took the step to the optimum, and the place where they are.

    None where functions cannot take it, or where it does not pay.
    """
    if start.remaining <= ARRIVED * start.determined:
        return None
    here = start.moved(start.theta, start.loss, problem.gradient(start.theta))
    theta, places = here.theta + here.offset, [here]
    best: tuple[Dynamics, Place] | None = None
    for _ in range(STEPS):
        found = linearised(dynamics, theta - here.theta)
        if found is None:
            break
        wide, own = found
        problem = after(problem, wide)
        if problem.lost:
            break
        gradient = problem.gradient(parameters_to_vector(wide.parameters()).detach())[own]
        there = here.moved(theta, problem.cost, gradient)
        places.append(there)
        if best is None or there.objective < best[1].objective:
            best = wide, there
        if there.remaining <= ARRIVED * there.determined:
            break
        theta = mixed(places)
    paid = best is not None and here.objective - best[1].objective > SUFFICIENT * here.remaining
    return best if paid else None


def mixed(places: Sequence[Place]) -> Tensor:
    """Return parameters (P,) one step from the mixture of places whose gradient is the least."""
    *others, last = places
    theta, pull = last.theta, last.pull
    if others:
        moves = torch.stack([place.theta - last.theta for place in others], dim=1)
        changes = torch.stack([place.pull - last.pull for place in others], dim=1)
        shares = torch.linalg.lstsq(changes, -pull.unsqueeze(1)).solution.squeeze(1)
        theta, pull = theta + moves @ shares, pull + changes @ shares
    return theta - last.factor @ pull
