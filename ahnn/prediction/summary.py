"""Text summary of a prediction."""

from __future__ import annotations

from torch import Tensor

from ahnn.data.estimate_table import components_with_units
from ahnn.data.starts import Starts
from ahnn.labels import duration, physical_components
from ahnn.numbers import in_percent
from ahnn.prediction.beginning import beginning
from ahnn.prediction.propagation import Prediction
from ahnn.types import Space
from ahnn.uncertainty import BEYOND, LINEAR


def summary(prediction: Prediction, starts: Starts, space: Space, title: str) -> str:
    """Return title, last state of the first trajectory with its standard deviations, and the novelty."""
    count, samples, _ = prediction.states.shape
    end = duration(float(prediction.times[-1]), space)
    whose = f", {count} trajectories, of which this is {starts.names[0]}" if count > 1 else ""
    begins = beginning(prediction, starts, space.units.time)
    lines = [f"{title}: {samples:,} states over {end}{whose}", begins]
    deviations = prediction.deviations
    lines.append(f"  {'':16s}{'last state':>16s}{'1 sigma':>12s}")
    for k, name in enumerate(physical_components(space)):
        scale = 1 / float(space.scales[k])
        value = float(prediction.states[0, -1, k]) * scale
        sigma = "not known" if deviations is None else f"{float(deviations[0, -1, k]) * scale:.3g}"
        lines.append(f"  {name:16s}{value:>16.9g}{sigma:>12s}")
    if deviations is None:
        lines.append("  1 sigma needs start_sd=, or weights trained on measurements")
    if prediction.novelty is not None:
        last, most = float(prediction.novelty[0, -1]), float(prediction.novelty.max())
        lines.append(
            f"  {'novelty':16s}{last:>16.3g}    at most {most:.3g} on the way ("
            f"training data: up to {BEYOND:g})"
        )
    return "\n".join(lines)


def warning(
    prediction: Prediction, starts: Starts, space: Space, *, from_numbers: bool = False
) -> str | None:
    """Return one line about states beyond the training data, or about unknown novelty; None without them.

    Args:
        prediction: predicted states.
        starts: starts of the prediction.
        space: description of the state components.
        from_numbers: whether the starts are numbers without units.
    """
    if prediction.novelty is None:
        return (
            "novelty: unknown, since these weights do not describe their training data. Train again to "
            "obtain it"
        )
    beyond = prediction.novelty > BEYOND
    if not bool(beyond.any()):
        return None
    row, sample = (int(k) for k in beyond.nonzero()[0])
    first = float(starts.times[row] + prediction.times[sample])
    whose = f" of {starts.names[row]}" if len(beyond) > 1 else ""
    fraction = float(beyond.double().mean())
    units = ""
    if from_numbers and bool(beyond[:, 0].any()):
        units = f". The numbers in start= are read as {', '.join(components_with_units(space))}"
    return (
        f"novelty: {in_percent(fraction)} of the predicted states lie beyond the training data, up to "
        f"{float(prediction.novelty.max()):.3g} times as far as its edge, first{whose} at t = "
        f"{duration(first, space)}. Errors there may be far larger than the bands{units}"
    )


def nonlinear_warnings(prediction: Prediction, starts: Starts, space: Space) -> list[str]:
    """Return lines about states whose errors do not propagate linearly: bands, then joint covariances.

    Args:
        prediction: predicted states.
        starts: starts of the prediction.
        space: description of the state components.
    """
    bands, joint = prediction.nonlinearity, prediction.joint_nonlinearity
    if bands is None or joint is None or prediction.samples is not None:
        return []
    outside = "the true state may lie outside the bands more often than they indicate"
    found = [
        f"{what}{_leaving(index, prediction, starts, space)}; {so}"
        for what, index, so in (
            ("bands", bands, outside),
            (
                "joint covariance",
                joint,
                f"its mean NEES is about {3 * float(joint.max()) ** 2:.2g} too large",
            ),
        )
        if bool((index > LINEAR).any())
    ]
    return [*found[:-1], *(f"{last}. samples=200 propagates sampled paths instead" for last in found[-1:])]


def _leaving(index: Tensor, prediction: Prediction, starts: Starts, space: Space) -> str:
    """Return from which time on an index of nonlinearity (B, T) exceeds `LINEAR`."""
    row, sample = (int(k) for k in (index > LINEAR).nonzero()[0])
    first = float(starts.times[row] + prediction.times[sample])
    whose = f" of {starts.names[row]}" if len(index) > 1 else ""
    return (
        f"{whose}: from about t = {duration(first, space)} on, errors are too large to propagate "
        f"linearly (index {float(index.max()):.2g}, linear up to {LINEAR:g})"
    )
