"""The last step of a training, taken by the functions that were learned: their residuals hardly bend.

A Gauss-Newton step of networks that are linear in their parameters leads to the optimum, up to what normal
points leave out of J and what paths themselves bend. So the gradient is found again where the step leads, by
reverse mode, and steps with the same matrix follow, mixed so that what is left is least (Anderson 1965; of
linear equations that is GMRES). Where the first step was so long that paths bend, they lead nowhere: normal
equations of the functions are then found anew at the best place.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.utils import parameters_to_vector

from ahnn.dynamics import Dynamics
from ahnn.dynamics.linearised import linearised
from ahnn.training.levenberg_marquardt import SUFFICIENT
from ahnn.training.maximum_posterior import PosteriorPoint, WideProblem, after, of_functions

ARRIVED = 0.05
"""Squared length of the step that is left, or decrease by the last one, that is not worth another step.

As a share of what noise alone gives: 1 for each parameter that the data determine.
"""
MATRICES, STEPS = 3, 4
"""Normal equations, and steps of functions with each of them, at most."""


class Taken(NamedTuple):
    """Where functions are.

    Attributes:
        dynamics: the functions.
        problem: theirs.
        weights: parameters of the dynamics at which the problem was followed.
        place: in the parameters theta that the functions are linear in.
    """

    dynamics: Dynamics
    problem: WideProblem
    weights: Tensor
    place: PosteriorPoint


def whole_step(
    problem: WideProblem, dynamics: Dynamics, start: PosteriorPoint
) -> tuple[Dynamics, PosteriorPoint] | None:
    """Return dynamics whose functions took the step to the optimum, and the place where they are.

    None where functions cannot take it, or where it does not pay.
    """
    if arrived(start):
        return None
    begin = here = start.moved(start.theta, start.loss, problem.reduced(problem.gradient(start.theta)))
    best: Taken | None = None
    for _ in range(MATRICES):
        found = lowest(problem if best is None else best.problem, dynamics, begin.theta, here)
        if found is None or found.place.objective >= here.objective:
            break
        best, here = found, found.place
        if arrived(here):
            break
        block = of_functions(best.problem, dynamics, begin.theta, best.weights)
        block = block._replace(gradient=here.block.gradient)
        here = PosteriorPoint.of(here.theta, here.loss, here.degrees, block, here.prior)
        best = best._replace(place=here)
    paid = best is not None and begin.objective - best.place.objective > SUFFICIENT * begin.remaining
    return (best.dynamics, best.place) if best is not None and paid else None


def arrived(place: PosteriorPoint) -> bool:
    """Return whether the step that is left is not worth taking."""
    return place.remaining <= ARRIVED * place.determined


def lowest(problem: WideProblem, dynamics: Dynamics, origin: Tensor, here: PosteriorPoint) -> Taken | None:
    """Return the lowest place that steps with the matrix of `here` lead to; None if no step can be taken.

    Args:
        problem: whose starts fit near here.
        dynamics: what the functions are linearised about.
        origin: its parameters, shape (P,).
        here: where the steps begin.
    """
    theta, places = here.theta + here.offset, [here]
    best: Taken | None = None
    for _ in range(STEPS):
        found = linearised(dynamics, theta - origin)
        if found is None:
            break
        wide, own = found
        problem, weights = after(problem, wide), parameters_to_vector(wide.parameters()).detach()
        if problem.lost:
            break
        there = here.moved(theta, problem.cost, problem.reduced(problem.gradient(weights)[own]))
        places.append(there)
        if best is None or there.objective < best.place.objective:
            best = Taken(wide, problem, weights, there)
        if arrived(there) or there.remaining > places[-2].remaining:
            break
        theta = mixed(places)
    return best


def mixed(places: Sequence[PosteriorPoint]) -> Tensor:
    """Return parameters (P,) one step from the mixture of places whose gradient is the least."""
    *others, last = places
    theta, pull = last.theta, last.pull
    if others:
        moves = torch.stack([place.theta - last.theta for place in others], dim=1)
        changes = torch.stack([place.pull - last.pull for place in others], dim=1)
        shares = torch.linalg.lstsq(changes, -pull.unsqueeze(1)).solution.squeeze(1)
        theta, pull = theta + moves @ shares, pull + changes @ shares
    return theta - last.factor @ pull
