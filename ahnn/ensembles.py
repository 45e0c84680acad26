"""Ensembles of trained models: the mixture of their forecasts.

ensemble = ahnn.load_ensemble("runs/spring_ensemble")
ensemble.rollout(start, steps=400), ensemble.band(start, steps=400)
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from ahnn.arguments import checked
from ahnn.dynamics import StackedDynamics
from ahnn.errors import UserError
from ahnn.loading import load, member_folders
from ahnn.numbers import Numbers
from ahnn.prediction import Prediction, together
from ahnn.prediction.arguments import states_of
from ahnn.runs import Run
from ahnn.types import Space, TimeStep
from ahnn.uncertainty import mixture_moments

FAILED = 2.0
"""Multiple of the smallest chi-square of the members above which a member counts as failed."""
STATES = 1000
"""Approximate number of training states over which the process noise is averaged."""

log = logging.getLogger("ahnn")


def require_same_states(runs: Sequence[Run]) -> None:
    """Raise UserError for runs whose states or units differ."""
    first = runs[0].space._replace(name="")
    for other in runs[1:]:
        if (space := other.space._replace(name="")) != first:
            expected = "runs with the same state components and units"
            message = f"run: expected {expected}; received {first} and {space}"
            raise UserError(message)


def failed_members(runs: Sequence[Run]) -> list[Run]:
    """Return the members whose chi-square, if known, exceeds `FAILED` times the smallest."""
    found = [(run, float(run.uncertainty.about["chi_square"])) for run in runs if run.uncertainty is not None]
    least = min((one for _, one in found), default=0.0)
    return [run for run, one in found if one > FAILED * least]


@dataclass(frozen=True, eq=False, repr=False)
class Ensemble:
    """Trained models of one system as an equally weighted mixture.

    If all members have a covariance of their parameters, each is a normal distribution about its forecast,
    otherwise a point. The covariance of the mixture is that of the forecasts, plus the mean of the members'
    covariances.

    Attributes:
        runs: the members.
    """

    runs: tuple[Run, ...]

    def __post_init__(self) -> None:
        """Check that the members have the same states; raises UserError."""
        if len(self.runs) < 2:
            message = f"runs: expected two or more members of an ensemble; received {len(self.runs)}"
            raise UserError(message)
        require_same_states(self.runs)

    def __repr__(self) -> str:
        return f"Ensemble({len(self.runs)} members, {self.runs[0]!r} and others)"

    @property
    def space(self) -> Space:
        """Names and units of the state components."""
        return self.runs[0].space

    @property
    def dt(self) -> float:
        """Sampling interval of the training data, in the unit of time."""
        return self.runs[0].dt

    def rollouts(self, start: Numbers, steps: int, dt: Numbers | None = None) -> Tensor:
        """Return the predicted trajectories of the S members, shape (S, B, steps + 1, 2n).

        Args:
            start: (B, 2n) or (2n,) states, in the units of the space.
            steps: number of time steps.
            dt: time step, or (B, steps) step lengths; by default the sampling interval of the training data.

        Raises:
            UserError: invalid starts or steps.
        """
        step = self.dt if dt is None else dt
        return torch.stack([run.rollout(start, steps, step) for run in self.runs])

    def rollout(self, start: Numbers, steps: int, dt: Numbers | None = None) -> Tensor:
        """Return the mean of `rollouts`, shape (B, steps + 1, 2n); arguments and errors are the same."""
        return self.rollouts(start, steps, dt).mean(0)

    def band(self, start: Numbers, steps: int, dt: Numbers | None = None) -> Tensor:
        """Return the standard deviations of the mixture, shape (B, steps + 1, 2n), for exact starts.

        Arguments and errors are those of `rollouts`.
        """
        step = self.dt if dt is None else dt
        _, covariance = mixture_moments(self.rollouts(start, steps, step))
        variance = covariance.diagonal(dim1=-2, dim2=-1)
        if all(run.uncertainty is not None for run in self.runs):
            variance = variance + torch.stack(
                [run.band(start, steps, step) for run in self.runs]
            ).square().mean(0)
        return variance.sqrt()

    def predict(self, start: Numbers, times: Numbers, **options: object) -> Prediction:
        """Return the mean of the members' predictions, with the covariance of the mixture.

        Args:
            start: (B, 2n) or (2n,) states at the first of the times, in the units of the space.
            times: (T,) increasing, in the unit of time of the space.
            options: further arguments of `Run.predict`.

        Raises:
            UserError: as for `Run.predict`.
        """
        return together([run.predict(start, times, **options) for run in self.runs])  # pyright: ignore[reportArgumentType]

    def flow(self, x: Numbers, dt: TimeStep | None = None) -> Tensor:
        """Return the mean of the members' states after dt, shape (B, 2n), from states x, shape (B, 2n).

        Args:
            x: states, in the units of the space.
            dt: one time step, or one for each state, (B,); by default one sampling interval.

        Raises:
            UserError: invalid states.
        """
        state = states_of(x, "x", self.runs[0].dynamics, self.space)
        return self._after(state, self.dt if dt is None else dt).mean(0)

    @torch.no_grad()
    def process_noise(self, dt: float | None = None, states: Numbers | None = None) -> Tensor:
        """Return the covariance (2n, 2n) of the members' increments over one step, averaged over states.

        It is the Q of a filter with `flow` as process model and errors like those of the members, independent
        in each step.

        Args:
            dt: time step; by default one sampling interval.
            states: (B, 2n); by default representative training states.

        Raises:
            UserError: invalid states, or none given and no training states known.
        """
        first = self.runs[0]
        if states is None and first.domain is None:
            message = (
                "states: expected states (B, 2n), since the weights contain no training states; received none"
            )
            raise UserError(message)
        given = first.domain.states if states is None and first.domain is not None else states
        assert given is not None
        x = states_of(given, "states", first.dynamics, self.space)
        x = x[:: max(1, len(x) // STATES)]
        _, covariance = mixture_moments(self._after(x, self.dt if dt is None else dt))
        return covariance.mean(0)

    def _after(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the states of each member after dt, (S, B, 2n)."""
        stacked = StackedDynamics([run.dynamics for run in self.runs])
        count = len(self.runs)
        steps = dt.repeat(count) if isinstance(dt, torch.Tensor) and dt.ndim else dt
        return stacked(x.repeat(count, 1), steps).unflatten(0, (count, -1))


@checked
def load_ensemble(run: str | Path | list[str], ckpt: str = "best") -> Ensemble:
    """Load the members of an ensemble, with a warning that names members whose training failed.

    Args:
        run: folder of a training with `members` or `seeds`, or several run folders.
        ckpt: `best` or `last`.

    Raises:
        UserError: a folder without members, or members with different states.
    """
    folders = [Path(one) for one in run] if isinstance(run, list) else member_folders(Path(run))
    if not folders:
        message = f"run: expected a folder of a training with members= or seeds=; received {str(run)!r}"
        raise UserError(message)
    found = Ensemble(tuple(load(folder, ckpt) for folder in folders))
    if failed := failed_members(found.runs):
        names = ", ".join(str(one.folder) for one in failed)
        log.warning(
            "ensemble: the chi-square of %s is more than twice the smallest, which widens the bands; to "
            "leave such members out, pass a list of the other run folders",
            names,
        )
    return found
