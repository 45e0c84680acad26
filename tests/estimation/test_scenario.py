"""Simulated measurements and arcs of trajectories."""

from __future__ import annotations

import torch

from ahnn.data.generate import generate
from ahnn.estimation import Setting, perturbed_arcs
from ahnn.measurements import Position
from ahnn.systems import Molniya


def test_validation_arcs_spread_over_their_trajectories() -> None:
    system = Molniya(name="orbits", dt=60.0, steps=40)
    data = generate(system, 3, seed=0)
    setting = Setting(Position(), torch.ones(3).double(), system.deviations(), tuple(range(5, 61, 5)))
    arcs = perturbed_arcs(setting, data.states, data.dt, 3, steps=10, seed=0)
    for b, begin in enumerate((0, 15, 30)):
        assert torch.equal(arcs.truth[b], data.states[b, begin : begin + 11])
    measured = arcs.measurements.isfinite().all(-1)
    assert measured[:, [4, 9]].all()
    assert int(measured.sum()) == 6
