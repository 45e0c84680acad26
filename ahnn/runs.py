"""Trained model for use in Python, without trainer, optimiser or configuration.

states = ahnn.load("molniya_mechanical").rollout(start, steps=1440)
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import torch
from torch import Tensor

from ahnn.contents import read_plain
from ahnn.deviations import covariance_factor, state_deviations
from ahnn.dynamics import Dynamics, HasEnergy
from ahnn.errors import UserError
from ahnn.numbers import Numbers, as_float64
from ahnn.prediction.arguments import (
    clock_along,
    clock_of_samples,
    lengths_of,
    paths_of,
    starts_of,
    states_of,
)
from ahnn.prediction.followed_path import Knowledge
from ahnn.prediction.propagation import Prediction, predicted, prediction_factors, require_times
from ahnn.rollouts import rollout
from ahnn.types import Space
from ahnn.uncertainty import Domain, Uncertainty, learned_constants, rollout_covariances
from ahnn.uncertainty.posterior import FILE

if TYPE_CHECKING:
    from ahnn.evaluation.results import Results


@dataclass(frozen=True)
class Run:
    """Learned dynamics with the description of their state space.

    Attributes:
        dynamics: the flow, a float64 module without gradients: `run.dynamics(x, dt)`.
        space: names and units of the state components.
        dt: sampling interval of the training data, or the step of the integrator between measurements where
            that is shorter, in the unit of time.
        about: description of the training data, plain values.
        folder: folder of the run, or of the shipped model.
        domain: representative training states; None for weights of an earlier version.
        uncertainty: covariance of the parameters; None unless these weights were trained on measurements.
    """

    dynamics: Dynamics
    space: Space
    dt: float
    about: dict[str, Any]
    folder: Path
    domain: Domain | None = None
    uncertainty: Uncertainty | None = None

    @property
    def trained(self) -> Dynamics:
        """The dynamics before a last step over functions, whose effect parameters cannot express."""
        before = self.uncertainty and self.uncertainty.before
        return before[0] if before else self.dynamics

    def flow(self, x: Numbers, dt: Numbers | None = None) -> Tensor:
        """Propagate states x, shape (..., 2n), over dt, by default one sampling interval.

        Args:
            x: states, in the units of the space.
            dt: one time step, or one for each state, shape (...).

        Raises:
            UserError: invalid states or steps.
        """
        x = states_of(x, "x", self.dynamics, self.space)
        step = lengths_of(self.dt if dt is None else dt, x[..., 0])
        flat = step.flatten() if isinstance(step, Tensor) else step
        return self.dynamics(x.reshape(-1, x.shape[-1]), flat).reshape(x.shape)

    def energy(self, x: Numbers) -> Tensor:
        """Return the learned Hamiltonian, shape (...), at states x, shape (..., 2n), up to a constant.

        Raises:
            UserError: the model has no Hamiltonian.
        """
        if not isinstance(self.dynamics, HasEnergy):
            message = (
                f"energy: expected a model with a Hamiltonian; received one with {self.dynamics.assumes}"
            )
            raise UserError(message)
        return cast(HasEnergy, self.dynamics).energy(states_of(x, "x", self.dynamics, self.space))

    def rollout(
        self,
        start: Numbers,
        steps: int,
        dt: Numbers | None = None,
        *,
        start_time: float = 0.0,
        controls: Numbers | None = None,
    ) -> Tensor:
        """Return predicted trajectories, shape (B, steps + 1, 2n), start included.

        Gradients flow to the start, the steps and the parameters that require them.

        Args:
            start: (B, 2n) or (2n,) states, in the units of the space.
            steps: number of time steps.
            dt: time step, or (B, steps) step lengths; by default the sampling interval of the training data.
            start_time: time of the starts, for forces that depend on time.
            controls: values of each step, (steps, m) or (B, steps, m), for forces that depend on them.

        Raises:
            UserError: invalid starts, steps or controls.
        """
        dt = self.dt if dt is None else dt
        x, steps, lengths = paths_of(start, steps, dt, self.dynamics, self.space)
        given = (x, *self.dynamics.parameters(), *([lengths] if isinstance(lengths, Tensor) else []))
        gradients = torch.is_grad_enabled() and any(tensor.requires_grad for tensor in given)
        clock = clock_along(self.dynamics, lengths, steps, start_time, controls, len(x))
        return rollout(self.dynamics, x, lengths, steps + 1, gradients=gradients, clock=clock)

    def band(self, start: Numbers, steps: int, dt: Numbers | None = None) -> Tensor:
        """Return standard deviations of `rollout` from parameters alone, shape (B, steps + 1, 2n).

        Args:
            start: (B, 2n) or (2n,) states, in the units of the space.
            steps: number of time steps.
            dt: time step, or (B, steps) step lengths; by default the sampling interval of the training data.

        Raises:
            UserError: invalid starts or steps, or an unknown covariance of the parameters.
        """
        if self.uncertainty is None:
            message = (
                f"band: expected {FILE} in {self.folder}, of these weights; received none. Only a "
                "training on measurements writes it, for its best weights"
            )
            raise UserError(message)
        dt = self.dt if dt is None else dt
        x, steps, lengths = paths_of(start, steps, dt, self.dynamics, self.space)
        each = torch.as_tensor(lengths, dtype=x.dtype).expand(len(x), steps)
        covariances = rollout_covariances(self._exact, x.double(), each.double(), self.uncertainty.spread)
        return covariances.diagonal(dim1=-2, dim2=-1).sqrt()

    def novelty(self, x: Numbers) -> Tensor:
        """Return the distance of states x, shape (..., 2n), from the training states, shape (...).

        The distance is measured in the networks' input space and scaled so that one training state in a
        hundred is
        farther than 1 from the representative states.

        Raises:
            UserError: the weights contain no representative training states.
        """
        if self.domain is None:
            message = (
                "novelty: expected weights that describe their training data; received those of an "
                "earlier version. Train again"
            )
            raise UserError(message)
        return self.domain.novelty(self._exact, states_of(x, "x", self.dynamics, self.space).double())

    def predict(
        self,
        start: Numbers,
        times: Numbers,
        description: str | None = None,
        start_sd: Numbers | None = None,
        start_covariance: Numbers | None = None,
        controls: Numbers | None = None,
        *,
        linear: bool = False,
    ) -> Prediction:
        """Return predicted states at given times, with covariance and novelty where available.

        Args:
            start: (B, 2n) or (2n,) states at the first of the times, in the units of the space.
            times: (T,) increasing, in its unit of time; internal steps are at most the training step.
            description: text of the progress bar, or None for no bar.
            start_sd: standard deviations of the starts, 2n, or one for positions and one for velocities where
                n > 1; by default starts are exact.
            start_covariance: alternative to `start_sd`, (2n, 2n) or (B, 2n, 2n).
            controls: values at the times, (T, m) or (B, T, m), each held until the next, for forces that
                depend on them.
            linear: whether controls are interpolated linearly instead.

        Raises:
            UserError: invalid starts, times or controls, or a damaged covariance file.
        """
        x = starts_of(start, self.dynamics, self.space)
        if start_sd is not None:
            start_covariance = state_deviations(start_sd, self.space, "start_sd").square().diag()
        known = self.knowledge(start_covariance)
        times = as_float64(times, "times")
        require_times(times)
        clock = clock_of_samples(self.dynamics, times, controls, len(x), linear=linear)
        return predicted(self._exact, x.double(), times, self.dt, known, description, clock)

    def knowledge(self, start_covariance: Numbers | None = None) -> Knowledge:
        """Return the uncertainty of the parameters, and of starts with a covariance (2n, 2n) or (B, 2n, 2n).

        Raises:
            UserError: an invalid covariance, or a damaged file of that of the parameters.
        """
        spread = None if self.uncertainty is None else self.uncertainty.spread
        if start_covariance is None:
            return Knowledge(spread, self.domain)
        size = 2 * self.space.dof
        return Knowledge(spread, self.domain, covariance_factor(start_covariance, size, "start_covariance"))

    def prediction_factors(
        self, start: Numbers, times: Numbers, start_covariance: Numbers
    ) -> tuple[Tensor, Tensor]:
        """Return predicted states (T, 2n) and factors (T, 2n, R) of their covariances F F^T.

        The columns are the effects of independent causes of unit variance: first the parameters, where their
        uncertainty is known, then the start.

        Args:
            start: (2n,) state at the first of the times.
            times: (T,) increasing.
            start_covariance: (2n, 2n).

        Raises:
            UserError: as `predict`.
        """
        x = starts_of(start, self.dynamics, self.space)[0].double()
        times = as_float64(times, "times")
        return prediction_factors(self._exact, x, times, self.dt, self.knowledge(start_covariance))

    @property
    def constants(self) -> dict[str, tuple[float, float]]:
        """Learned physical constants, such as friction: value and standard deviation.

        The deviation is NaN where the parameter covariance is unknown.
        """
        spread = None if self.uncertainty is None else self.uncertainty.spread
        found = learned_constants(self._exact, spread)
        return {one.name: (one.value, one.deviation) for one in found}

    @cached_property
    def config(self) -> dict[str, Any]:
        """Configuration of the training as plain values; raises UserError if it is missing."""
        return read_plain(self.folder / "config.yaml")

    @cached_property
    def results(self) -> Results:
        """Scores of the evaluation after training, with their floors."""
        from ahnn.evaluation.results import load_results

        return load_results(self.folder)

    @property
    def _exact(self) -> Dynamics:
        """The dynamics in float64, also after a cast by the user."""
        doubles = all(p.dtype == torch.float64 for p in self.dynamics.parameters())
        return self.dynamics if doubles else self.dynamics.frozen()
