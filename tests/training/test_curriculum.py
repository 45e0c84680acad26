"""Which objective holds in an epoch, and which part of a batch a step is made on."""

from __future__ import annotations

import pytest
import torch
from helpers import SPRING, batch_of, build_model, close, data_module, ready_model

from ahnn.errors import UserError
from ahnn.training import Curriculum, FirstOrder, LevenbergMarquardt, Loss, LossOptions, SecondOrder
from ahnn.training.curriculum import Phase, make_curriculum, windowed
from ahnn.training.objectives import PARTS, Derivative, Recursive
from ahnn.training.shooting import Shooting
from ahnn.training.steppers import problems, stepper_of
from ahnn.training.weak import Weak


def unit_loss(**options):
    return Loss(2, LossOptions(**options)).double()


def test_each_phase_holds_up_to_its_share_of_the_epochs():
    first, second, third = (Recursive(unit_loss(), w) for w in (1, 2, 3))
    curriculum = Curriculum([Phase(0.2, first), Phase(0.5, second), Phase(1.0, third)], third, 3)
    held = [curriculum.at(epoch, 10) for epoch in range(12)]
    assert held == [first] * 2 + [second] * 3 + [third] * 7
    assert [curriculum.at(epoch, 3) for epoch in range(3)] == [first, second, third]


@pytest.mark.parametrize("share", [0.0, 0.25, 1.0])
def test_derivatives_come_first_for_their_share(share):
    curriculum = windowed(unit_loss(derivative=share, order=6), 4)
    held = [curriculum.at(epoch, 8) for epoch in range(8)]
    count = round(8 * share)
    assert all(isinstance(o, Derivative) and o.order == 6 for o in held[:count])
    assert all(isinstance(o, Recursive) and o.window == 4 for o in held[count:])
    assert curriculum.span == (4 if share == 0 else 6)


@pytest.mark.parametrize(("epochs", "count"), [(5, 4), (2, 1), (1, 0), (20, 18)])
def test_predictions_end_every_training_that_has_them(epochs, count):
    curriculum = windowed(unit_loss(derivative=0.9), 1)
    held = [isinstance(curriculum.at(epoch, epochs), Derivative) for epoch in range(epochs)]
    assert held == [True] * count + [False] * (epochs - count)


def test_a_model_begins_with_the_objective_of_the_first_epoch():
    assert isinstance(build_model("generic", SPRING, loss={"derivative": 0.5}).objective, Derivative)
    assert isinstance(build_model("generic", SPRING).objective, Recursive)


def test_objectives_look_at_no_more_steps_than_they_span(cache):
    batch = batch_of(data_module(SPRING, cache, window=8))
    model = ready_model("generic", data_module(SPRING, cache, window=3))
    for objective, span in ((Recursive(model.loss, 3), 3), (Derivative(model.loss, 4), 4)):
        cut = batch._replace(increments=batch.increments[:, :span])
        close(objective.residuals(model.dynamics, batch), objective.residuals(model.dynamics, cut), 0.0)
        theta = torch.nn.utils.parameters_to_vector(model.dynamics.parameters()).detach()
        parts = [objective.problem(model.dynamics, b).residuals(theta) for b in (batch, cut)]
        close(*parts, 0.0)
        close(parts[0], objective.residuals(model.dynamics, batch).flatten(), 1e-13)


