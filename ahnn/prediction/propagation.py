"""Propagation of starts to given times, with covariance and novelty.

The covariance is that of `ahnn.uncertainty.rollout_covariances`, including the uncertainty of the start, and
is propagated in segments so that any duration fits into memory. Outside the training data, the sensitivity of
the field to its parameters is multiplied by `growth`: the error of a learned force grows there faster than
its parameter covariance implies.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple, cast

import torch
from torch import Tensor
from torch.nn.functional import pad
from torch.nn.utils import parameters_to_vector

from ahnn.clock import Clock, extended, reduced_jacobians
from ahnn.deviations import require_finite
from ahnn.dynamics import Dynamics, HasField
from ahnn.dynamics.derivatives import field_jacobian
from ahnn.dynamics.variations import own_jacobians
from ahnn.errors import TrainingError, UserError
from ahnn.memory import require_memory
from ahnn.progress import track
from ahnn.rollouts import stepped
from ahnn.shooting.path_sensitivities import Steps, in_quarters, path, sensitivities, steps_between
from ahnn.shooting.quadrature import coarse
from ahnn.types import in_short
from ahnn.uncertainty import Domain, growth

CELLS = 4e6
"""Size limit of the largest sensitivity tensor; longer paths are propagated in segments."""

TOGETHER = 2_000
"""Number of states per segment, after which the progress bar is updated."""


class Prediction(NamedTuple):
    """Predicted trajectories.

    Attributes:
        times: (T,) times, the first that of the starts.
        states: (B, T, D) predicted states.
        covariances: (B, T, D, D) covariances, or None if unknown.
        novelty: (B, T) distance from the training data, scaled to 1 at its edge; None if unknown.
    """

    times: Tensor
    states: Tensor
    covariances: Tensor | None = None
    novelty: Tensor | None = None

    def __repr__(self) -> str:
        return in_short(self)

    @property
    def deviations(self) -> Tensor | None:
        """Standard deviations of the states, (B, T, D)."""
        return None if self.covariances is None else self.covariances.diagonal(dim1=-2, dim2=-1).sqrt()

    def at(self, chosen: Tensor, times: Tensor) -> Prediction:
        """Return selected samples, (K,), with given times."""
        return Prediction(times, *(None if part is None else part[:, chosen] for part in self[1:]))  # pyright: ignore[reportArgumentType]


class Knowledge(NamedTuple):
    """Uncertainty information on learned dynamics and starts.

    Attributes:
        spread: factor (P, R) of the covariance of the parameters, or None.
        domain: training domain, or None.
        start: factor (D, D) or (B, D, D) of the covariance of the starts, or None for exact starts.
    """

    spread: Tensor | None = None
    domain: Domain | None = None
    start: Tensor | None = None

    @property
    def columns(self) -> int:
        """Number of columns of the factor of a state's covariance; 0 if unknown."""
        of_starts = 0 if self.start is None else self.start.shape[-1]
        return of_starts + (0 if self.spread is None else self.spread.shape[1])


