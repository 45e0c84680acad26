"""Numbers that float64 does not hold are refused before a training, and by name."""

from __future__ import annotations

import pytest
import torch
from helpers import MOLNIYA, SPRING

from ahnn.assimilation import StreamSensor
from ahnn.deviations import state_deviations
from ahnn.errors import UserError
from ahnn.measurements import Position, noise_deviations
from ahnn_plugins.ukf.plugin import UKFEvaluation

OPTIONS = {
    **{"cadence": 2, "times": None, "measurement": "position", "measurement_sd": None, "start_sd": None},
    **{"process_noise": "fitted", "alpha": 1.0, "beta": 2.0, "kappa": 0.0, "form": "square_root"},
    **{"gate": None, "patience": 5, "smoother": False, "least_squares": False, "tuning": None, "seed": 0},
}


def check(system=SPRING, **changes):
    UKFEvaluation(**(OPTIONS | changes)).check(system, system.space, 8)


@pytest.mark.parametrize("form", ["square_root", "standard"])
@pytest.mark.parametrize("system", [SPRING, MOLNIYA], ids=lambda system: system.name)
def test_numbers_of_a_usual_size_are_taken(form, system):
    for changes in (
        *({}, {"measurement_sd": 1e-5}, {"start_sd": [10.0, 1.0]}, {"process_noise": [0.0, 1e-9]}),
        *({"alpha": 1e-3}, {"gate": 0.9999}, {"process_noise": {"size": 1e-5, "memory": 100.0}}),
    ):
        check(system, form=form, **changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        *(({"measurement_sd": sd}, "measurement_sd: expected standard deviations") for sd in (1e300, 1e-300)),
        *(({"start_sd": [1.0, sd]}, "start_sd: expected standard deviations") for sd in (1e300, 1e-300)),
        ({"process_noise": [1e300, 1.0]}, "process_noise: expected standard deviations"),
        ({"measurement_sd": 1e-140}, "received a filter that is IMPRECISE after one measurement"),
        ({"start_sd": [1e-40, 1e-40]}, "received a filter that is COLLAPSED"),
        (
            {"start_sd": [1e9, 1e9], "measurement_sd": 1e-9, "form": "standard"},
            "(COLLAPSED|IMPRECISE) after one",
        ),
        ({"process_noise": {"size": 1e200, "memory": 1.0}}, "received a filter that"),
        ({"alpha": 1e-12}, "received a filter that is IMPRECISE"),
    ],
    ids=str,
)
def test_what_overflows_or_vanishes_is_refused_before_the_training(changes, message):
    with pytest.raises(UserError, match=message):
        check(**changes)


@pytest.mark.parametrize("sd", [1e300, 1e-300, 1e-160, 1e155])
def test_every_door_asks_for_squares_that_float64_holds(sd):
    space = SPRING.space
    for who, call in {
        "data.noise": lambda: noise_deviations(Position(1, "m"), sd, "data.noise"),
        "sd": lambda: StreamSensor.of(Position(1, "m"), sd, space),
        "start_sd": lambda: state_deviations([sd, 1.0], space, "start_sd"),
    }.items():
        with pytest.raises(UserError, match=f"{who}: expected standard deviations whose squares are"):
            call()
    small = torch.tensor([1e-9, 1e9], dtype=torch.float64)
    assert torch.equal(state_deviations([1e-9, 1e9], space, "s"), small)
