"""A training that ended far from its optimum: more epochs are the first remedy, before any noise."""

from __future__ import annotations

import pytest
from cases import SPRING, Learned, make_case
from test_goodness_of_fit import measured

from ahnn.evaluation.run import evaluate
from ahnn.evaluation.shortfall import shortfall

SHORT = {"val_loss": 1.01, "trained": {"loss": 5.67, "epochs": 3}}


@pytest.mark.parametrize(
    ("about", "far"),
    [
        (SHORT, True),
        (SHORT | {"val_loss": 5.6}, False),  # the noise is 2.4 times what is stated: no epochs help
        ({"val_loss": 1.0, "trained": {"loss": 1.6, "epochs": 10}}, False),
        ({"val_loss": 1.0}, False),  # of an earlier version
        ({"val_loss": None, "trained": {"loss": 5.0, "epochs": 3}}, False),
    ],
)
def test_the_closing_stage_shows_how_far_the_training_came(about, far):
    said = shortfall(about)
    assert bool(said) == far
    if far:
        assert said.startswith("the training ended far from its optimum: validation loss 5.67")
        assert said.endswith("Train longer first: trainer.max_epochs=12")


@pytest.mark.parametrize("wrong", [True, False])
def test_more_epochs_come_first_and_only_where_the_residuals_are_more_than_noise(tmp_path, wrong):
    flow = Learned(5.6 if wrong else SPRING.stiffness)
    case = make_case(tmp_path, measured=measured(count=12), flow=flow, shortfall=shortfall(SHORT))
    found = evaluate(case, {}, figures=False).numbers["verdict"]["findings"]
    assert next(iter(found[1:]), "").startswith("the training ended far") == wrong
    assert any(one.startswith("if it remains after a longer training: ") for one in found[2:]) == wrong
    assert wrong or not any("longer" in one for one in found)
