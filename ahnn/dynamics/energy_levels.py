"""Hidden units of a network, divided among coordinates whose energies differ by orders of magnitude.

The energy of a coordinate is the rate of its position times the range of its momentum, or the reverse. A
force on light coordinates is a small slope of a large energy, and a network unit with inputs of both kinds
bends this slope as much as heavy coordinates require. For H = E(heavy) + e F(heavy, light) with small e,
units for F take all coordinates as inputs and have output weights of order e; light coordinates enter units
for E with weights of order e. Initial weights follow this division. The attribute `unit` of a parameter, the
scale of second-order steps, preserves it.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import cast

import torch
from torch import Tensor, nn

from ahnn.dynamics.inputs import Angles, Cartesian, InputMap
from ahnn.dynamics.layered import Network
from ahnn.dynamics.networks import Perceptron
from ahnn.dynamics.scaling import UNEVEN
from ahnn.statistics import Statistics

ROUNDING = 1e-12
"""Relative energy below which a motion is attributed to rounding and has no level of its own."""


def coordinate_energies(statistics: Statistics) -> Tensor:
    """Return the energies of the n coordinates in the data, potential or kinetic, whichever is larger."""
    half = (statistics.maximum - statistics.minimum) / 2
    return (statistics.rate * half.roll(len(half) // 2)).unflatten(0, (2, -1)).amax(0)


def levels(energies: Tensor) -> Tensor:
    """Return for each energy, shape (n,), the largest energy of similar size, relative to the maximum."""
    relative = energies / energies.max()
    found, top = torch.ones_like(relative), 1.0
    for k in relative.argsort(descending=True).tolist():
        if float(relative[k]) > ROUNDING:
            top = float(relative[k]) if relative[k] * UNEVEN < top else top
            found[k] = top
    return found


def divide_units(network: Network, inputs: Iterable[InputMap], statistics: Statistics) -> None:
    """Divide the hidden units of a single-output perceptron among energy levels, if there are several.

    Args:
        network: network with newly initialised weights, which are scaled in place.
        inputs: maps whose concatenated outputs are the inputs of the network.
        statistics: statistics of the training split.
    """
    entering = levels(coordinate_energies(statistics))
    tops = entering.unique().flip(0)
    known = [energies_of(part, entering) for part in inputs]
    if len(tops) == 1 or not isinstance(network, Perceptron) or any(one is None for one in known):
        return
    entering = torch.cat([one for one in known if one is not None])
    for layer in cast("Iterable[nn.Linear]", (*network.hidden, network.output)):
        own = tops[torch.arange(layer.out_features) % len(tops)]
        scale(layer.weight, (entering / own.unsqueeze(1)).clamp(max=1))
        entering = own


def energies_of(inputs: InputMap, energies: Tensor) -> Tensor | None:
    """Return the coordinate energy for each output of an input map; None if outputs mix coordinates."""
    if isinstance(inputs, Angles):
        turning = energies[inputs.turning]
        return torch.cat((turning, turning, energies[inputs.straight]))
    return energies if isinstance(inputs, Cartesian) else None


@torch.no_grad()
def scale(parameter: Tensor, unit: Tensor) -> None:
    """Set a unit for each element of a parameter, and rescale the values to it."""
    unit = unit.to(parameter)
    parameter.mul_(unit / getattr(parameter, "unit", 1.0))
    vars(parameter)["unit"] = unit


def units_of(parameters: Iterable[Tensor]) -> Tensor | None:
    """Return the units of some parameters, concatenated, shape (P,); None if all are 1."""
    every = [*parameters]
    if not any(hasattr(parameter, "unit") for parameter in every):
        return None
    units = [getattr(parameter, "unit", torch.ones_like(parameter)).to(parameter) for parameter in every]
    return torch.cat([unit.detach().flatten() for unit in units])
