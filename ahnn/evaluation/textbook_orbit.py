"""Textbook physics beside a model of recorded orbits: two-body motion with J2, from the same data."""

from __future__ import annotations

import math
from typing import Any, NamedTuple, cast

import torch
from torch import Tensor, nn

from ahnn.data.files.units import LENGTH, TIME, unit
from ahnn.data.reference import BODY, Reference
from ahnn.dynamics.forced import forced
from ahnn.dynamics.forces.attraction import CentralAttraction, Oblateness
from ahnn.evaluation.case import Case, Row, Who
from ahnn.evaluation.forecast import HALF, first_part, part_fitted
from ahnn.evaluation.goodness_of_fit import fit_to
from ahnn.evaluation.titles import TEXTBOOK
from ahnn.integrators import INTEGRATORS
from ahnn.measurements import Segment
from ahnn.numbers import in_percent
from ahnn.rollouts import clock_of, rollout
from ahnn.shooting.path_sensitivities import path, steps_between
from ahnn.shooting.robust import RobustName
from ahnn.types import Space, TimeStep, as_factor

EARTH = (3.986004418e14, 6378136.3, 1.0826e-3)
"""Gravitational parameter in m^3/s^2, equatorial radius in m, and J2 of the Earth."""
NEAREST, FARTHEST = 0.98, 100.0
"""Range of distances from the centre, in equatorial radii, within which data can be an Earth satellite."""
STEP = 0.25
"""Maximum step of dopri8, in radians of the motion at the smallest distance."""
BETTER = 0.9
"""Fraction of the model's error below which the textbook's counts as smaller."""
FITS = 0.1
"""Error, relative to the distance from the centre, above which data are no orbit about the Earth."""
NORMAL = 0.6744897501960817
"""Median of the absolute value of a standard normal variable."""


class OblateEarth(nn.Module):
    """Flow of a satellite about the oblate Earth, in the units of a space.

    Args:
        space: three coordinates in an inertial frame, with p = m dq/dt.
    """

    def __init__(self, space: Space) -> None:
        super().__init__()
        mu, radius, j2 = EARTH
        length, time = unit(space.units.position).size, unit(space.units.time).size
        self.mu, self.radius = mu * time**2 / length**3, radius / length
        self.mass = space.inertia
        central = CentralAttraction(3, mu=self.mu)
        self.terms = central, Oblateness(3, mu=self.mu, radius=self.radius, j2=j2)

    def field(self, x: Tensor) -> Tensor:
        """Return dx/dt, shape (..., 6)."""
        mass = as_factor(self.mass)
        drift = lambda z: torch.cat((z[..., 3:] / mass, torch.zeros_like(z[..., 3:])), dim=-1)  # noqa: E731
        rate, pull = forced(drift, self.terms, x, 0).chunk(2, dim=-1)
        return torch.cat((rate, mass * pull), dim=-1)

    def increment(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return x(t + dt) - x(t), shape (B, 6)."""
        return INTEGRATORS["dopri8"].increment(self.field, x, dt)

    def forward(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the states after dt, shape (B, 6)."""
        return x + self.increment(x, dt)

    def longest(self, positions: Tensor) -> float:
        """Return the maximum step for orbits through positions (..., 3)."""
        nearest = max(float(distances(positions).min()), self.radius)
        return STEP * math.sqrt(nearest**3 / (2 * self.mu))


class Beside(NamedTuple):
    """Typical errors of forecasts in standard deviations of the noise, each from its own fitted start.

    Attributes:
        model: error of the model.
        textbook: error of two-body motion with J2.
    """

    model: float
    textbook: float

    def sentence(self) -> str:
        """Return the finding as a note under the table."""
        return (
            "second halves of unseen trajectories, predicted from first halves, have residuals of "
            f"{self.model:.3g} times the noise, {self.textbook:.3g} times with {TEXTBOOK} instead"
        )


def oblate_earth(case: Case) -> OblateEarth | None:
    """Return the textbook flow for recorded states or measurements of an Earth satellite; None for others.

    A centre that is not stated is taken to be the Earth if the distances are those of a satellite.
    """
    space = case.space
    if case.truth is not None or space.controls or not space.mechanical or len(space.components) != 6:
        return None
    try:
        units = unit(space.units.position), unit(space.units.time)
    except ValueError:
        return None
    center = Reference.of(space.frame).center
    if [one.dimension for one in units] != [LENGTH, TIME] or center not in ("", BODY):
        return None
    flow = OblateEarth(space)
    far = float(distances(case.test.states[..., :3]).median()) / flow.radius
    return flow if NEAREST < far < FARTHEST else None


def distances(positions: Tensor) -> Tensor:
    """Return the known distances from the centre, (K,), of positions (..., 3)."""
    found = positions.norm(dim=-1)
    return found[found.isfinite()]


def textbook_row(case: Case) -> tuple[Row, Tensor] | None:
    """Return scores and prediction (B, T, 6) of the textbook from known states; None if it does not apply.

    It does not apply to data without states, or if its error exceeds `FITS` of the distance.
    """
    flow = oblate_earth(case) if case.fitted is None and case.measured is None else None
    start = case.test.states[:, 0]
    if flow is None or not bool(start.isfinite().all()):
        return None
    states = case.test.states
    found = rollout(flow, start, case.dt, states.shape[1], longest=flow.longest(states[..., :3]))
    off = (found - states)[..., :3].norm(dim=-1).nanmean() / distances(states[..., :3]).mean()
    return (Row(Who(TEXTBOOK, "true"), case.score(found)), found) if float(off) < FITS else None


def textbook_forecasts(case: Case) -> Beside | None:
    """Return errors of forecasts of unseen measurements by model and textbook; None if it does not apply."""
    flow = None if case.measured is None or clock_of(case.flow) else oblate_earth(case)
    if flow is None or case.measured is None:
        return None
    shorter = min(case.measured.instrument.longest, flow.longest(case.test.states[..., :3]))
    finer = case.measured._replace(instrument=case.measured.instrument._replace(longest=shorter))
    textbook = forecast_error(flow, finer, case.robust)
    if not math.isfinite(textbook):
        return None
    return Beside(forecast_error(cast(Any, case.flow), case.measured, case.robust), textbook)


@torch.no_grad()
def forecast_error(dynamics: nn.Module, segment: Segment, robust: RobustName) -> float:
    """Return the typical residual of forecasts: the median of its size, 1 for standard normal residuals.

    Infinite or NaN residuals count as large.
    """
    early = first_part(segment, HALF)
    first = part_fitted(cast(Any, dynamics), segment, early, robust)
    begun, _ = fit_to(dynamics, first)
    steps = steps_between(segment.times, segment.instrument.longest)
    states = path(cast(Any, dynamics).increment, begun.starts, steps.lengths)
    ahead = ~early.unsqueeze(-1) & ~segment.values.isnan()
    sizes = segment.residuals(states[:, steps.ends])[ahead].abs().nan_to_num(nan=math.inf)
    return float(sizes.median()) / NORMAL if len(sizes) else math.nan


def remedy(case: Case, model: float, textbook: float) -> str:
    """Return the fault of a model that is less accurate than the textbook; "" for a better one."""
    if not textbook < BETTER * model:
        return ""
    share = in_percent(textbook / model)
    if Oblateness.assumes in case.assumes:
        how = ", although the model includes it: train longer"
    elif case.space.units[:2] == ("s", "km"):
        how = ": hamiltonian=mechanical forces=oblate_planet learns what it leaves"
    else:
        how = "; add it as a known force (forces=oblate_planet)"
    return f"less accurate than {TEXTBOOK} without learning, whose error is {share} of the model's{how}"
