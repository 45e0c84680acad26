"""Prediction horizon of a learned flow compared with analytic ones: daily errors from equal starts."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple, final

import torch
from matplotlib.figure import Figure
from torch import Tensor

from ahnn.arguments import Count, Positive, Seed, checked
from ahnn.errors import UserError
from ahnn.evaluation import Case, Findings, Row, Who, style
from ahnn.jacobians import step_jacobians
from ahnn.measurements import Instrument, Position, Segment
from ahnn.measurements.smoothing import guess
from ahnn.rollouts import rollout
from ahnn.shooting.initial_states import Trial, fit_starts
from ahnn.shooting.path_sensitivities import steps_between
from ahnn.shooting.robust import ROBUST
from ahnn.systems import Molniya, System, exact_flow
from ahnn.types import Flow, Space
from ahnn_plugins.demonstrations.two_body import kepler

DAY = 86400.0
TWO_BODY = "two-body"


class Ahead(NamedTuple):
    """Prediction of the test trajectories.

    Attributes:
        name: name of the flow.
        start: `true`, or `fitted` to the first positions.
        states: (B, T, D) predicted states.
        daily: (N,) rms error of position over all trajectories, by day.
    """

    name: str
    start: str
    states: Tensor
    daily: Tensor


@final
@checked
class Horizon:
    """Comparison of a learned flow with that of an oblate planet, and with two-body motion.

    Each flow predicts the test trajectories twice: from their first state, and from the initial state that
    best fits noisy positions of their first samples.

    Args:
        beside: system of the oblate planet.
        arc: number of samples for fits of initial states.
        noise: standard deviation of their positions.
        seed: seed of that noise.
    """

    def __init__(self, beside: Molniya, arc: Count, noise: Positive, seed: Seed) -> None:
        self.beside, self.arc, self.noise, self.seed = beside, arc, noise, seed

    def check(self, truth: System | None, space: Space, steps: int) -> None:
        """Raise UserError for data in other units, or too short ones."""
        del truth
        if space.units != self.beside.units:
            message = f"beside: expected data in {self.beside.units}; received {space.units}"
            raise UserError(message)
        if not 6 <= self.arc <= steps:
            message = f"arc: expected from 6 to {steps} samples, those of a trajectory; received {self.arc}"
            raise UserError(message)

    def __call__(self, case: Case) -> Findings:
        """Return the rows of the analytic flows, daily errors, and the number of days won by the model."""
        mu = self.beside.mu
        flows: dict[str, Flow] = {
            case.label: case.flow,
            self.beside.name: exact_flow(self.beside),
            TWO_BODY: lambda x, dt: kepler(x, torch.as_tensor(dt).to(x).expand(x.shape[:-1]), mu),
        }
        segment, ahead = self._segment(case), []
        for name, flow in flows.items():
            starts = {"true": case.test.states[:, 0], "fitted": fitted_start(flow, segment)}
            for kind, start in starts.items():
                states = rollout(flow, start, case.dt, case.test.states.shape[1], f"{name}, {kind} start")
                ahead.append(Ahead(name, kind, states, daily(states, case)))
        rows = [
            Row(Who(one.name, "true"), case.score(one.states))
            for one in ahead
            if one.start == "true" and one.name != case.label
        ]
        days = {kind: days_ahead(ahead, case.label, self.beside.name, kind) for kind in ("true", "fitted")}
        known = len(ahead[0].daily)
        beaten = ", ".join(f"{count} of {known} from the {kind} start" for kind, count in days.items())
        note = f"days, from the first on, on which {case.label} is nearer: {beaten}"
        numbers: dict[str, Any] = {"days": days, "daily": {}}
        for one in ahead:
            numbers["daily"].setdefault(one.start, {})[one.name] = one.daily.tolist()
        figures = {"ahead": self._figure(ahead, case)}
        return Findings(rows=rows, numbers=numbers, figures=figures, notes=[note])

    def _segment(self, case: Case) -> Segment:
        """Return noisy positions of the first samples of each test trajectory."""
        draw = torch.Generator().manual_seed(self.seed)
        positions, times = case.test.states[:, : self.arc, :3], case.test.times[:, : self.arc]
        noise = self.noise * torch.randn(positions.shape, generator=draw, dtype=torch.float64)
        deviations = torch.full((3,), self.noise, dtype=torch.float64)
        longest = float(times.diff(dim=1).max())
        instrument = Instrument(Position(), deviations, longest, 3, case.space.factor)
        return Segment(positions + noise, times, instrument)

    def _figure(self, ahead: list[Ahead], case: Case) -> Figure:
        """Plot rms position errors over time, one panel per kind of start."""
        figure = style.canvas(8, 6.5)
        panels = figure.subplots(2, 1, sharex=True)
        time = (case.test.times[0] - case.test.times[0, 0]) / DAY
        looks = (style.MODEL, style.FLOOR, style.ALONE)
        for axes, kind in zip(panels, ("fitted", "true"), strict=True):
            for one, look in zip([one for one in ahead if one.start == kind], looks, strict=True):
                error = off(one.states, case).square().mean(0).sqrt()
                axes.plot(time[1:], error[1:], **(look | {"lw": 1.3}), label=one.name)
            style.logarithmic(axes, 24)
            axes.set_ylabel(f"position error [{case.space.units.position}]")
        panels[0].axvspan(0, float(time[self.arc - 1]), color=style.SKY, alpha=0.2, label="fitted to")
        head = f"{case.space.name}: rms over unseen stretches"
        panels[0].set_title(f"{head}\nfrom the start that fits the first positions best")
        panels[1].set_title("from the first state of each")
        style.label_time(panels[1], style.Axis(time, "d"))
        style.legend_below(figure, *panels)
        return figure


@torch.no_grad()
def fitted_start(flow: Flow, segment: Segment) -> Tensor:
    """Fit the initial states (B, 6) of a flow to measurements."""

    def increment(x: Tensor, dt: Tensor) -> Tensor:
        return flow(x, dt) - x

    steps = steps_between(segment.times, segment.instrument.longest)
    trial = Trial(increment, partial(step_jacobians, increment), ROBUST["none"])
    return fit_starts(trial, guess(segment), segment, steps).starts


def off(states: Tensor, case: Case) -> Tensor:
    """Return the distances of predicted positions from those of the test, (B, T)."""
    return (states - case.test.states)[..., :3].norm(dim=-1)


def daily(states: Tensor, case: Case) -> Tensor:
    """Return the rms error of position over all trajectories, for each whole day, (N,)."""
    day = ((case.test.times[0] - case.test.times[0, 0]) / DAY).floor().long()
    error, count = off(states, case), int(day[-1]) + 1
    return torch.stack([error[:, day == k].square().mean().sqrt() for k in range(count)])


def days_ahead(ahead: list[Ahead], label: str, other: str, start: str) -> int:
    """Return the number of initial days on which a flow is more accurate than another."""
    own, theirs = (one for name in (label, other) for one in ahead if (one.name, one.start) == (name, start))
    return int((own.daily < theirs.daily).long().cumprod(0).sum())
