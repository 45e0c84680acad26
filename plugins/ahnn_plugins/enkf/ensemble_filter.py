"""Ensemble Kalman filter (Evensen 1994): the Kalman update with the covariance of an ensemble.

Let A be the deviations of the ensemble from its mean and Y those of its measured images, both divided by
sqrt(N - 1). The innovation covariance is S = Y Yᵀ + R, and the gain is K = A Yᵀ S⁻¹. The analysis has two
forms:

    stochastic    each member uses an independently perturbed measurement: x_i + K (y + e_i - h(x_i)),
                  e_i ~ N(0, R) (Burgers, van Leeuwen & Evensen 1998)
    square_root   the mean is updated by K, deviations by K' = A Yᵀ S^(-T/2) (S^(1/2) + R^(1/2))⁻¹ (Whitaker &
                  Hamill 2002, eq. 10; Andrews 1968): the covariance is (I - K H) P, without perturbations

Added random numbers have zero mean over the ensemble and do not change its mean. With enough members the
initial ensemble has exactly the moments of the belief (second-order exact sampling: Pham 2001). With more
than 2 D members the square-root form draws process noise in the same way, uncorrelated with the ensemble: for
a linear system it then equals the Kalman filter up to rounding.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, cast, final, get_args

import torch
from torch import Tensor
from torch.nn.functional import pad

from ahnn.arguments import check_arguments
from ahnn.errors import UserError
from ahnn.estimation.belief import Belief
from ahnn.estimation.conditioning import conditioned, present_noise
from ahnn.estimation.estimator import Batch, SensorModel, Smoothed
from ahnn.estimation.gate import Gate
from ahnn.estimation.kernel import measured
from ahnn.estimation.linalg import cholesky_repaired, tria
from ahnn.estimation.random_numbers import RandomNumbers
from ahnn.estimation.results import Backward, FilterResult, Updated
from ahnn.estimation.sample_filter import SampleFilter, image_deviations
from ahnn.estimation.samples import SampleState, sample_moments
from ahnn.estimation.smoother import backward_law, smoother
from ahnn.measurements import residual
from ahnn_plugins.enkf.localisation import Localisation

Analysis = Literal["stochastic", "square_root"]


class Joint(NamedTuple):
    """Joint distribution of measurement and state.

    Attributes:
        chol: (B, M + D, M + D) lower factor of their covariance, with measurement noise.
        deviations: (B, N, M) deviations of the measured members from their mean.
        innovation: (B, M) innovation.
        noise: (B, 2 M, M) rows of the measurement noise, see `present_noise`.
    """

    chol: Tensor
    deviations: Tensor
    innovation: Tensor
    noise: Tensor


@final
@dataclass(frozen=True)
class EnsembleKalmanFilter(SampleFilter):
    """Ensemble Kalman filter with additive noise for a batch of B members, each with a separate ensemble.

    Attributes:
        ensemble: ensemble size N; greater than D without localisation.
        form: `square_root` or `stochastic`.
        inflation: factor on the deviations before each update (Anderson & Anderson 1999); 1: no inflation.
        localisation: taper of the covariances, or its attributes, or None.
        seed: seed of the random numbers.
        gate: gate for improbable measurement rows, or None.

    Raises:
        UserError: a value outside its limits.
    """

    ensemble: int = 100
    form: Analysis = "square_root"
    inflation: float = 1.0
    localisation: Localisation | dict[str, Any] | None = None
    seed: int = 0
    gate: Gate | None = None

    def __post_init__(self) -> None:
        """Check that values are within their limits."""
        super().__post_init__()
        if not isinstance(self.ensemble, int) or self.ensemble < 2:
            message = f"ensemble: expected a whole number >= 2; received {self.ensemble!r}"
            raise UserError(message)
        if self.form not in get_args(Analysis):
            message = f"form: expected one of {', '.join(get_args(Analysis))}; received {self.form!r}"
            raise UserError(message)
        if not isinstance(self.inflation, int | float) or not 1.0 <= self.inflation < math.inf:
            message = f"inflation: expected a number >= 1; received {self.inflation!r}"
            raise UserError(message)
        if isinstance(self.localisation, dict):
            check_arguments("localisation", Localisation, self.localisation)
            object.__setattr__(self, "localisation", Localisation(**self.localisation))

    @property
    def name(self) -> str:
        """Name in tables."""
        return "enkf"

    @property
    def count(self) -> int:
        """Ensemble size N."""
        return self.ensemble

    @property
    def about(self) -> dict[str, Any]:
        """Plain values that determine the estimates."""
        taper = self.localisation
        own = {"form": self.form, "inflation": self.inflation, "localisation": taper and vars(taper)}
        return {**super().about, **own}

    @property
    def smoothers(self) -> dict[str, Callable[[FilterResult, Batch], Smoothed]]:
        """Rauch-Tung-Striebel smoother from ensemble covariances; none if they are tapered."""
        if self.localisation is not None:
            return {}
        return {"smoothed": lambda result, _: Smoothed(smoother(result))}

    def drawn(self, belief: Belief, random: RandomNumbers) -> Tensor:
        """Draw the initial ensemble (B, N, D).

        Raises:
            UserError: fewer members than required for a covariance of full rank, without localisation.
        """
        size = belief.mean.shape[-1]
        if self.ensemble <= size and self.localisation is None:
            message = (
                f"ensemble: expected more members than the {size} estimated components, or a localisation; "
                f"received {self.ensemble}"
            )
            raise UserError(message)
        draw = centred(random.normal(belief.mean, len(belief.mean), self.ensemble, size))
        draw = uncorrelated(draw) if self.ensemble > size else draw
        return belief.mean.unsqueeze(1) + draw @ belief.chol.mT

    def noise(self, draw: Tensor, points: Tensor) -> Tensor:
        """Return random numbers (B, N, D) of zero mean, uncorrelated if form and ensemble size permit."""
        draw = centred(draw)
        if self.form != "square_root" or self.ensemble <= 2 * points.shape[-1]:
            return draw
        basis = torch.linalg.qr(points - points.mean(1, keepdim=True)).Q
        return uncorrelated(draw - basis @ (basis.mT @ draw))

    def moments(self, points: Tensor, log_weights: Tensor | None = None) -> Belief:
        """Return mean and covariance of an ensemble, tapered if requested."""
        belief = sample_moments(points)
        if self.localisation is None:
            return belief
        taper = cast(Localisation, self.localisation).taper(points.shape[-1]).to(points.device)
        return Belief(belief.mean, cholesky_repaired(taper * belief.covariance)[0])

    def law(self, before: Tensor, images: Tensor, chol_q: Tensor) -> Backward:
        """Return the backward law from the joint covariance of the ensembles before and after the flow."""
        both, size = torch.cat((images, before), dim=-1), before.shape[-1]
        rows = (both - both.mean(1, keepdim=True)) / (self.ensemble - 1) ** 0.5
        return backward_law(tria(torch.cat((rows, pad(chol_q.mT, (0, size))), dim=1)))[0]

    def conditioned(
        self, state: SampleState, images: Tensor, y: Tensor, sensor: SensorModel
    ) -> tuple[SampleState, Updated]:
        """Condition the ensemble on a row; return the state and the update."""
        prior, points = state.belief, state.points
        if self.inflation != 1.0:
            centre = prior.mean.unsqueeze(1)
            points = centre + self.inflation * (points - centre)
            prior = Belief(prior.mean, self.inflation * prior.chol)
            images = measured(sensor.measurement, points, float(state.time))
        joint = self.joint(prior, points, images, y, sensor, float(state.time))
        innovation, width = conditioned(prior, joint.chol, joint.innovation, y), y.shape[-1]
        chol_y, cross = joint.chol[:, :width, :width], joint.chol[:, width:, :width]
        if self.form == "stochastic":
            # Measured components get rows of noise; missing components get none.
            draw = centred(state.random.normal(y, *joint.deviations.shape))
            off = joint.innovation.unsqueeze(1) - joint.deviations + draw @ joint.noise[:, :width]
            moved = points + _solved(off, chol_y) @ cross.mT
        else:
            step = (_solved(joint.innovation.unsqueeze(1), chol_y)) @ cross.mT
            moved = points + step - _solved(joint.deviations, chol_y + tria(joint.noise)) @ cross.mT
        belief = self.moments(moved)
        return state._replace(belief=belief, points=moved), innovation._replace(belief=belief)

    def joint(
        self, prior: Belief, points: Tensor, images: Tensor, y: Tensor, sensor: SensorModel, time: float
    ) -> Joint:
        """Return the joint law of a row (B, M) and the state from an ensemble (B, N, D) and its images.

        For a tapered covariance the image is computed from symmetric points along its factor.
        """
        deviations, innovation = image_deviations(images, 1.0 / self.ensemble, y, sensor)
        noise = present_noise(sensor.chol_r, ~torch.isnan(y))
        if self.localisation is None:
            seen, state = deviations, points - prior.mean.unsqueeze(1)
            seen, state = (part / (self.ensemble - 1) ** 0.5 for part in (seen, state))
        else:
            state = prior.chol.mT
            spread = state.shape[-1] ** 0.5
            centre, model = prior.mean.unsqueeze(1), sensor.measurement
            ends = (measured(model, centre + side * state, time) for side in (spread, -spread))
            seen = residual(model, *ends) / (2.0 * spread)
            seen = torch.where(torch.isnan(y).unsqueeze(1), 0.0, seen)
        rows = torch.cat((torch.cat((seen, state), -1), pad(noise, (0, state.shape[-1]))), dim=1)
        return Joint(tria(rows), deviations, innovation, noise)


def centred(draw: Tensor) -> Tensor:
    """Return normal numbers (B, N, ...) with zero mean over the ensemble and unit variance."""
    count = draw.shape[1]
    return (draw - draw.mean(1, keepdim=True)) * (count / (count - 1)) ** 0.5


def uncorrelated(draw: Tensor) -> Tensor:
    """Return numbers (B, N, D) of zero mean with identity covariance over the ensemble."""
    return _solved(draw, sample_moments(draw).chol)


def _solved(rows: Tensor, chol: Tensor) -> Tensor:
    """Return rows (B, N, M) times the inverse transpose of a lower factor (B, M, M)."""
    return torch.linalg.solve_triangular(chol, rows.mT, upper=False).mT
