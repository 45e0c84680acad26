"""Jobs of a sweep that differ in nothing that a training depends on are named."""

from __future__ import annotations

import pytest

from ahnn.cli.commandline import check, read

STAGED = "sensor=spring_states"


@pytest.mark.parametrize(
    ("sweep", "twins"),
    [
        ([STAGED, "model=hnn,ahnn"], 1),
        ([STAGED, "model=hnn,ahnn,ahnn3"], 2),
        ([STAGED, "model=hnn,ahnn", "hamiltonian=mechanical,generic"], 1),
        ([STAGED, "model=hnn,node"], 0),
        (["model=hnn,ahnn"], 0),
        (["model=hnn,ahnn", "loss=derivative"], 1),
        (["model=hnn,ahnn", "loss=derivative", "callbacks.best.monitor=val/loss"], 0),
        (["model=hnn,ahnn", "recipe=first_order"], 0),
        (["integrator=rk4,midpoint"], 0),
    ],
)
def test_trainings_of_the_same_weights_are_named_before_the_sweep(sweep, twins, caplog):
    check(read(["-m", *sweep, "budget=smoke"]), "train")
    said = [record.message for record in caplog.records if "train the same weights" in record.message]
    assert len(said) == twins
    if twins:
        assert "model=hnn" in said[0]
