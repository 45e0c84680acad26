"""The learning-rate schedule gives the reference values of the paper's source to twelve digits."""

from __future__ import annotations

from functools import partial

import pytest
import torch

from ahnn.errors import UserError
from ahnn.training import ExpHyperbolicLR

# (N, U): {epoch: rate} for eta_0 = 1e-3, eta_inf = 1e-6, of facts.md 1; there (50, 350) at epoch 49 is
# printed ten times too large (4.6e-4): h(49) - h(0) = -0.44503 gives 1e-3 * 1000**-0.44503 = 4.62e-5.
REFERENCE = {
    (250, 350): {
        0: 1.000000000000000e-03,
        1: 9.796131104104356e-04,
        2: 9.596367795335280e-04,
        10: 8.136545424973608e-04,
        50: 3.543411288693672e-04,
        125: 7.123314477616881e-05,
        200: 1.211630800863823e-05,
        249: 1.764316236167723e-06,
        250: 1.333691727873386e-06,
    },
    (50, 350): {1: 9.622600229628591e-04, 10: 6.701813075945393e-04, 49: 4.622691309930723e-05},
    (250, 250): {125: 3.162277660168380e-05, 250: 1e-06},
}


def optimizer(lr=1e-3):
    return torch.optim.SGD([torch.nn.Parameter(torch.zeros(1))], lr=lr)


def make(n, u):
    return partial(ExpHyperbolicLR, max_epochs=n, upper_bound=u, infimum_lr=1e-6)


def epoch(opt, schedule):
    opt.step()
    schedule.step()


@pytest.mark.parametrize("setting", REFERENCE)
def test_stepping_per_epoch_gives_the_reference_values(setting):
    opt = optimizer()
    schedule = make(*setting)(opt)
    rates = []
    for _ in range(setting[0] + 1):
        rates.append(opt.param_groups[0]["lr"])
        epoch(opt, schedule)
    for n, rate in REFERENCE[setting].items():
        assert rates[n] == pytest.approx(rate, rel=1e-12)
    assert rates == sorted(rates, reverse=True)


def test_a_reloaded_schedule_goes_on_with_the_same_rates():
    opt, again = optimizer(), optimizer()
    schedule = make(250, 350)(opt)
    for _ in range(124):
        epoch(opt, schedule)
    resumed = make(250, 350)(again)
    again.load_state_dict(opt.state_dict())
    resumed.load_state_dict(schedule.state_dict())
    epoch(again, resumed)
    assert again.param_groups[0]["lr"] == pytest.approx(7.123314477616881e-05, rel=1e-12)


def test_epochs_beyond_the_last_keep_its_rate():
    opt = optimizer()
    schedule = make(5, 8)(opt)
    for _ in range(5):
        epoch(opt, schedule)
    last = opt.param_groups[0]["lr"]
    epoch(opt, schedule)
    assert opt.param_groups[0]["lr"] == last


def test_each_group_has_its_own_initial_rate():
    groups = [{"params": [torch.nn.Parameter(torch.zeros(1))], "lr": lr} for lr in (1e-3, 1e-2)]
    opt = torch.optim.SGD(groups)
    schedule = make(10, 10)(opt)
    for _ in range(10):
        epoch(opt, schedule)
    assert [group["lr"] for group in opt.param_groups] == pytest.approx([1e-6, 1e-6], rel=1e-12)


@pytest.mark.parametrize(
    ("change", "received"),
    [
        ({"upper_bound": 9.0}, "upper_bound=9.0"),
        ({"max_epochs": 0, "upper_bound": 5.0}, "max_epochs: expected int >= 1; received 0"),
        ({"infimum_lr": 1e-3}, "infimum_lr=0.001"),
        ({"infimum_lr": 0.0}, "infimum_lr: expected float > 0; received 0.0"),
    ],
)
def test_impossible_settings_are_refused_with_what_came(change, received):
    options = {"max_epochs": 10, "upper_bound": 10.0, "infimum_lr": 1e-6} | change
    with pytest.raises(UserError, match=received):
        ExpHyperbolicLR(optimizer(), **options)


def test_a_training_of_one_epoch_has_a_schedule():
    opt = optimizer()
    schedule = make(1, 1)(opt)
    epoch(opt, schedule)
    assert opt.param_groups[0]["lr"] == pytest.approx(1e-6, rel=1e-12)
