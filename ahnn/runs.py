"""Trained model for use in Python, without trainer, optimiser or configuration.

states = ahnn.load("molniya_mechanical").rollout(start, steps=1440)
"""

from __future__ import annotations

import copy
import html
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import torch
from torch import Tensor

from ahnn.contents import read_plain
from ahnn.deviations import covariance_factor, state_deviations
from ahnn.dynamics import Dynamics, HasEnergy
from ahnn.errors import UserError
from ahnn.labels import duration
from ahnn.numbers import Numbers, as_float64, require_precision
from ahnn.prediction.arguments import clock_along, lengths_of, paths_of, sample_clock, starts_of, states_of
from ahnn.prediction.followed_path import Knowledge
from ahnn.prediction.propagation import Prediction, predicted, require_times
from ahnn.rollouts import rollout, stepped
from ahnn.substeps import longest_part, substeps
from ahnn.types import Space
from ahnn.uncertainty import Domain, Uncertainty, learned_constants, rollout_covariances
from ahnn.uncertainty.posterior import FILE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ahnn.evaluation.results import Results


@dataclass(frozen=True, eq=False, repr=False)
class Run:
    """Learned dynamics with the description of their state space.

    Runs are copied and pickled like any object. Notebooks show the table of scores.

    Attributes:
        dynamics: the flow, a float64 module without gradients: `run.dynamics(x, dt)`.
        space: names and units of the state components.
        dt: sampling interval of the training data, or the step of the integrator between measurements if that
            is shorter, in the unit of time.
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

    def __repr__(self) -> str:
        count = sum(p.numel() for p in self.dynamics.parameters())
        what = f"{self.space.name}: {self.dynamics.assumes}; {count} parameters"
        return f"Run({what}, dt={duration(self.dt, self.space)}, folder={str(self.folder)!r})"

    def _repr_html_(self) -> str:
        scored = (self.folder / "metrics.json").is_file()
        scores = self.results._repr_html_() if scored else "<p>no scores</p>"  # pyright: ignore[reportPrivateUsage]
        return f"<p><code>{html.escape(repr(self))}</code></p>{scores}"

    def to(self, device: torch.device | str | None = None, dtype: torch.dtype | None = None) -> Run:
        """Return a copy of the run on a device and with parameters of a dtype, float32 or float64.

        `flow`, `energy` and `rollout` compute in it; `predict`, `band` and `novelty` always in float64.
        """
        require_precision(dtype)
        return replace(
            self,
            dynamics=copy.deepcopy(self.dynamics).to(device=device, dtype=dtype),
            domain=self.domain and self.domain._replace(states=self.domain.states.to(device)),
            uncertainty=self.uncertainty and self.uncertainty.to(device),
        )

    @property
    def trained(self) -> Dynamics:
        """The dynamics before the final step in function space, which parameters cannot express."""
        before = self.uncertainty and self.uncertainty.before
        return before or self.dynamics

    def flow(self, x: Numbers, dt: Numbers | None = None) -> Tensor:
        """Propagate states x, shape (..., 2n), over dt, by default one sampling interval.

        Args:
            x: states, in the units of the space.
            dt: one time step, or one for each state, shape (...); long ones are divided, as in `rollout`.

        Raises:
            UserError: invalid states or steps.
        """
        x = states_of(x, "x", self.dynamics, self.space)
        step = lengths_of(self.dt if dt is None else dt, x[..., 0])
        flat = step.flatten() if isinstance(step, Tensor) else step
        parts = substeps(step, longest_part(step, self.dt))
        return stepped(self.dynamics, x.reshape(-1, x.shape[-1]), flat, parts=parts).reshape(x.shape)

    def energy(self, x: Numbers) -> Tensor:
        """Return the learned Hamiltonian, shape (...), at states x, shape (..., 2n), up to a constant.

        Raises:
            UserError: the model has no Hamiltonian.
        """
        if not isinstance(self.dynamics, HasEnergy):
            message = f"energy: expected a Hamiltonian; received a model with {self.dynamics.assumes}"
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
        """Return predicted trajectories, shape (B, steps + 1, 2n), including the start.

        Gradients flow to the start, the steps and the parameters that require them.

        Args:
            start: (B, 2n) or (2n,) states, in the units of the space.
            steps: number of time steps.
            dt: time step, or (B, steps) step lengths; by default the sampling interval of the training data.
                If a step is 1.5 times as long, steps are divided into parts that are no longer.
            start_time: time of the starts, for forces that depend on time.
            controls: values of each step, (steps, m) or (B, steps, m), for forces that depend on them.

        Raises:
            UserError: invalid starts, steps or controls.
        """
        dt = self.dt if dt is None else dt
        x, steps, lengths = paths_of(start, steps, dt, self.dynamics, self.space)
        gradients = self._asked(x, lengths)
        clock = clock_along(self.dynamics, lengths, steps, start_time, controls, len(x))
        longest = longest_part(lengths, self.dt)
        return rollout(self.dynamics, x, lengths, steps + 1, None, longest, gradients=gradients, clock=clock)

    def band(self, start: Numbers, steps: int, dt: Numbers | None = None) -> Tensor:
        """Return standard deviations of `rollout` from parameters only, shape (B, steps + 1, 2n).

        Args:
            start: (B, 2n) or (2n,) states, in the units of the space.
            steps: number of time steps.
            dt: time step, or (B, steps) step lengths; by default the sampling interval of the training data.

        Raises:
            UserError: invalid starts or steps, or an unknown covariance of the parameters.
        """
        if self.uncertainty is None:
            message = (
                f"band: expected {FILE} of these weights in {self.folder}; received none. It is written only "
                "by training on measurements, for the best weights"
            )
            raise UserError(message)
        dt = self.dt if dt is None else dt
        x, steps, lengths = paths_of(start, steps, dt, self.dynamics, self.space)
        parts = substeps(lengths, longest_part(lengths, self.dt))
        each = torch.as_tensor(lengths, dtype=torch.float64).expand(len(x), steps)
        each = each.repeat_interleave(parts, dim=1) / parts
        covariances = rollout_covariances(self._exact, x.double(), each, self.uncertainty.spread)
        return covariances[:, ::parts].diagonal(dim1=-2, dim2=-1).sqrt()

    def novelty(self, x: Numbers) -> Tensor:
        """Return the distance of states x, shape (..., 2n), from the training states, shape (...).

        Distances are between network inputs, scaled so that one training state in a hundred is beyond 1.

        Raises:
            UserError: the weights contain no representative training states.
        """
        if self.domain is None:
            message = "novelty: expected weights with their training domain; received none. Train again"
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
        samples: int = 0,
    ) -> Prediction:
        """Return predicted states at given times, with covariance and novelty if available.

        Gradients of the states flow to the start and the parameters that require them; covariance and novelty
        are not differentiable.

        Args:
            start: (B, 2n) or (2n,) states at the first of the times, in the units of the space.
            times: (T,) increasing, in the space's unit of time; internal steps are at most the training step.
            description: text of the progress bar; None: no bar.
            start_sd: standard deviations of the starts, 2n, or one for positions and one for velocities if
                n > 1; by default starts are exact.
            start_covariance: alternative to `start_sd`, (2n, 2n) or (B, 2n, 2n).
            controls: values at the times, (T, m) or (B, T, m), each held until the next, for forces that
                depend on them.
            linear: whether controls are interpolated linearly instead.
            samples: number of paths with random starts and parameters, whose means and covariances replace
                those of first order; 0: none.

        Raises:
            UserError: invalid starts, times, controls or samples, or a damaged covariance file.
        """
        x = starts_of(start, self.dynamics, self.space)
        if start_sd is not None:
            start_covariance = state_deviations(start_sd, self.space, "start_sd").square().diag()
        known = self.knowledge(start_covariance)
        times = as_float64(times, "times", x.device).detach()
        require_times(times)
        clock = sample_clock(self.dynamics, times, controls, len(x), linear=linear)
        found = predicted(self._exact, x.double(), times, self.dt, known, description, clock, samples)
        if self._asked(x):
            each = times.diff().to(x).expand(len(x), -1)
            path = rollout(self.dynamics, x, each, len(times), longest=self.dt, gradients=True, clock=clock)
            found = found._replace(states=path.double())
        return found

    def plot(self, start: Numbers | None = None, times: Numbers | None = None, **options: Any) -> Figure:
        """Plot one predicted trajectory, with its band and novelty if known, as a matplotlib figure.

        Args:
            start: (2n,) state at the first of the times; by default a training state.
            times: (T,) increasing; by default 300 sampling intervals.
            options: further arguments of `predict`, which raises the same errors.

        Raises:
            UserError: several starts, or no start and no known training states.
        """
        from ahnn.prediction.figure import PLOTTED, prediction_figure

        start = self.domain.states[0] if start is None and self.domain else start
        if start is None or len(starts_of(start, self.dynamics, self.space)) != 1:
            message = "start: expected one state of the space; received none or several"
            raise UserError(message)
        with torch.no_grad():
            times = self.dt * torch.arange(PLOTTED + 1) if times is None else times
            found = self.predict(start, times, **options)
        return prediction_figure(found, self.space, f"{self.space.name}: {self.dynamics.assumes}")

    def knowledge(self, start_covariance: Numbers | None = None) -> Knowledge:
        """Return the uncertainty of the parameters, and of starts with a covariance (2n, 2n) or (B, 2n, 2n).

        Raises:
            UserError: an invalid covariance, or a damaged file of the parameters' covariance.
        """
        known = Knowledge(self.uncertainty and self.uncertainty.spread, self.domain)
        if start_covariance is None:
            return known
        factor = covariance_factor(start_covariance, 2 * self.space.dof, "start_covariance")
        return known._replace(start=factor)

    @property
    def constants(self) -> dict[str, tuple[float, float]]:
        """Learned physical constants, such as friction: value and standard deviation.

        The deviation is NaN if the parameter covariance is unknown.
        """
        found = learned_constants(self._exact, self.knowledge().spread)
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

    def _asked(self, *given: Tensor | float) -> bool:
        """Return whether a start, a step or a parameter requires gradients."""
        tensors = (one for one in (*given, *self.dynamics.parameters()) if isinstance(one, Tensor))
        return torch.is_grad_enabled() and any(one.requires_grad for one in tensors)

    @property
    def _exact(self) -> Dynamics:
        """The dynamics in float64, even after a cast by the user."""
        narrow = any(p.dtype != torch.float64 for p in self.dynamics.parameters())
        return self.dynamics.frozen() if narrow else self.dynamics
