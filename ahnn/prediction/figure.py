"""Figure of a prediction: components with bands, and novelty."""

from __future__ import annotations

from matplotlib.figure import Figure

from ahnn.evaluation import style
from ahnn.labels import quantity
from ahnn.prediction.prediction_table import labels
from ahnn.prediction.propagation import Prediction
from ahnn.types import Space

SIGMAS = 3
"""Half-width of the band, in standard deviations."""
PLOTTED = 300
"""Number of sampling intervals in a plot if no times are given."""


def prediction_figure(prediction: Prediction, space: Space, title: str, about: str = "") -> Figure:
    """Plot the first predicted trajectory: positions, velocities, and novelty.

    Args:
        prediction: predicted states.
        space: description of the state components.
        title: title of the figure.
        about: frame and first epoch, below the title; "" without.
    """
    figure = style.canvas(8, 8)
    panels = figure.subplots(2 if prediction.novelty is None else 3, 1, sharex=True)
    size, clock = style.plotted_time(float(prediction.times[-1] - prediction.times[0]), space.units.time)
    time, n = prediction.times / size, space.dof
    colours = (style.BLUE, style.VERMILLION, style.GREEN, style.PURPLE, style.ORANGE, style.SKY)
    for k, name in enumerate(labels(space)):
        axes, scale = panels[k // n], 1 / float(space.scales[k])
        value, colour = prediction.states[0, :, k] * scale, colours[k % n % len(colours)]
        axes.plot(time, value, color=colour, label=name)
        if prediction.deviations is not None:
            half = SIGMAS * prediction.deviations[0, :, k] * scale
            axes.fill_between(time, value - half, value + half, color=colour, alpha=0.25, lw=0)
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
        axes.grid(alpha=0.3)
    if prediction.novelty is not None:
        panels[2].plot(time, prediction.novelty[0], color=style.BLACK)
        panels[2].axhline(1.0, color=style.VERMILLION, ls="--", lw=1, label="edge of the\ntraining data")
        panels[2].set_ylabel("novelty")
        panels[2].set_ylim(bottom=0)
        panels[2].legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    for axes, block in zip(panels, ("position", "velocity"), strict=False):
        name, unit = quantity(space, block)
        axes.set_ylabel(f"{name} [{unit}]")
    style.label_time(panels[-1], style.Axis(time, clock))
    panels[-1].set_xlabel(f"time after the start [{clock}]")
    title = title if prediction.deviations is None else f"{title}, with {SIGMAS} sigma"
    panels[0].set_title(f"{title}\n{about}".rstrip())
    return figure
