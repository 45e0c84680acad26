"""Figure of a prediction: components with bands, standard deviations, and novelty."""

from __future__ import annotations

import torch
from matplotlib.figure import Figure

from ahnn.evaluation import style
from ahnn.labels import physical_components, quantity
from ahnn.prediction.propagation import Prediction
from ahnn.types import Space
from ahnn.uncertainty import BEYOND

SIGMAS = 3
"""Half-width of the band, in standard deviations."""
PLOTTED = 300
"""Number of sampling intervals in a plot if no times are given."""


def prediction_figure(prediction: Prediction, space: Space, title: str, about: str = "") -> Figure:
    """Plot the first predicted trajectory: positions, velocities, standard deviations, and novelty.

    The standard deviations of positions have their own panel, since a band of 100 m is invisible on an orbit.

    Args:
        prediction: predicted states.
        space: description of the state components.
        title: title of the figure.
        about: frame and first epoch, below the title; "" without.
    """
    banded, far = prediction.deviations is not None, prediction.novelty is not None
    figure = style.canvas(8, 8 if not (banded and far) else 9.5)
    panels = figure.subplots(2 + banded + far, 1, sharex=True)
    size, clock = style.plotted_time(float(prediction.times[-1] - prediction.times[0]), space.units.time)
    time, n = prediction.times / size, space.dof
    colours = (style.BLUE, style.VERMILLION, style.GREEN, style.PURPLE, style.ORANGE, style.SKY)
    for k, name in enumerate(physical_components(space)):
        axes, scale = panels[k // n], 1 / float(space.scales[k])
        value, colour = prediction.states[0, :, k] * scale, colours[k % n % len(colours)]
        axes.plot(time, value, color=colour, label=name)
        if prediction.deviations is not None:
            sd = prediction.deviations[0, :, k] * scale
            axes.fill_between(time, value - SIGMAS * sd, value + SIGMAS * sd, color=colour, alpha=0.25, lw=0)
            if k < n:
                panels[2].semilogy(time, sd.where(sd > 0, torch.nan), color=colour, label=name)
    if prediction.novelty is not None:
        panels[-1].plot(time, prediction.novelty[0], color=style.BLACK)
        panels[-1].axhline(BEYOND, color=style.VERMILLION, ls="--", lw=1, label="limit of the\ntraining data")
        panels[-1].set_ylabel("novelty")
        panels[-1].set_ylim(bottom=0)
    for axes in panels:
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
        axes.grid(alpha=0.3)
    for axes, block in zip(panels, ("position", "velocity"), strict=False):
        name, unit = quantity(space, block)
        axes.set_ylabel(f"{name} [{unit}]")
    if banded:
        panels[2].set_ylabel("standard deviation\n[{}]".format(quantity(space, "position")[1]))
    style.label_time(panels[-1], style.Axis(time, clock))
    panels[-1].set_xlabel(f"time after the start [{clock}]")
    title = title if prediction.deviations is None else f"{title}, with {SIGMAS} sigma"
    panels[0].set_title(f"{title}\n{about}".rstrip())
    return figure
