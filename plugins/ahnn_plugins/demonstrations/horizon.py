"""Prediction horizon of a learned flow compared with analytic flows, by errors per period."""

from __future__ import annotations

import copy
from typing import Any, NamedTuple, final

import torch
from matplotlib.figure import Figure
from torch import Tensor

from ahnn.arguments import Count, Positive, Seed, checked
from ahnn.dynamics.fields import HamiltonianDynamics
from ahnn.dynamics.recorded_flow import recorded
from ahnn.errors import UserError
from ahnn.evaluation import Case, Findings, Row, Who, style
from ahnn.rollouts import clock_of, rollout
from ahnn.systems import Molniya, System, exact_flow
from ahnn.types import Flow, Space, TimeStep
from ahnn_plugins.demonstrations.two_body import kepler

TWO_BODY, KNOWN = "two-body", "known part"
ROUNDS, SETTLED = 8, 1e-6
"""Maximum number of Gauss-Newton steps for a start, and negligible relative change of its sum of squares."""
USUAL = 4
"""Typical number of these steps."""
NUDGE = 1e-6
"""Finite-difference steps of starts, relative to distance and speed."""


class Ahead(NamedTuple):
    """Prediction of the test trajectories.

    Attributes:
        name: name of the flow.
        start: `true`, or `fitted` to the first positions.
        states: (B, T, D).
        errors: (N,) rms error of position over all trajectories, period by period.
    """

    name: str
    start: str
    states: Tensor
    errors: Tensor


