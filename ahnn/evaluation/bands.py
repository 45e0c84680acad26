"""Prediction bands from a parameter covariance, and their coverage of unseen trajectories."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple, cast

import torch
from matplotlib.figure import Figure
from torch import Tensor

from ahnn.dynamics import Dynamics
from ahnn.evaluation import style
from ahnn.evaluation.case import Case
from ahnn.evaluation.independent_directions import TOO_FEW, DirectionTest, direction_test, ratio_interval
from ahnn.labels import quantity
from ahnn.metrics import errors
from ahnn.types import Space
from ahnn.uncertainty import Uncertainty, rollout_sensitivities

SIGMAS = (1, 2, 3)
"""Half-widths of the bands, in standard deviations."""
NORMAL = tuple(math.erf(k / math.sqrt(2)) for k in SIGMAS)
"""Coverage of the bands for normal errors."""
ROWS = 20_000
"""Approximate number of errors tested over all trajectories, since neighbouring errors are redundant."""


class Band(NamedTuple):
    """Standard deviations of rollouts from the true start, and their coverage.

    Attributes:
        deviations: (B, T, D) standard deviations.
        coverage: fractions of components of unseen states within 1, 2 and 3 standard deviations.
        test: test of the band widths along the independent directions of the errors.
        expected: expected rms norms of position and velocity errors.
        bound: expected errors from noise only: the Cramer-Rao bound of the regularised parameters.
        efficiency: rms norms of the errors in units of that bound.
        usual: central 95 % range of this efficiency in training runs that attain the bound.
        single: errors of the first trajectory after a quarter, half and all of its duration, in standard
            deviations.
    """

    deviations: Tensor
    coverage: tuple[float, ...]
    test: DirectionTest
    expected: tuple[float, float]
    bound: tuple[float, float]
    efficiency: tuple[float, float]
    usual: tuple[tuple[float, float], tuple[float, float]]
    single: tuple[tuple[float, ...], ...]

    def sentence(self, space: Space) -> str:
        """Return the finding as a note under the table."""
        return (
            f"bands of 1, 2 and 3 standard deviations contain {percent(self.coverage)} % of unseen states "
            f"({self.test.sentence()}); the error is {self.efficiency[0]:.2f} (position) and "
            f"{self.efficiency[1]:.2f} ({quantity(space, 'velocity')[0]}) times the noise bound "
            f"({ranges(self.usual)} in 19 of 20 training runs at the bound)"
        )

    def verdict(self) -> str:
        """Return the finding on the bands for the verdict; "" with too few independent directions."""
        verdict = self.test.verdict
        found = f"prediction bands are {verdict}: errors are {self.test.scatter:.2f} standard deviations"
        return "" if verdict == TOO_FEW else found

    def numbers(self) -> dict[str, Any]:
        """Return plain values for metrics.json."""
        found = {
            name: list(getattr(self, name)) for name in self._fields if name not in ("deviations", "test")
        }
        normal = {"sigmas": list(SIGMAS), "of_normal_errors": list(NORMAL)}
        return {**normal, **found, "test": self.test.numbers()}


def banded(case: Case, uncertainty: Uncertainty, prediction: Tensor) -> Band:
    """Compute the band of a prediction (B, T, D) of the test trajectories from their true starts."""
    count, samples = case.test.times.shape
    lengths = torch.as_tensor(case.dt, dtype=torch.float64).expand(count, samples - 1)
    dynamics, start = cast(Dynamics, case.flow), case.test.states[:, 0]
    off, spread = errors(prediction, case.test.states), uncertainty.spread
    there, parts = off.isfinite(), list[tuple[Tensor, Tensor]]()
    stride = 1 + count * samples // ROWS
    grams, divisor = [torch.zeros(()), torch.zeros(())], torch.as_tensor(case.space.divisor).unsqueeze(-1)

    def tested() -> Iterator[tuple[Tensor, Tensor]]:
        first = 0
        for moved in rollout_sensitivities(dynamics, start, lengths, spread):
            rows, first = slice(first, first + len(moved)), first + len(moved)
            parts.append((moved.double().square().sum(-1), moved[..., :-1].double().square().sum(-1)))
            seen, some = there[rows, 1::stride], moved[:, 1::stride]
            position, momentum = some[..., :-1].where(seen.unsqueeze(-1), 0.0).chunk(2, dim=2)
            for k, block in enumerate((position, momentum / divisor)):
                own = block.flatten(0, 2).double()
                grams[k] = grams[k] + own.mT @ own
            yield off[rows, 1::stride][seen], some[seen]

    test = direction_test(tested())
    deviations, alone = (torch.cat(some).sqrt() for some in zip(*parts, strict=True))
    alone = alone / uncertainty.inflation**0.5  # without inflation; `alone` also omits the offset
    bound = norms(alone.where(there, torch.nan), case.space.divisor)
    real = norms(off, case.space.divisor)
    later, band = off[:, 1:].abs(), deviations[:, 1:]
    return Band(
        deviations=deviations,
        coverage=tuple(float((later <= k * band)[there[:, 1:]].double().mean()) for k in SIGMAS),
        test=test,
        expected=norms(deviations.where(there, torch.nan), case.space.divisor),
        bound=bound,
        efficiency=(real[0] / bound[0], real[1] / bound[1]),
        usual=(ratio_interval(grams[0]), ratio_interval(grams[1])),
        single=tuple(tuple((off / deviations)[0, samples * k // 4 - 1].tolist()) for k in (1, 2, 4)),
    )


def ranges(intervals: tuple[tuple[float, float], ...]) -> str:
    """Format intervals."""
    return " and ".join(f"{low:.2f} to {high:.2f}" for low, high in intervals)


def percent(fractions: tuple[float, ...]) -> str:
    """Format fractions in percent."""
    return ", ".join(f"{100 * fraction:.3g}" for fraction in fractions)


def norms(values: Tensor, divisor: float | Tensor) -> tuple[float, float]:
    """Return the rms norms of positions and velocities over trajectories and times, from (B, T, D)."""
    position, momentum = values.chunk(2, dim=-1)
    rms = (float(block.square().sum(-1).nanmean().sqrt()) for block in (position, momentum / divisor))
    return next(rms), next(rms)


def band_figure(case: Case, prediction: Tensor, deviations: Tensor) -> Figure:
    """Plot the errors of one unseen trajectory with their band, positions above and velocities below."""
    figure = style.canvas(8, 6)
    panels = figure.subplots(2, 1, sharex=True)
    axis, names = style.time_axis(case), style.state_labels(case)
    off = errors(prediction, case.test.states)[0]
    for axes, i in zip(panels, (0, case.space.dof), strict=True):
        unit = case.space.scales[i]
        sd = deviations[0, :, i] / unit
        for k, alpha in zip(SIGMAS, (0.5, 0.3, 0.15), strict=True):
            axes.fill_between(
                axis.time, -k * sd, k * sd, color=style.BAND, alpha=alpha, lw=0, label=f"{k} sigma"
            )
        axes.plot(axis.time, off[:, i] / unit, **style.MODEL, label=case.label)
        axes.set_ylabel(f"error of {names[i]}")
        axes.ticklabel_format(axis="y", scilimits=(-3, 4))
        axes.grid(alpha=0.3)
    style.label_time(panels[-1], axis)
    style.legend_below(figure, panels[0])
    panels[0].set_title(f"{case.space.name}: error on one unseen trajectory and its band, true start")
    return figure
