"""Decision rule of the Predicted Final Loss pruner, as a pure function."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Literal, NamedTuple

from ahnn.arguments import Count, Within, check_values
from ahnn.errors import UserError
from ahnn_plugins.pfl.predictor import FITS, FitName, Forecast


class Settings(NamedTuple):
    """Settings of the rule; the defaults are from the paper.

    Attributes:
        fit: name of the fit, a key of `FITS`.
        use: `first` fits the first `fit_epochs` losses (paper), `all` every loss so far (the author's code).
        fit_epochs: minimum number of losses for a decision.
        target_epoch: epoch of the forecast.
        top_k: number of best complete models that set the threshold; with fewer models, forecasts stop no
            run.
    """

    fit: FitName = "log_linear"
    use: Literal["first", "all"] = "first"
    fit_epochs: Annotated[int, Within(4)] = 10
    target_epoch: Count = 50
    top_k: Count = 10


class Decision(NamedTuple):
    """Decision with its reason.

    Attributes:
        prune: whether to stop.
        forecast: mean forecast over the seeds, or None.
        threshold: worst final loss of the best `top_k` complete models, or None for fewer than `top_k`.
        reason: `non-finite loss`, `warm-up`, `past target`, `too few models`, `no forecast`,
            `forecast above threshold` or `forecast within threshold`.
    """

    prune: bool
    forecast: Forecast
    threshold: float | None
    reason: str


def decide(own: Sequence[Sequence[float]], finals: Sequence[float], settings: Settings) -> Decision:
    """Decide whether a model should stop now.

    Args:
        own: losses of the model so far, one series per seed, the running seed last.
        finals: final losses of the complete models.
        settings: see `Settings`.

    Returns:
        The decision, which depends only on the arguments.
    """
    reference = best_finals(finals, settings.top_k)
    threshold = reference[-1] if len(reference) == settings.top_k else None
    if any(not math.isfinite(loss) for series in own for loss in series[-1:]):
        return Decision(True, None, threshold, "non-finite loss")
    if not own or len(own[-1]) < settings.fit_epochs:
        return Decision(False, None, threshold, "warm-up")
    if len(own[-1]) > settings.target_epoch:
        return Decision(False, None, threshold, "past target")
    forecast = _mean_forecast(own, settings)
    if threshold is None:
        return Decision(False, forecast, None, "too few models")
    if forecast is None:
        return Decision(False, None, threshold, "no forecast")
    if forecast > threshold:
        return Decision(True, forecast, threshold, "forecast above threshold")
    return Decision(False, forecast, threshold, "forecast within threshold")


def best_finals(finals: Sequence[float], top_k: int) -> list[float]:
    """Return the `top_k` smallest finite final losses, in increasing order, as required by the rule."""
    return sorted(loss for loss in finals if math.isfinite(loss))[:top_k]


def checked(settings: Settings) -> Settings:
    """Validate and return the settings.

    Raises:
        UserError: unknown fit or use, or counts that leave nothing to fit or to forecast.
    """
    check_values("", Settings, settings._asdict())
    if settings.fit_epochs > settings.target_epoch:
        message = (
            f"fit_epochs: expected at most target_epoch, {settings.target_epoch}, the last epoch of a run; "
            f"received {settings.fit_epochs}. Train for more epochs, set callbacks.pfl.fit_epochs, or switch "
            "the pruner off with callbacks.pfl=null"
        )
        raise UserError(message)
    return settings


def _mean_forecast(own: Sequence[Sequence[float]], settings: Settings) -> Forecast:
    """Return the mean over the seeds of their forecasts, or None if one of them is missing."""
    fit = FITS[settings.fit]
    forecasts = []
    for series in own:
        losses = series[: settings.fit_epochs] if settings.use == "first" else series
        forecasts.append(fit(losses, settings.target_epoch))
    finite = [forecast for forecast in forecasts if forecast is not None]
    if len(finite) < len(forecasts):
        return None
    return math.fsum(forecast / len(finite) for forecast in finite)