@pytest.mark.parametrize("window", [1, 3, 10])
@pytest.mark.parametrize("count", [1, 4, 5, 9, 32, 60])
def test_a_fifth_of_a_batch_makes_the_step_and_the_rest_checks_it(cache, count, window):
    assert PARTS == 5
    batch = batch_of(data_module(SPRING, cache), 32)
    rows = torch.arange(count) % 32
    batch = batch._replace(start=batch.start[rows], increments=batch.increments[rows])
    step, check = (part.start for part in Recursive(unit_loss(), window).divided(batch))
    assert len(step) == max(1, count // (5 * window))
    assert torch.equal(torch.cat((step, check)), batch.start)
    assert len(Derivative(unit_loss(), 4).divided(batch)[0].start) == max(1, count // 5)


STAGES = [["weak", 0.25, 8], [4, 0.5], ["whole", 1.0, 3]]


def test_stages_of_measurements_are_objectives_and_whole_trajectories_judge():
    _, curriculum = make_curriculum(2, 5, {"stages": STAGES, "robust": "huber"})
    held = [curriculum.at(epoch, 8) for epoch in range(8)]
    assert [type(o) for o in held] == [Weak, Weak, *[Shooting] * 6]
    assert [curriculum.intervals(epoch, 8) for epoch in range(8)] == [None, None, 4, 4, *[None] * 4]
    assert [curriculum.segments_per_step(epoch, 8) for epoch in range(8)] == [8, 8, None, None, *[3] * 4]
    assert {o.robust for o in (*held, curriculum.judge)} == {"huber"}
    assert curriculum.judge.intervals is None


@pytest.mark.parametrize(
    "stages",
    [
        [],
        [[4, 0.5]],
        [[4, 0.5], [8, 0.5], ["whole", 1.0]],
        [[4, 0.8], [8, 0.6], ["whole", 1.0]],
        [[2, 1.0]],
        [["every", 1.0]],
        [[4]],
        [[4, "1.0"]],
        [[4, -1.0], ["whole", 1.0]],
        [[4, 0.5], ["all", 1.0]],
        [[4, 1.0, 0]],
        [[4, 1.0, 2.5]],
        [[4, 1.0, 2, 2]],
    ],
)
def test_stages_that_do_not_cover_a_training_are_refused(stages):
    with pytest.raises(UserError, match="stages: expected"):
        make_curriculum(2, 5, {"stages": stages})


@pytest.mark.parametrize(
    "stages",
    [[[3, 1.0]], [[3, 1.0, 1]], [["whole", 1]], [["weak", 1e-3], ["relative", 0.5], [3, 0.6], [3, 1.0]]],
)
def test_the_least_that_covers_a_training_is_taken(stages):
    _, curriculum = make_curriculum(2, 5, {"stages": stages})
    assert [phase.until for phase in curriculum.phases] == [until for _, until, *_ in stages]
    assert curriculum.at(0, 1000) is curriculum.phases[0].objective
    assert curriculum.at(999, 1000) is curriculum.phases[-1].objective


def test_first_order_steps_weigh_their_batch_and_second_order_steps_hand_over_problems(cache):
    data = data_module(SPRING, cache)
    model, batch = ready_model("generic", data), batch_of(data)
    value = FirstOrder().step(model.objective, model.loss, model.dynamics, batch, None)
    close(value, model.loss(model.objective.residuals(model.dynamics, batch)), 0.0)
    for weight in (0.0, 0.75):
        weighed = batch._replace(weight=weight)
        got = FirstOrder().step(model.objective, model.loss, model.dynamics, weighed, None)
        assert float(got.detach()) == pytest.approx(weight * float(value.detach()), rel=1e-14)
    optimizer = LevenbergMarquardt(model.dynamics.parameters())
    before = problems(model.objective, model.dynamics, batch)[0].residuals(
        torch.nn.utils.parameters_to_vector(model.dynamics.parameters()).detach()
    )
    loss = SecondOrder().step(model.objective, model.loss, model.dynamics, batch, optimizer)
    close(loss, before.square().mean(), 1e-13)


def test_an_optimiser_names_its_stepper():
    parameters = [torch.nn.Parameter(torch.zeros(1))]
    assert isinstance(stepper_of(LevenbergMarquardt(parameters)), SecondOrder)
    assert isinstance(stepper_of(torch.optim.SGD(parameters, lr=1.0)), FirstOrder)
    assert FirstOrder.automatic
    assert not SecondOrder.automatic
