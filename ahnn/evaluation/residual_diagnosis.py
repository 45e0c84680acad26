"""What a user may have said wrongly of measurements, where a training does not leave just their noise."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ahnn.data.noise_floor import NORMAL, TWICE
from ahnn.evaluation.goodness_of_fit import OUTLYING, fit_to, serial
from ahnn.measurements import Segment
from ahnn.numbers import in_percent
from ahnn.shooting.robust import RobustName

WHITE, APART = 0.3, (1, 2, 3, 4)
"""Correlation of residuals from which it is the dynamics that are off, and not the noise, and how far apart
they are: a quarter of a period apart those of wrong dynamics do not correlate."""
FEW = 1e-3
"""Share of outliers that is worth a word: a thousand numbers have 2e-6 of them by chance."""


@torch.no_grad()
def remedy(dynamics: nn.Module, segment: Segment, robust: RobustName) -> str:
    """Return what the residuals about robust paths say of the stated noise and of outliers, "" for nothing.

    Args:
        dynamics: float64, with a method `increment`.
        segment: measurements that the dynamics were not trained on.
        robust: the loss of the training.
    """
    segment = segment.rows(segment.measured > 2 * segment.instrument.dof)
    if not len(segment.times):
        return ""
    fitted, steps = fit_to(dynamics, segment, "student")
    left = segment.residuals(fitted.states[:, steps.ends]).masked_fill(segment.values.isnan(), torch.nan)
    spent = 2 * segment.instrument.dof * len(segment.times) / float(segment.measured.sum())
    scales = left.abs().flatten(0, 1).nanmedian(0).values / NORMAL / (1 - spent) ** 0.5
    far = left.abs() > OUTLYING * scales.clamp(min=1)
    rest = left.masked_fill(far, torch.nan)
    white = all(not abs(serial(rest, apart)[0]) > WHITE for apart in APART if apart < rest.shape[1])
    # wrong dynamics leave more than the noise, and never less
    said = _noise(segment.instrument.measurement.names, scales if white else scales.clamp(max=1))
    share = int(far.sum()) / max(int(segment.measured.sum()), 1)
    if white and robust == "none" and share > FEW:
        said.append(f"{in_percent(share)} of the numbers are outliers, which loss.robust=student weighs down")
    return "; ".join(said)


def _noise(names: tuple[str, ...], scales: Tensor) -> list[str]:
    """Return for which numbers data.noise is off by more than a factor of two, in one text or none."""
    off = [
        f"{max(scale, 1 / scale):.2g} times too {'small' if scale > 1 else 'large'} for {name}"
        for name, scale in zip(names, scales.tolist(), strict=True)
        if scale > 0 and not 1 / TWICE < scale < TWICE
    ]
    return [f"data.noise is about {', '.join(off)}"] if off else []
