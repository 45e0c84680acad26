"""Unknown parameters of measurement noise, and their estimates after training."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ahnn.arguments import Finite, NonNegative, Positive
from ahnn.errors import UserError
from ahnn.measurements.coloured_noise import Colour
from ahnn.measurements.segment import Instrument

TOLD = 0.5
"""A bias counts as undetermined if its standard deviation is at least this fraction of the prior one."""


class UnknownNoise(NamedTuple):
    """Noise parameters estimated in training in addition to the dynamics.

    Attributes:
        sizes: whether to estimate standard deviations.
        correlation: whether to estimate a coloured part.
        tails: whether to estimate the scale and degrees of freedom of Student's noise.
        bias_sd: (M,) standard deviations of constant biases, 0 where there is none; None: no biases.
    """

    sizes: bool = False
    correlation: bool = False
    bias_sd: Tensor | None = None
    tails: bool = False

    @property
    def anything(self) -> bool:
        """Whether anything is unknown."""
        return self.sizes or self.correlation or self.tails or self.bias_sd is not None


@dataclass(frozen=True, kw_only=True)
class NoiseEstimate:
    """Noise of M measured components, in their units.

    Attributes:
        deviations: standard deviations.
        stated: stated values; empty if not estimated.
        fractions: fractions of the variance that are coloured noise; empty if not estimated.
        memories: time constants of the coloured part.
        bias: offset of readings from the true values; empty if not estimated.
        bias_sd: standard deviations of the bias.
        prior_sd: prior standard deviations of biases, 0 for a component without bias.
        freedom: degrees of freedom of Student's noise, whose scales are the deviations; 0 where the noise
            cannot be distinguished from normal noise; empty if not estimated.
        freedom_low, freedom_high: ends of their 95 % interval; 0 if the upper end is unbounded.
        scale_sd: standard deviations of the scales.
    """

    deviations: list[Positive]
    stated: list[Positive]
    fractions: list[NonNegative]
    memories: list[Positive]
    bias: list[Finite]
    bias_sd: list[NonNegative]
    prior_sd: list[NonNegative]
    freedom: list[NonNegative] = field(default_factory=list)
    freedom_low: list[NonNegative] = field(default_factory=list)
    freedom_high: list[NonNegative] = field(default_factory=list)
    scale_sd: list[NonNegative] = field(default_factory=list)

    def applied(self, instrument: Instrument, unknown: UnknownNoise) -> Instrument:
        """Return the instrument with the estimated noise.

        Raises:
            UserError: the estimate has a different number of components.
        """
        size = len(instrument.deviations)
        if any(values and len(values) != size for values in asdict(self).values()):
            message = (
                f"noise: expected estimates for {size} measured components with the weights; received {self}"
            )
            raise UserError(message)
        deviations, fractions, memories, bias = (
            torch.tensor(part, dtype=torch.float64)
            for part in (self.deviations, self.fractions, self.memories, self.bias)
        )
        coloured = unknown.correlation and bool((fractions > 0).any())
        return instrument._replace(
            deviations=deviations if unknown.sizes or unknown.tails else instrument.deviations,
            colour=Colour(fractions, memories) if coloured else None,
            bias=bias if unknown.bias_sd is not None and len(bias) else None,
            bias_sd=None,
            freedom=freedom_of(self.freedom) if unknown.tails else None,
        )

    def about(self) -> dict[str, Any]:
        """Return the estimate as plain values."""
        return asdict(self)

    def sentences(self, names: tuple[str, ...], units: tuple[str, ...]) -> list[str]:
        """Describe the estimates for components with given names and units."""
        said = list[str]()
        if self.freedom:
            each = enumerate(zip(names, units, strict=True))
            said += [self._tails(k, name, unit) for k, (name, unit) in each]
        elif self.stated:
            each = [
                f"{name} {found:.3g} {unit} ({found / stated:.2g} times the initial value)"
                for name, unit, found, stated in zip(names, units, self.deviations, self.stated, strict=True)
            ]
            said.append(f"standard deviations of the noise, estimated from residuals: {', '.join(each)}")
        if self.fractions:
            said.append(self._colour(names))
        if self.bias:
            said += self._biases(names, units)
        return said

    def _tails(self, k: int, name: str, unit: str) -> str:
        scale = f"{self.deviations[k]:.3g} ± {self.scale_sd[k]:.2g} {unit}"
        if not self.freedom[k]:
            return (
                f"noise tails of {name} cannot be distinguished from those of normal noise (more than "
                f"{self.freedom_low[k]:.2g} degrees of freedom with 95 % probability); its standard "
                f"deviation is {scale}"
            )
        nu, low, high = (values[k] for values in (self.freedom, self.freedom_low, self.freedom_high))
        said = (
            f"the noise of {name} follows Student's t with {nu:.2g} degrees of freedom (95 % interval "
            f"{low:.2g} to {high:.2g}) and scale {scale}"
        )
        if nu <= 2:
            return f"{said}: it has no standard deviation, and filters need a gate"
        deviation = self.deviations[k] * math.sqrt(nu / (nu - 2))
        return f"{said}; its standard deviation, for filters, is {deviation:.3g} {unit}"

    def _colour(self, names: tuple[str, ...]) -> str:
        found = [*zip(names, self.deviations, self.fractions, self.memories, strict=True)]
        coloured = [one for one in found if one[2] > 0]
        if not coloured:
            return "no correlation of the noise in time was found"
        each = [
            f"{100 * part:.3g} % of the noise variance of {name} over times of {memory:.3g}"
            for name, _, part, memory in coloured
        ]
        white, slow = (
            [sd * math.sqrt(part if coloured else max(1 - part, 1e-3)) for _, sd, part, _ in found]
            for coloured in (False, True)
        )
        filters = zip(("sd", "bias_sd", "bias_memory"), (white, slow, [one[3] for one in found]), strict=True)
        texts = [f"measurement.{key}=[{','.join(f'{v:.3g}' for v in values)}]" for key, values in filters]
        said = f"the noise correlates in time: {', '.join(each)}, which the fit takes into account"
        return f"{said}; in filters {' '.join(texts)}"

    def _biases(self, names: tuple[str, ...], units: tuple[str, ...]) -> list[str]:
        found = [
            one
            for one in zip(names, units, self.bias, self.bias_sd, self.prior_sd, strict=True)
            if one[4] > 0
        ]
        biases = [
            f"{name} {bias:+.3g} ± {sd:.2g} {unit}"
            for name, unit, bias, sd, first in found
            if sd < TOLD * first
        ]
        open_ = [name for name, _, _, sd, first in found if sd >= TOLD * first]
        said = [f"biases of the readings, estimated with the dynamics: {', '.join(biases)}"] if biases else []
        if open_:
            said.append(
                f"the bias of {', '.join(open_)} cannot be separated from the motion: the learned "
                "functions shift with it, and bands include its given standard deviation"
            )
        return said


def freedom_of(values: list[float]) -> Tensor | None:
    """Return degrees of freedom (M,), inf where they are 0; None if all components are normal."""
    found = torch.tensor([value or math.inf for value in values], dtype=torch.float64)
    return None if bool(found.isinf().all()) else found
