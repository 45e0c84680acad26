"""Final training step in function space, where residuals are nearly linear.

For networks that are linear in their parameters, a Gauss-Newton step reaches the optimum up to the errors of
normal points in J and the nonlinearity of paths. The gradient is therefore recomputed at the new point, by
reverse mode, and further steps use the same matrix; each starts from the mixture of points that minimises the
gradient (Anderson 1965; GMRES for linear equations). If the first step exceeds the linear range of paths,
these steps fail, and the normal equations are recomputed at the best point.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.utils import parameters_to_vector

from ahnn.dynamics import Dynamics
from ahnn.dynamics.linearised import linearised
from ahnn.progress import counted
from ahnn.training.levenberg_marquardt import SUFFICIENT
from ahnn.training.maximum_posterior import PosteriorPoint, WideProblem, after, of_functions

ARRIVED = 0.05
"""Squared length of the remaining step, or decrease by the last one, below which the iteration stops.

Both are relative to the contribution of noise: 1 for each parameter determined by the data.
"""
MATRICES, STEPS = 3, 4
"""Maximum number of normal equations, and of steps in function space with each of them."""


class Taken(NamedTuple):
    """Point in function space.

    Attributes:
        dynamics: dynamics with the linearised functions.
        problem: their least-squares problem.
        weights: parameters of the dynamics at which the problem was evaluated.
        own: indices of theta in these parameters.
        place: posterior point in the linear parameters theta.
    """

    dynamics: Dynamics
    problem: WideProblem
    weights: Tensor
    own: Tensor
    place: PosteriorPoint


def whole_step(
    problem: WideProblem, dynamics: Dynamics, start: PosteriorPoint
) -> tuple[Dynamics, PosteriorPoint] | None:
    """Take the step to the optimum in function space; return the dynamics and the point reached.

    Returns None if the step fails or hardly lowers the objective.
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
        block = of_functions(best.problem, dynamics, best.weights, best.own)
        block = block._replace(gradient=here.block.gradient)
        here = PosteriorPoint.of(here.theta, here.loss, here.degrees, block, here.prior)
        best = best._replace(place=here)
    paid = best is not None and begin.objective - best.place.objective > SUFFICIENT * begin.remaining
    return (best.dynamics, best.place) if best is not None and paid else None


def arrived(place: PosteriorPoint) -> bool:
    """Return whether the remaining step is negligible."""
    return place.remaining <= ARRIVED * place.determined


def lowest(problem: WideProblem, dynamics: Dynamics, origin: Tensor, here: PosteriorPoint) -> Taken | None:
    """Return the lowest point reached by steps with the matrix of `here`; None if no step succeeds.

    Args:
        problem: problem whose initial states were fitted near `here`.
        dynamics: dynamics about which the functions are linearised.
        origin: parameters of these dynamics, shape (P,).
        here: initial point.
    """
    theta, places = here.theta + here.offset, [here]
    best: Taken | None = None
    for _ in counted(STEPS, "step in function space"):
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
            best = Taken(wide, problem, weights, own, there)
        if arrived(there) or there.remaining > places[-2].remaining:
            break
        theta = mixed(places)
    return best


def mixed(places: Sequence[PosteriorPoint]) -> Tensor:
    """Return parameters (P,) one step from the mixture of points with the smallest gradient."""
    *others, last = places
    theta, pull = last.theta, last.pull
    if others:
        moves = torch.stack([place.theta - last.theta for place in others], dim=1)
        changes = torch.stack([place.pull - last.pull for place in others], dim=1)
        weights = torch.linalg.lstsq(changes, -pull.unsqueeze(1)).solution.squeeze(1)
        theta, pull = theta + moves @ weights, pull + changes @ weights
    return theta - last.factor @ pull
