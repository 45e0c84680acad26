"""Bootstrap particle filter (Gordon, Salmond & Smith 1993): measurements weight propagated states.

Weights are stored as logarithms. If the effective sample size falls below a fraction of the particles, they
are resampled (systematically: Kitagawa 1996), and perturbed by a kernel that preserves mean and covariance
(Liu & West 2001),

    x' = mean + sqrt(1 - h²) (x - mean) + h L z,    L Lᵀ the covariance.

Without this kernel, copies of a particle would stay identical in the absence of process noise. A measurement
much more precise than its prediction leaves few effective particles. It is therefore processed in stages
(progressive correction: Oudjane & Musso 2000). In each stage the likelihood is raised to a power that leaves
enough effective particles, which are resampled and perturbed, until the powers sum to 1. Alternatively, each
particle is drawn from an unscented update (`unscented_proposal`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, final, get_args

import torch
from torch import Tensor

from ahnn.errors import UserError
from ahnn.estimation.belief import Belief, choose
from ahnn.estimation.conditioning import present_noise
from ahnn.estimation.estimator import SensorModel
from ahnn.estimation.gate import Gate
from ahnn.estimation.kernel import measured
from ahnn.estimation.linalg import tria
from ahnn.estimation.random_numbers import RandomNumbers
from ahnn.estimation.results import Updated
from ahnn.estimation.sample_filter import SampleFilter, image_deviations
from ahnn.estimation.samples import (
    SampleState,
    effective_size,
    normalised,
    sample_moments,
    systematic_resampling,
)
from ahnn_plugins.particle.unscented_proposal import unscented_proposal
from ahnn_plugins.particle.weighing import STAGE_BANDWIDTH, STAGE_SIZE, WeighingRow, exponent

TINY = torch.finfo(torch.float64).tiny
Proposal = Literal["prior", "ukf"]
STAGES = 50


@final
@dataclass(frozen=True)
class ParticleFilter(SampleFilter):
    """Bootstrap particle filter with additive Gaussian noise for a batch of B members, see `SampleFilter`.

    A particle with a non-finite state or measurement has zero weight thereafter.

    Attributes:
        particles: number of particles N.
        resample_below: particles are resampled if the effective sample size is below this fraction of N.
        bandwidth: h of the kernel, less than 1; 0: no kernel; None: (4 / ((D + 2) N))^(1 / (D + 4)), optimal
            for Gaussian beliefs (Silverman 1986, section 4.3), and at least 0.6 between two stages. Beliefs
            with narrow modes require less.
        stages: maximum number of stages per measurement; 1 for the bootstrap filter.
        proposal: `prior` weights propagated particles; `ukf` draws each from an unscented update of its
            kernel, in one stage.
        seed: seed of the random numbers.
        gate: gate for improbable measurement rows, or None.

    Raises:
        UserError: a value outside its limits.
    """

    particles: int = 1000
    resample_below: float = 0.5
    bandwidth: float | None = None
    stages: int = STAGES
    seed: int = 0
    gate: Gate | None = None
    proposal: Proposal = "prior"

    def __post_init__(self) -> None:
        """Check that values are within their limits."""
        super().__post_init__()
        if not isinstance(self.particles, int) or self.particles < 2:
            message = f"particles: expected a whole number >= 2; received {self.particles!r}"
            raise UserError(message)
        if not isinstance(self.resample_below, int | float) or not 0.0 <= self.resample_below <= 1.0:
            message = f"resample_below: expected a number from 0 to 1; received {self.resample_below!r}"
            raise UserError(message)
        if not isinstance(self.stages, int) or self.stages < 1:
            message = f"stages: expected a whole number >= 1; received {self.stages!r}"
            raise UserError(message)
        h = self.bandwidth
        if h is not None and (not isinstance(h, int | float) or not 0.0 <= h < 1.0):
            message = f"bandwidth: expected null or a number in [0, 1); received {h!r}"
            raise UserError(message)
        if self.proposal not in get_args(Proposal):
            message = f"proposal: expected one of {', '.join(get_args(Proposal))}; received {self.proposal!r}"
            raise UserError(message)
        if self.proposal == "ukf" and (h == 0.0 or self.stages != STAGES):
            message = (
                "proposal: expected prior where bandwidth is 0 or stages are set, since ukf needs a "
                f"bandwidth above 0 and works in one stage; received ukf with bandwidth={h}, "
                f"stages={self.stages}"
            )
            raise UserError(message)

    @property
    def name(self) -> str:
        """Name in tables."""
        return "particle"

    @property
    def count(self) -> int:
        """Number of particles N."""
        return self.particles

    @property
    def definite(self) -> bool:
        """True, since a likelihood requires definite noise."""
        return True

    @property
    def about(self) -> dict[str, Any]:
        """Plain values that determine the estimates."""
        own = {"resample_below": self.resample_below, "bandwidth": self.bandwidth, "stages": self.stages}
        # States of streams saved before this option was introduced imply `prior`.
        return {**super().about, **own, **({} if self.proposal == "prior" else {"proposal": self.proposal})}

    def drawn(self, belief: Belief, random: RandomNumbers) -> Tensor:
        """Draw particles (B, N, D) from a Gaussian belief."""
        draw = random.normal(belief.mean, len(belief.mean), self.particles, belief.mean.shape[-1])
        return belief.mean.unsqueeze(1) + draw @ belief.chol.mT

    def noise(self, draw: Tensor, points: Tensor) -> Tensor:
        """Return the random numbers unchanged."""
        return draw

    def moments(self, points: Tensor, log_weights: Tensor) -> Belief:
        """Return the weighted moments."""
        return sample_moments(points, log_weights)

    def followed(self, state: SampleState, images: Tensor) -> tuple[Tensor, Tensor]:
        """Return the particles after the flow; non-finite ones get zero weight."""
        finite = images.isfinite().all(-1)
        if bool(finite.all()):
            return images, state.log_weights
        points = torch.where(finite.unsqueeze(-1), images, state.points)
        return points, normalised(state.log_weights.masked_fill(~finite, -torch.inf))

    def conditioned(
        self, state: SampleState, images: Tensor, y: Tensor, sensor: SensorModel
    ) -> tuple[SampleState, Updated]:
        """Condition the particles on a row; return the state and the update."""
        finite = images.isfinite().all(-1)
        state = state._replace(log_weights=state.log_weights.masked_fill(~finite, -torch.inf))
        best = state.log_weights.argmax(-1)[:, None, None].expand(-1, 1, images.shape[-1])
        images = torch.where(finite.unsqueeze(-1), images, images.gather(1, best))
        weights = normalised(state.log_weights).exp().unsqueeze(-1)
        deviations, innovation = image_deviations(images, weights, y, sensor)
        noise = present_noise(sensor.chol_r, ~torch.isnan(y))
        row = WeighingRow.of(y, sensor, noise)
        if self.proposal == "ukf":
            after, log_likelihood = self.moved(state, row)
        else:
            after, log_likelihood = self.weighed(state, images, row)
        return after, _of_update(after.belief, weights.sqrt() * deviations, noise, innovation, log_likelihood)

    def weighed(self, state: SampleState, images: Tensor, row: WeighingRow) -> tuple[SampleState, Tensor]:
        """Weight particles by a row, in as many stages as needed; return the state and the log density.

        Args:
            state: state before the row, with zero weights for particles without a finite image.
            images: (B, N, M) images of its particles.
            row: row with its noise.
        """
        least = self.resample_below * self.particles
        each = max(least, STAGE_SIZE * self.particles)
        left = torch.ones_like(state.log_likelihood)
        total = torch.zeros_like(left)
        for stage in range(self.stages):
            densities, last = row.log_density(images), stage == self.stages - 1
            power = left
            if not last:
                most = left.clamp(min=TINY)
                power = torch.minimum(exponent(state.log_weights, densities, most, least, each), left)
            taken = power > 0.0
            weighed = state.log_weights + torch.where(taken, power, 1.0).unsqueeze(-1) * densities
            gained = weighed.logsumexp(-1)
            weighed = torch.where(taken.unsqueeze(-1), weighed - gained.unsqueeze(-1), state.log_weights)
            total = total + torch.where(taken, gained, 0.0)
            left = torch.where(gained.isfinite(), left - power, 0.0)
            belief = choose(taken, self.moments(state.points, weighed), state.belief)
            state = state._replace(log_weights=weighed, belief=belief)
            few = taken & ((left > 0.0) | (effective_size(weighed) < least))
            if bool(few.any()):
                h = self.kernel_bandwidth(state.points.shape[-1], left > 0.0)
                state = self.resampled(state, few, h, stage)
            if not bool((left > 0.0).any()):
                break
            images = measured(row.sensor.measurement, state.points, float(state.time))
        return state, total

    def moved(self, state: SampleState, row: WeighingRow) -> tuple[SampleState, Tensor]:
        """Draw particles from kernels updated by a row; return the state and the log density.

        Args:
            state: state before the row, with zero weights for particles without a finite image.
            row: row with its noise.
        """
        weights = normalised(state.log_weights)
        belief, points = self.moments(state.points, weights), state.points
        nobody = torch.zeros(len(points), dtype=torch.bool, device=points.device)
        h = self.kernel_bandwidth(points.shape[-1], nobody)[:, None, None]
        centre = belief.mean.unsqueeze(1)
        centres = centre + (1.0 - h * h).sqrt() * (points - centre)
        z = state.random.normal(points, *points.shape, stage=1)
        found = unscented_proposal(h * belief.chol, centres, weights, row, z, float(state.time))
        total, weighed = found.log_weights.logsumexp(-1), normalised(found.log_weights)
        belief = self.moments(found.points, weighed)
        state = state._replace(points=found.points, log_weights=weighed, belief=belief)
        few = effective_size(weighed) < self.resample_below * self.particles
        # The kernels of the next update separate duplicate draws.
        return (self.resampled(state, few, torch.zeros_like(total), 0) if bool(few.any()) else state), total

    def resampled(self, state: SampleState, few: Tensor, h: Tensor, stage: int) -> SampleState:
        """Resample and perturb some members, preserving the moments.

        Args:
            state: state with moments consistent with its weights.
            few: (B,) bool, members to resample.
            h: (B,) bandwidths.
            stage: stage of the update.
        """
        points, belief, random = state.points, state.belief, state.random
        offset = random.uniform(points, len(points), stage=stage)
        chosen = systematic_resampling(state.log_weights, offset)
        drawn = points.gather(1, chosen.unsqueeze(-1).expand_as(points))
        if bool(h.any()):
            centre, h = belief.mean.unsqueeze(1), h[:, None, None]
            move = random.normal(points, *points.shape, stage=stage) @ belief.chol.mT
            drawn = centre + (1.0 - h * h).sqrt() * (drawn - centre) + h * move
        weights = torch.full_like(state.log_weights, -math.log(self.particles))
        return state.where(~few, state._replace(points=drawn, log_weights=weights))

    def kernel_bandwidth(self, size: int, further: Tensor) -> Tensor:
        """Return h, (B,), for states of D components; `further` marks members with further stages."""
        if self.bandwidth is not None:
            return torch.where(further, self.bandwidth, self.bandwidth).double()
        best = (4.0 / ((size + 2) * self.particles)) ** (1.0 / (size + 4))
        return torch.where(further, max(best, STAGE_BANDWIDTH), best).double()


def _of_update(
    belief: Belief, rows: Tensor, noise: Tensor, innovation: Tensor, log_likelihood: Tensor
) -> Updated:
    """Build the update, with innovation statistics from the moments of the prediction.

    Args:
        belief: belief after the update.
        rows: (B, N, M) weighted deviations of the measured particles.
        noise: (B, 2 M, M) rows of R.
        innovation: (B, M).
        log_likelihood: (B,) log-likelihood of the row, -inf if its density is zero.
    """
    chol_y = tria(torch.cat((rows, noise), dim=1))
    white = torch.linalg.solve_triangular(chol_y, innovation.unsqueeze(-1), upper=False)
    nis = white.square().sum((-2, -1))
    lost = log_likelihood.isneginf() | (belief.chol.square().sum(-1) == 0.0).any(-1)
    return Updated(belief, innovation, chol_y.norm(dim=-1), nis, log_likelihood, lost)