@final
@checked
class Horizon:
    """Comparison of a learned flow with its known physics, an oblate planet, and two-body motion.

    Each flow predicts the test trajectories twice: from their first states, and from the starts that best fit
    noisy positions of their first samples. If the learned flow contains known forces, a row shows its
    accuracy without the learned part.

    Args:
        arc: number of samples for fitting a start.
        noise: standard deviation of the noise on their positions.
        seed: seed of that noise.
        period: averaging time of the errors, such as a day or a year, in the unit of time of the data.
        unit: name of this period.
        beside: the oblate planet, if there is one.
        mu: mu of two-body motion, or one for each of several bodies whose trajectories alternate; None for mu
            of the planet.
    """

    def __init__(
        self,
        arc: Count,
        noise: Positive,
        seed: Seed,
        *,
        period: Positive,
        unit: str,
        beside: Molniya | None = None,
        mu: Positive | list[Positive] | None = None,
    ) -> None:
        self.beside, self.arc, self.noise, self.seed = beside, arc, noise, seed
        self.period, self.unit = period, unit
        found = mu if mu is not None or beside is None else beside.mu
        if found is None:
            message = "mu: expected mu of two-body motion, or a planet in `beside`; received neither"
            raise UserError(message)
        self.mu = torch.tensor(found if isinstance(found, list) else [found], dtype=torch.float64)

    def check(self, truth: System | None, space: Space, steps: int) -> None:
        """Raise UserError for data of other dimensions or units, or an arc of invalid length."""
        if space.dof != 3 or (self.beside is not None and space.units != self.beside.units):
            expected = "three dimensions" if self.beside is None else str(self.beside.units)
            message = f"beside: expected data in {expected}; received {space.dof} in {space.units}"
            raise UserError(message)
        if not 6 <= self.arc <= steps:
            message = f"arc: expected 6 to {steps} samples, the length of a trajectory; received {self.arc}"
            raise UserError(message)

    def rollouts(self, samples: int) -> float:
        """Return the cost in rollouts of this length, for the learned and the known flow."""
        return 2.0 * (1.0 + USUAL * self.arc / samples)

    def flows(self, case: Case) -> dict[str, Flow]:
        """Return the flows by name, the learned one first."""
        found: dict[str, Flow] = {case.label: recorded(case.flow)}
        if isinstance(case.flow, HamiltonianDynamics) and case.flow.begins_known:
            alone = copy.deepcopy(case.flow)
            alone.silence()
            found[KNOWN] = recorded(alone)
        if self.beside is not None:
            found[self.beside.name] = exact_flow(self.beside)
        return found | {TWO_BODY: self._two_body}

    def _two_body(self, x: Tensor, dt: TimeStep) -> Tensor:
        mu = self.mu.repeat(len(x) // len(self.mu))
        return kepler(x, torch.as_tensor(dt).to(x).expand(x.shape[:-1]), mu)

    def __call__(self, case: Case) -> Findings:
        """Return rows of the other flows, errors per period, and the periods in which the model is better."""
        measured, ahead = self._measured(case), []
        for name, flow in self.flows(case).items():
            starts = {"true": case.test.states[:, 0], "fitted": fitted_start(flow, measured, case)}
            found = predicted(flow, torch.cat(list(starts.values())), case, case.test.states.shape[1])
            for kind, states in zip(starts, found.chunk(len(starts)), strict=True):
                ahead.append(Ahead(name, kind, states, self.by_period(states, case)))
        others = [one for one in ahead if one.name != case.label]
        rows = [Row(Who(one.name, "true"), case.score(one.states)) for one in others if one.start == "true"]
        first = others[0].name
        nearer = {kind: periods_ahead(ahead, case.label, first, kind) for kind in ("true", "fitted")}
        whole = len(ahead[0].errors)
        beaten = ", ".join(f"{count} of {whole} from the {kind} start" for kind, count in nearer.items())
        note = f"number of {self.unit}s before {first} becomes more accurate than {case.label}: {beaten}"
        numbers: dict[str, Any] = {"nearer": nearer, "unit": self.unit, "errors": {}}
        for one in ahead:
            numbers["errors"].setdefault(one.start, {})[one.name] = one.errors.tolist()
        figures = {"ahead": self._figure(ahead, case)}
        return Findings(rows=rows, numbers=numbers, figures=figures, notes=[note])

    def _measured(self, case: Case) -> Tensor:
        """Return noisy positions of the first samples of each test trajectory, (B, K, 3)."""
        draw = torch.Generator().manual_seed(self.seed)
        positions = case.test.states[:, : self.arc, :3]
        return positions + self.noise * torch.randn(positions.shape, generator=draw, dtype=torch.float64)

    def by_period(self, states: Tensor, case: Case) -> Tensor:
        """Return the rms error of position over all trajectories, for each complete period, (N,)."""
        index = ((case.test.times[0] - case.test.times[0, 0]) / self.period).floor().long()
        error, count = off(states, case), int(index[-1]) + 1
        return torch.stack([error[:, index == k].square().mean().sqrt() for k in range(count)])

    def _figure(self, ahead: list[Ahead], case: Case) -> Figure:
        """Plot rms position errors over time, one panel per kind of start."""
        figure = style.canvas(8, 6.5)
        panels = figure.subplots(2, 1, sharex=True)
        time = (case.test.times[0] - case.test.times[0, 0]) / self.period
        looks = (style.MODEL, style.FLOOR, style.ALONE, {"color": style.SKY, "lw": 1.3})
        for axes, kind in zip(panels, ("fitted", "true"), strict=True):
            for one, look in zip([one for one in ahead if one.start == kind], looks, strict=False):
                error = off(one.states, case).square().mean(0).sqrt()
                axes.plot(time[1:], error[1:], **(look | {"lw": 1.3}), label=one.name)
            style.logarithmic(axes, 24)
            axes.set_ylabel(f"position error [{case.space.units.position}]")
        panels[0].axvspan(0, float(time[self.arc - 1]), color=style.SKY, alpha=0.2, label="fitted to")
        head = f"{case.space.name}: rms over unseen segments"
        panels[0].set_title(f"{head}\nfrom the best-fitting start")
        panels[1].set_title("from the first state of each")
        style.label_time(panels[1], style.Axis(time, self.unit))
        style.legend_below(figure, *panels)
        return figure


def predicted(flow: Flow, starts: Tensor, case: Case, samples: int) -> Tensor:
    """Return predictions (R, K, 6) from starts (R, 6): one or more sets of starts of the B trajectories."""
    turns = len(starts) // len(case.test.times)
    clock = case.test.clock(clock_of(flow))
    rows = torch.arange(len(case.test.times)).repeat(turns)
    return rollout(flow, starts, case.dt, samples, clock=clock and clock.rows(rows))


@torch.no_grad()
def fitted_start(flow: Flow, measured: Tensor, case: Case) -> Tensor:
    """Return the starts (B, 6) from which a flow best fits positions (B, K, 3), by Gauss-Newton steps.

    Iteration begins at the true start, with finite differences. A step that worsens a fit is rejected.
    """
    best = start = case.test.states[:, 0]
    sizes = [part.norm(dim=-1, keepdim=True).expand(-1, 3) for part in start.chunk(2, dim=-1)]
    nudge = NUDGE * torch.cat(sizes, dim=-1)
    least = start.new_full((len(start),), torch.inf)
    for _ in range(ROUNDS):
        beside = start.unsqueeze(0) + torch.diag_embed(nudge).transpose(0, 1)
        together = torch.cat((start.unsqueeze(0), beside)).flatten(0, 1)
        found = predicted(flow, together, case, measured.shape[1])[..., :3].unflatten(0, (7, -1))
        missed = (measured - found[0]).flatten(1)
        slopes = (found[1:] - found[0]).flatten(2).permute(1, 2, 0)
        sums = missed.square().sum(1)
        better = sums < least
        best = torch.where(better.unsqueeze(1), start, best)
        if not bool(((least - sums) > SETTLED * sums).any()):
            break
        least = torch.where(better, sums, least)
        move = torch.linalg.lstsq(slopes.nan_to_num(), missed.nan_to_num().unsqueeze(-1)).solution
        start = torch.where(better.unsqueeze(1), start + nudge * move.squeeze(-1), best)
    return best


def off(states: Tensor, case: Case) -> Tensor:
    """Return the distances between predicted and true positions of the test set, (B, T)."""
    return (states - case.test.states)[..., :3].norm(dim=-1)


def periods_ahead(ahead: list[Ahead], label: str, other: str, start: str) -> int:
    """Return the number of periods before the flow `label` first becomes less accurate than `other`."""
    own, theirs = (one for name in (label, other) for one in ahead if (one.name, one.start) == (name, start))
    return int((own.errors < theirs.errors).long().cumprod(0).sum())