@torch.no_grad()
def predicted(
    dynamics: Dynamics,
    start: Tensor,
    times: Tensor,
    longest: float,
    known: Knowledge = Knowledge(),  # noqa: B008 - a tuple
    description: str | None = None,
    clock: Clock | None = None,
) -> Prediction:
    """Predict states at given times.

    Args:
        dynamics: float64 dynamics.
        start: (B, D) states at the first of the times.
        times: (T,) increasing.
        longest: maximum integrator step; intervals are divided into the fewest equal steps.
        known: uncertainty information.
        description: text of the progress bar, or None for no bar.
        clock: time and controls at the times, (T, k) or (B, T, k); None for autonomous dynamics.

    Raises:
        UserError: starts that are not finite, times that do not increase, or insufficient memory.
    """
    require_times(times)
    require_finite(start)
    (count, size), samples = start.shape, len(times)
    numbers = count * samples * size * (size + 3) + float(times[-1] - times[0]) / longest
    require_memory("times", "predicted states", 8.0 * numbers)
    steps = steps_between(times.unsqueeze(0), longest)
    quartered = known.spread is not None and needs_quarters(dynamics, start, steps)
    wanted = torch.zeros(int(steps.ends[-1]) + 1, dtype=torch.bool)
    wanted[steps.ends] = True
    cells = count * size * max(known.columns, 1) * (4 if quartered else 1)
    stretch = max(1, min(int(CELLS // cells), TOGETHER // count))
    lengths = steps.lengths[0]
    along = None if clock is None else clock.along(lengths, steps.ends)
    parts = list(torch.arange(len(lengths)).split(stretch))
    paths = _Path(dynamics, known, quartered)
    rows = [paths.begin(start)]
    for part in track(parts, description, len(parts)) if description else parts:
        own = None if along is None else along.steps(part)
        rows.append(paths.follow(lengths[part], own).at(wanted[1:][part]))
    return Prediction(times, *_Rows.joined(rows))


def needs_quarters(dynamics: Dynamics, start: Tensor, steps: Steps) -> bool:
    """Return whether the first `TOGETHER` steps from starts (B, D) are too long for the trapezoidal rule."""
    lengths = steps.lengths[:, :TOGETHER].expand(len(start), -1)
    return coarse(cast(HasField, dynamics).field, path(dynamics.increment, start, lengths), lengths)


class _Rows(NamedTuple):
    """States (B, N, D), covariances (B, N, D, D) and novelty (B, N)."""

    states: Tensor
    covariances: Tensor | None
    novelty: Tensor | None

    def at(self, chosen: Tensor) -> _Rows:
        """Return selected samples."""
        states, *others = (None if part is None else part[:, chosen] for part in self)
        assert states is not None
        return _Rows(states, *others)

    @classmethod
    def joined(cls, rows: Sequence[_Rows]) -> _Rows:
        """Concatenate segments."""
        columns = zip(*rows, strict=True)
        states, *others = (None if column[0] is None else torch.cat(column, dim=1) for column in columns)
        assert states is not None
        return cls(states, *others)


class _Path:
    """Current states of a batch of paths, with sensitivities to start and parameters."""

    def __init__(self, dynamics: Dynamics, known: Knowledge, quartered: bool) -> None:
        self.dynamics, self.known, self.quartered = dynamics, known, quartered
        if known.columns:
            self.jacobians = own_jacobians(dynamics)
        if known.spread is not None:
            self.theta = parameters_to_vector(dynamics.parameters()).detach()
            self.field_columns = field_jacobian(dynamics)  # pyright: ignore[reportArgumentType]

    def begin(self, start: Tensor) -> _Rows:
        """Set the starts (B, D) and return them as rows."""
        self.x, size, states = start, start.shape[1], start.unsqueeze(1)
        moved = start.new_zeros(len(start), size, self.known.columns)
        if self.known.start is not None:
            moved[..., -size:] = self.known.start
        self.moved = moved.float()
        return _Rows(states, self._covariances(moved.unsqueeze(1)), self._novelty(states))

    def follow(self, lengths: Tensor, clock: Clock | None = None) -> _Rows:
        """Take steps of lengths (N,) with a clock at their start, and return the rows after each."""
        states = torch.stack([self.x, *self._steps(lengths, clock)], dim=1)
        novelty = self._novelty(states)
        self.x = states[:, -1]
        later = None if novelty is None else novelty[:, 1:]
        if not self.known.columns:
            return _Rows(states[:, 1:], None, later)
        moved = self._columns(states, lengths.expand(len(states), -1), novelty, clock)
        self.moved = moved[:, -1]
        return _Rows(states[:, 1:], self._covariances(moved[:, 1:]), later)

    def _columns(
        self, states: Tensor, lengths: Tensor, novelty: Tensor | None, clock: Clock | None
    ) -> Tensor:
        """Return the columns at states (B, N + 1, D), shape (B, N + 1, D, R)."""
        steps = Steps(lengths, torch.arange(lengths.shape[1] + 1))
        if self.quartered:
            steps, states = steps.quarters(), in_quarters(self.dynamics.increment, states, lengths)
            novelty = self._novelty(states)
        if clock is None:
            jacobians = self.jacobians(states[:, :-1], steps.lengths)
        else:
            begun = extended(states[:, :-1], clock)
            jacobians = reduced_jacobians(self.jacobians(begun, steps.lengths), clock.values.shape[-1])
        return sensitivities(jacobians, self._forcing(states, novelty), steps, self.moved)

    def _forcing(self, states: Tensor, novelty: Tensor | None) -> Tensor:
        """Return the forcing of the columns (B, N, L, R): nonzero for parameters, zero for starts."""
        if self.known.spread is None:
            return states.new_zeros(*states.shape, self.known.columns, dtype=torch.float32)
        forcing = self.field_columns(self.theta, states) @ self.known.spread.float()
        if novelty is not None:
            forcing = forcing * growth(novelty)[..., None, None].float()
        return pad(forcing, (0, self.known.columns - forcing.shape[-1]))

    def _covariances(self, moved: Tensor) -> Tensor | None:
        """Return M M^T in float64; in float32 it could have negative eigenvalues."""
        wide = moved.double()
        return wide @ wide.mT if self.known.columns else None

    def _steps(self, lengths: Tensor, clock: Clock | None) -> Iterator[Tensor]:
        x = self.x
        for k, dt in enumerate(lengths.tolist()):
            x = stepped(self.dynamics, x, dt, None if clock is None else clock.at(k))
            yield x

    def _novelty(self, states: Tensor) -> Tensor | None:
        return None if self.known.domain is None else self.known.domain.novelty(self.dynamics, states)


def together(predictions: Sequence[Prediction]) -> Prediction:
    """Combine predictions of several trainings to their mean, with their spread in the covariance.

    Law of total covariance: the mean of the individual covariances, if all are known, plus the sample
    covariance of the states. The novelty is the maximum.
    """
    first, *others = predictions
    if not others:
        return first
    states = torch.stack([one.states for one in predictions])
    off = states - states.mean(0)
    covariances = torch.einsum("s...i,s...j->...ij", off, off) / len(others)
    own = [one.covariances for one in predictions if one.covariances is not None]
    if len(own) == len(predictions):
        covariances = covariances + torch.stack(own).mean(0)
    far = [one.novelty for one in predictions if one.novelty is not None]
    novelty = torch.stack(far).amax(0) if len(far) == len(predictions) else None
    return Prediction(first.times, states.mean(0), covariances, novelty)


def require_times(times: Tensor) -> None:
    """Raise UserError for times that are not (T,), finite and increasing."""
    if times.ndim != 1 or len(times) < 2 or not bool((times.diff() > 0).all() & times.isfinite().all()):
        received = times.tolist() if times.numel() < 7 else f"shape {tuple(times.shape)}"
        message = (
            f"times: expected two or more that increase, the first that of the start; received {received}"
        )
        raise UserError(message)


def require_finite_prediction(prediction: Prediction, unit: str) -> None:
    """Raise TrainingError, with the time, for non-finite predicted states or covariances."""
    wrong = ~prediction.states.isfinite().all(-1)
    if prediction.covariances is not None:
        wrong |= ~prediction.covariances.isfinite().all(-1).all(-1)
    if bool(wrong.any()):
        lost = int(wrong.any(0).nonzero()[0])
        row, time = int(wrong[:, lost].nonzero()[0]), float(prediction.times[lost])
        message = (
            f"prediction: expected finite states; received NaN or infinity {time:g} {unit} after start "
            f"{row + 1}. Nothing is written: shorten duration, or look at start and model"
        )
        raise TrainingError(message)
