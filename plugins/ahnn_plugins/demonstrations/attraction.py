"""Learned attraction of the Sun: mu from the potential, and predictions compared with Kepler motion."""

from __future__ import annotations

from typing import final

import torch
from matplotlib.figure import Figure
from torch import Tensor

from ahnn.arguments import Positive, checked
from ahnn.errors import UserError
from ahnn.evaluation import Case, Findings, Row, Who, style
from ahnn.rollouts import clock_of, rollout
from ahnn.systems import System
from ahnn.types import Space
from ahnn_plugins.demonstrations.two_body import kepler

COLOURS = (style.ORANGE, style.GREEN, style.BLUE, style.VERMILLION, style.PURPLE, style.SKY)


@final
@checked
class Attraction:
    """Comparison of the learned potential with mu/r, and of predictions with Kepler motion.

    Args:
        mu: published gravitational parameter of the centre, in the units of the data.
        bodies: gravitational parameters by body, in the order in which their trajectories alternate.
    """

    def __init__(self, mu: Positive, bodies: dict[str, Positive]) -> None:
        self.mu, self.bodies = mu, bodies

    def check(self, truth: System | None, space: Space, steps: int) -> None:
        """Raise UserError unless there are bodies and the data have three dimensions."""
        if space.dof != 3 or not self.bodies:
            message = f"bodies: expected bodies in three dimensions; received {self.bodies} in {space.dof}"
            raise UserError(message)

    def __call__(self, case: Case) -> Findings:
        """Return the row of Kepler motion, the learned mu for each body, and figures of both.

        Raises:
            UserError: a model without a Hamiltonian.
        """
        if case.energy is None:
            message = f"model: expected a Hamiltonian; received {case.label}, {case.assumes}"
            raise UserError(message)
        start, times = case.test.states[:, :1], case.test.times
        own = torch.tensor(list(self.bodies.values()), dtype=torch.float64)
        both = self.mu + own.repeat(len(start) // len(own)).unsqueeze(1)
        beside = kepler(start.expand_as(case.test.states), times - times[:, :1], both)
        clock = case.test.clock(clock_of(case.flow))
        model = rollout(case.flow, start[:, 0], case.dt, times.shape[1], clock=clock)
        far, strengths = self._strengths(case)
        errors = {case.label: distances(model, case), "Kepler": distances(beside, case)}
        numbers = {
            "mu": self.mu,
            "mu_learned": float(strengths.mean()),
            "relative_difference": float(strengths.mean() / self.mu - 1),
            "bodies": {
                name: {
                    "relative_difference": float(strengths[k :: len(own)].mean() / self.mu - 1),
                    "relative_mass": mass / self.mu,
                    "position_error": {who: by_body(e, len(own))[k] for who, e in errors.items()},
                }
                for k, (name, mass) in enumerate(self.bodies.items())
            },
        }
        note = (
            "r² V'(r) on the training orbits is the published mu of the centre times 1 "
            f"{numbers['relative_difference']:+.1e}"
        )
        row = Row(Who("Kepler", "true"), case.score(beside), note)
        figures = {"attraction": self._attraction(far, strengths, case), "ahead": self._ahead(errors, case)}
        return Findings(rows=[row], numbers=numbers, arrays={"kepler": beside}, figures=figures)

    def _strengths(self, case: Case) -> tuple[Tensor, Tensor]:
        """Return distances r and r² V'(r), each (B, T), along the training orbits."""
        states = case.train.states
        still = torch.cat((states[..., :3], torch.zeros_like(states[..., 3:])), dim=-1).requires_grad_()
        (gradient,) = torch.autograd.grad(case.energy(still).sum(), still)  # pyright: ignore
        q = states[..., :3]
        return q.norm(dim=-1), (q * gradient[..., :3]).sum(-1) * q.norm(dim=-1)

    def _attraction(self, far: Tensor, strengths: Tensor, case: Case) -> Figure:
        """Plot r² V' / mu - 1 against the distance, and the contributions of the bodies' masses."""
        figure = style.canvas(8, 4)
        axes = figure.subplots()
        for k, (name, mass) in enumerate(self.bodies.items()):
            count, colour = len(self.bodies), COLOURS[k % len(COLOURS)]
            r, order = far[k::count].flatten().sort()
            off = 1e6 * (strengths[k::count].flatten()[order] / self.mu - 1)
            axes.plot(r, off, color=colour, lw=2.5, label=name)
            axes.plot(r[[0, -1]], [1e6 * mass / self.mu] * 2, color=colour, ls=(0, (4, 3)), lw=1.0)
        axes.axhline(0, color=style.BLACK, lw=0.6)
        axes.grid(alpha=0.3)
        axes.set_xlabel(f"distance r [{case.space.units.position}]")
        axes.set_ylabel("r² V'(r) / μ - 1  [1e-6]")
        axes.set_yscale("symlog", linthresh=10.0)
        head = f"{case.space.name}: learned attraction and the published μ"
        axes.set_title(f"{head}\ndashed: contribution of the body's own mass")
        style.legend_below(figure, axes)
        return figure

    def _ahead(self, errors: dict[str, Tensor], case: Case) -> Figure:
        """Plot the position error of each body over time, for the model and Kepler motion."""
        count = len(self.bodies)
        figure = style.canvas(9, 6)
        panels = figure.subplots(-(-count // 2), 2, sharex=True, squeeze=False).flatten()
        axis = style.time_axis(case)
        years = axis._replace(time=axis.time / 365.25, unit="a") if axis.unit == "d" else axis
        looks = (style.MODEL, style.FLOOR)
        for k, (axes, name) in enumerate(zip(panels, self.bodies, strict=False)):
            for (who, error), look in zip(errors.items(), looks, strict=True):
                axes.plot(years.time[1:], error[k::count].square().mean(0).sqrt()[1:], **look, label=who)
            style.logarithmic(axes, 20)
            axes.set_title(name)
            axes.set_ylabel(f"error [{case.space.units.position}]")
            style.label_time(axes, years)
        style.legend_below(figure, *panels)
        figure.suptitle(f"{case.space.name}: rms position error over unseen segments, true start")
        return figure


def distances(prediction: Tensor, case: Case) -> Tensor:
    """Return the distances between predicted and true positions of the test set, (B, T)."""
    return (prediction - case.test.states)[..., : case.space.dof].norm(dim=-1)


def by_body(error: Tensor, count: int) -> list[float]:
    """Return the rms over time, averaged over the segments of each body."""
    return [float(error[k::count].square().mean(1).sqrt().mean()) for k in range(count)]
