"""Forecasts of a loss curve: three fits, each a pure function of the losses seen so far.

Epochs count from zero, as in the paper's code: `target_epoch=50` is the 51st value. Every forecast is a
finite number or an explicit None, for any curve.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from statistics import linear_regression
from types import MappingProxyType
from typing import Literal

Forecast = float | None
"""Finite forecast, or None if the curve does not permit one."""

_POWER_FLOOR = 1e-10  # lower limit of losses before the logarithm of the power law, as in the author's code
_LARGEST = 1e300  # upper limit of forecasts, so that means of forecasts stay finite


def log_linear(losses: Sequence[float], target_epoch: int) -> Forecast:
    """Forecast with A e^{Kt}: least squares of ln(loss) on the epoch.

    This is the paper's fit. It has no asymptote, so forecasts of flattening curves are far too low.

    Args:
        losses: at least two positive, finite losses, one per epoch.
        target_epoch: zero-based epoch of the forecast.

    Returns:
        The forecast, or None if a loss has no logarithm or there are fewer than two.
    """
    if len(losses) < 2 or not all(math.isfinite(y) and y > 0 for y in losses):
        return None
    slope, intercept = linear_regression(range(len(losses)), [math.log(y) for y in losses])
    return _exp(intercept + slope * target_epoch)


def power_law(losses: Sequence[float], target_epoch: int) -> Forecast:
    """Forecast with a x^b: least squares of ln(loss) on ln(x), the first epoch being x = 1.

    Source: the author's template of 13 Jun 2025, without its cut at the best loss so far.

    Args:
        losses: at least three finite losses, one per epoch; they are clipped at 1e-10.
        target_epoch: x of the forecast.

    Returns:
        The forecast, or None if a loss is not finite or there are fewer than three.
    """
    if len(losses) < 3 or not all(math.isfinite(y) for y in losses):
        return None
    abscissa = [math.log(x) for x in range(1, len(losses) + 1)]
    slope, intercept = linear_regression(abscissa, [math.log(max(y, _POWER_FLOOR)) for y in losses])
    return _exp(intercept + slope * math.log(target_epoch))


def shifted_exponential(losses: Sequence[float], target_epoch: int) -> Forecast:
    """Forecast with a e^{-bt} + c through three points of the smoothed curve.

    The points lie at a third, two thirds and the end of the curve. Unless the changes between them shrink and
    have equal signs, the curve continues with half its last slope. Source: the author's template of 3 Apr
    2026.

    Args:
        losses: at least four finite losses, one per epoch.
        target_epoch: zero-based epoch of the forecast.

    Returns:
        The forecast, or None if a loss is not finite or there are fewer than four.
    """
    count = len(losses)
    if count < 4 or not all(math.isfinite(y) for y in losses):
        return None
    smooth = _smoothed(losses, span=max(1, min(count // 3, 20)))
    i, j, k = count // 3, 2 * count // 3, count - 1
    first, second = smooth[i] - smooth[j], smooth[j] - smooth[k]
    ratio = second / first if first != 0 else math.inf
    if not 0 < ratio < 1:
        return _finite(smooth[k] - 0.5 * second / (k - j) * (target_epoch - k))
    rate = -math.log(ratio) / (j - i)
    amplitude = first / -math.expm1(-rate * (j - i))  # size of the exponential part at point i
    try:
        change = math.exp(-rate * (j - i)) * math.expm1(-rate * (target_epoch - j))
    except OverflowError:  # a steep curve extrapolated back beyond its first point
        return None
    return _finite(smooth[j] + amplitude * change)


FitName = Literal["log_linear", "power_law", "shifted"]
FITS: Mapping[FitName, Callable[[Sequence[float], int], Forecast]] = MappingProxyType(
    {"log_linear": log_linear, "power_law": power_law, "shifted": shifted_exponential}
)
"""Fits by their name in a configuration."""


def _smoothed(losses: Sequence[float], span: int) -> list[float]:
    """Return the exponential moving average with weight 2/(span + 1), started at the first loss."""
    weight = 2 / (span + 1)
    smooth = [float(losses[0])]
    for loss in losses[1:]:
        smooth.append(weight * loss + (1 - weight) * smooth[-1])
    return smooth


def _exp(exponent: float) -> float:
    """Return e^exponent, clipped to avoid overflow, so that diverging forecasts stay comparable."""
    return math.exp(exponent) if exponent < math.log(_LARGEST) else _LARGEST


def _finite(value: float) -> Forecast:
    """Return the value, or None on floating-point overflow."""
    return value if math.isfinite(value) else None
