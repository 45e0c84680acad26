"""A trained model in Python: `load` returns what was learned, without trainer, optimiser or configuration.

run = ahnn.load("molniya_mechanical")  # or a run folder
states = run.rollout(start, steps=1440)
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import torch
from torch import Tensor

from ahnn.arguments import checked, flatten
from ahnn.checkpoints import Weights, read_weights
from ahnn.contents import read_plain
from ahnn.deviations import covariance_factor, state_deviations
from ahnn.dynamics import Dynamics, HasEnergy, make_dynamics
from ahnn.dynamics.sizes import fillable
from ahnn.errors import UserError
from ahnn.numbers import Numbers, as_float64
from ahnn.prediction.arguments import clock_along, lengths_of, paths_of, starts_of, states_of
from ahnn.prediction.kernel import Knowledge, Prediction, predicted
from ahnn.pretrained import names, shipped
from ahnn.rollouts import rollout
from ahnn.stored import read_about
from ahnn.types import Space
from ahnn.uncertainty import Domain, Uncertainty, domain_of, load_uncertainty, rollout_covariances
from ahnn.uncertainty.posterior import FILE

if TYPE_CHECKING:
    from ahnn.evaluation.results import Results


log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Run:
    """Learned dynamics with what their numbers mean.

    Attributes:
        dynamics: the flow, a float64 module without gradients: `run.dynamics(x, dt)`.
        space: names and units of the state components.
        dt: sampling interval of the training data, or the step of the integrator between measurements where
            that is shorter, in the unit of time.
        about: what the weights were trained on, plain values.
        folder: of the run, or of the shipped model.
        domain: training states that stand for all; None beside weights of an earlier version.
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
        """The dynamics without a last step of functions, which parameters cannot follow."""
        before = self.uncertainty and self.uncertainty.before
        return before[0] if before else self.dynamics

    def flow(self, x: Numbers, dt: Numbers | None = None) -> Tensor:
        """Return the states (..., 2n) that x, shape (..., 2n), reaches after dt, or a sampling interval.

        Args:
            x: states, in the units of the space.
            dt: one time step, or one for each state, shape (...).

        Raises:
            UserError: states or steps that are none.
        """
        x = states_of(x, "x", self.dynamics, self.space)
        step = lengths_of(self.dt if dt is None else dt, x[..., 0])
        flat = step.flatten() if isinstance(step, Tensor) else step
        return self.dynamics(x.reshape(-1, x.shape[-1]), flat).reshape(x.shape)

    def energy(self, x: Numbers) -> Tensor:
        """Return the learned Hamiltonian, shape (...), at the states x, shape (..., 2n); a constant is free.

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
            dt: time step, or the length of each, (B, steps); the sampling interval of the training data if
                None.
            start_time: of the starts, for forces that depend on time.
            controls: held in each step, (steps, m) or (B, steps, m), for forces that depend on them.

        Raises:
            UserError: starts, steps or controls that are none.
        """
        dt = self.dt if dt is None else dt
        x, steps, lengths = paths_of(start, steps, dt, self.dynamics, self.space)
        given = (x, *self.dynamics.parameters(), *([lengths] if isinstance(lengths, Tensor) else []))
        gradients = torch.is_grad_enabled() and any(tensor.requires_grad for tensor in given)
        clock = clock_along(self.dynamics, lengths, steps, start_time, controls)
        return rollout(self.dynamics, x, lengths, steps + 1, gradients=gradients, clock=clock)

    def band(self, start: Numbers, steps: int, dt: Numbers | None = None) -> Tensor:
        """Return standard deviations of `rollout`, shape (B, steps + 1, 2n), for exactly known starts.

        Args:
            start: (B, 2n) or (2n,) states, in the units of the space.
            steps: number of time steps.
            dt: time step, or the length of each, (B, steps); the sampling interval of the training data if
                None.

        Raises:
            UserError: starts or steps that are none, or the covariance of the parameters is not known.
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
        """Return how far states x, shape (..., 2n), are from those of the training, shape (...).

        The distance is measured in what the networks see; one training state in a hundred is farther than 1
        from those that stand for all.

        Raises:
            UserError: the weights do not say where their training data were.
        """
        if self.domain is None:
            message = (
                "novelty: expected weights that say where their training data were; received those of an "
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
    ) -> Prediction:
        """Return predicted states at given times, with covariance and novelty where they are known.

        Args:
            start: (B, 2n) or (2n,) states at the first of the times, in the units of the space.
            times: (T,) increasing, in its unit of time; steps are at most that of the training.
            description: text of a progress bar; None shows none.
            start_sd: standard deviations of the starts, 2n, or one for positions and one for velocities
                where n > 1; without them starts are exact.
            start_covariance: in their place, (2n, 2n) or (B, 2n, 2n).

        Raises:
            UserError: starts or times that are none, or a damaged file beside the weights.
        """
        x = starts_of(start, self.dynamics, self.space)
        spread = None if self.uncertainty is None else self.uncertainty.spread
        known = Knowledge(spread, self.domain)
        if start_sd is not None:
            start_covariance = state_deviations(start_sd, self.space, "start_sd").square().diag()
        if start_covariance is not None:
            factor = covariance_factor(start_covariance, x.shape[-1], "start_covariance")
            known = known._replace(start=factor)
        times = as_float64(times, "times")
        return predicted(self._exact, x.double(), times, self.dt, known, description)

    @cached_property
    def config(self) -> dict[str, Any]:
        """Configuration of the training, plain values; raises UserError where there is none."""
        return read_plain(self.folder / "config.yaml")

    @cached_property
    def results(self) -> Results:
        """Scores of the evaluation that followed the training, beside their floors."""
        from ahnn.evaluation.results import load_results

        return load_results(self.folder)

    @property
    def _exact(self) -> Dynamics:
        """The dynamics in float64, where a user has cast them."""
        doubles = all(p.dtype == torch.float64 for p in self.dynamics.parameters())
        return self.dynamics if doubles else self.dynamics.frozen()


@checked
def load(run: str | Path, ckpt: str = "best") -> Run:
    """Return a trained model.

    Args:
        run: a run folder, or the name of a model that comes with the package.
        ckpt: `best`, `last`, or the path of a checkpoint.

    Raises:
        UserError: there is no such run, or its weights or their covariance are damaged.
    """
    folder = Path(run)
    if not folder.exists() and str(run) in names():
        folder = shipped(str(run))
    if not folder.is_dir():
        message = f"run: expected a run folder or one of {', '.join(names())}; received {str(run)!r}"
        raise UserError(message)
    path = weights_path(folder, ckpt)
    weights = read_weights(path)
    if ckpt == "best" and path.stem == "last":
        require_last(folder, weights.about)
    trained = made(weights, folder)
    known = load_uncertainty(folder, trained.dynamics.state_dict())
    if known is None:
        return trained
    count, received = sum(p.numel() for p in trained.dynamics.parameters()), len(known.offset)
    if count != received:
        message = f"{folder / FILE}: expected a covariance of {count} parameters; received {received}"
        raise UserError(message)
    dynamics, uncertainty = known.taken(trained.dynamics)
    return replace(trained, dynamics=dynamics.eval().requires_grad_(False), uncertainty=uncertainty)


def weights_path(folder: Path, ckpt: str = "best") -> Path:
    """Return the file of a run's weights.

    Args:
        folder: of the run.
        ckpt: `best` (the last ones where nothing chose the best), `last`, or a path.
    """
    if ckpt not in ("best", "last"):
        return Path(ckpt)
    here = folder / "checkpoints"
    candidates = [here / f"{ckpt}.ckpt", folder / "weights.safetensors"]
    if ckpt == "best":
        candidates.append(here / "last.ckpt")
    return next((path for path in candidates if path.exists()), candidates[0])


def require_last(folder: Path, about: dict[str, Any]) -> None:
    """Say that the last weights are taken for the best, where no validation has chosen any.

    Raises:
        UserError: some were chosen, and are missing.
    """
    monitor = flatten(about).get("settings.callbacks.best.monitor")
    if monitor is not None and about.get("val_loss") is not None:
        message = (
            f"run {folder}: expected checkpoints/best.ckpt, the weights of the smallest {monitor}; received "
            "none. ckpt=last takes the last weights"
        )
        raise UserError(message)
    log.warning("run %s: no validation chose the best weights; the last ones are taken", folder)


def made(weights: Weights, folder: Path) -> Run:
    """Return the run of some weights.

    Raises:
        UserError: they do not say what they are, or are of other dynamics.
    """
    about, space = read_about(f"run {folder}: weights", weights.about)
    try:
        with fillable(weights.state):
            dynamics = make_dynamics(**about.dynamics)
        domain = domain_of(weights.about, len(space.components))
    except Exception as error:  # whatever the class of a package says of arguments that are none
        reason = error if isinstance(error, UserError) else repr(error)
        message = f"run {folder}: expected weights that say what they are; received: {reason}"
        raise UserError(message) from error
    try:
        dynamics.double().load_state_dict(weights.state)
    except RuntimeError as error:
        reason = " ".join(str(error).split())
        message = f"run {folder}: expected the weights of its model; received others ({reason})"
        raise UserError(message) from error
    if not all(bool(tensor.isfinite().all()) for tensor in weights.state.values()):
        message = f"run {folder}: expected finite weights; received nan or inf. Take another checkpoint"
        raise UserError(message)
    return Run(dynamics.eval().requires_grad_(False), space, about.dt, weights.about, folder, domain)
