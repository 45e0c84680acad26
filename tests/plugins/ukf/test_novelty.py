"""A force error that grows with the novelty: the law, and a filter that it saves outside of the training."""

from __future__ import annotations

import math

import pytest
import torch
from helpers import close

from ahnn.errors import UserError
from ahnn.estimation import Setting, force_error_fit, simulated
from ahnn.estimation.consistency import nees
from ahnn.estimation.force_error import ForceError
from ahnn.estimation.force_error_fit import fitted_force_error
from ahnn.estimation.scenario import Problem
from ahnn.estimation.trial import Filter, assimilate
from ahnn.measurements import Position
from ahnn.types import Trajectories
from ahnn.uncertainty import growth
from ahnn_plugins.ukf import UnscentedKalmanFilter

F64 = torch.float64
DT, STEPS = 0.05, 400


def swing(x, dt, hardening):
    """Leapfrog of q'' = -q - a q^3."""
    q, p = x.chunk(2, dim=-1)
    force = lambda q: -q - hardening * q**3  # noqa: E731
    p = p + dt / 2 * force(q)
    q = q + dt * p
    return torch.cat((q, p + dt / 2 * force(q)), dim=-1)


def truth(x, dt):
    return swing(x, dt, 0.1)


def learned(x, dt):
    """Right up to |q| = 1 and, as networks are, flat in what it has not seen."""
    q, p = x.chunk(2, dim=-1)
    flat = q.clamp(-1, 1)
    force = lambda q: -q - 0.1 * flat * q**2  # noqa: E731
    p = p + dt / 2 * force(q)
    q = q + dt * p
    return torch.cat((q, p + dt / 2 * force(q)), dim=-1)


def novelty(x):
    return x[..., :1].abs().squeeze(-1)


def grown(x):
    return growth(novelty(x), 500.0)


def problem(setting, size):
    start = size * torch.tensor([[1.0, 0.0], [-0.9, 0.2], [0.0, 1.0], [0.7, -0.7]], dtype=F64).repeat(5, 1)
    states = [start]
    for _ in range(STEPS):
        states.append(truth(states[-1], DT))
    along = torch.stack(states, dim=1)
    draw = torch.randn(20, 2, generator=torch.Generator().manual_seed(0), dtype=F64)
    return Problem(along, start + draw * setting.start_sd, simulated(setting, along, DT, 1), DT)


SETTING = Setting(Position(1), torch.tensor([0.01], dtype=F64), torch.tensor([0.01, 0.01], dtype=F64),
                  tuple(range(10, STEPS + 1, 10)))  # fmt: skip


def consistency(error, size):
    chosen = Filter("f", learned, torch.zeros(2, 2, dtype=F64), torch.tensor([[1e-4]], dtype=F64),
                    UnscentedKalmanFilter(), force_error=error)  # fmt: skip
    given = problem(SETTING, size)
    result = assimilate(chosen, SETTING, given)
    assert not bool(result.status.any())
    return float(nees(result.means - given.truth[:, 1:], result.chols)[:, 10:].mean())


def test_the_kick_grows_at_the_state_before_the_step():
    size, memory = 0.3, 2.0
    plain, more = ForceError(size, memory), ForceError(size, memory, growth=grown)
    x = torch.tensor([[0.5, 0.2, 0.1], [2.0, 0.2, 0.1]], dtype=F64)
    one, other, alone = plain.flow(truth)(x, DT), more.flow(truth)(x, DT), truth(x[:, :2], DT)
    close(other[0], one[0], 1e-15)
    close(other[1, :2] - alone[1], 501 * (one[1, :2] - alone[1]), 1e-9)
    close(other[:, 2], one[:, 2], 1e-15)
    assert float(one[0, 2]) == pytest.approx(0.1 * math.exp(-DT / memory), rel=1e-12)


def test_it_saves_the_filter_outside_of_the_training_and_costs_nothing_inside():
    plain = ForceError(1e-3, 1.0)
    more = plain._replace(growth=grown)
    assert consistency(plain, 0.8) == pytest.approx(consistency(more, 0.8), rel=1e-3)
    assert consistency(plain, 3.0) > 20  # 2 if consistent
    assert 0.2 < consistency(more, 3.0) < 4


def test_the_fit_of_the_size_keeps_the_growth():
    chosen = Filter("f", learned, torch.zeros(2, 2, dtype=F64), torch.tensor([[1e-4]], dtype=F64),
                    UnscentedKalmanFilter())  # fmt: skip
    given = problem(SETTING, 1.1)
    times = DT * torch.arange(STEPS + 1, dtype=F64).expand(20, -1)
    fit = fitted_force_error(chosen, SETTING, given, Trajectories(given.truth, times), 1.0, growth=grown)
    assert fit.error.growth is grown
    scaled = chosen._replace(force_error=fit.error).scaled(4.0).force_error
    assert scaled is not None
    assert scaled.growth is grown


def test_what_cannot_grow_is_refused():
    from ahnn.cli.build import plain_config
    from ahnn.cli.compose import compose_job
    from ahnn.evaluation.estimators.noise_options import grown as of_rate
    from ahnn_plugins.ukf.plugin import UKFEvaluation

    options = plain_config(compose_job(["plugins=ukf"], "x").plugins.ukf)
    del options["_target_"]
    options["measurement"] = "position"
    with pytest.raises(UserError, match=r"novelty: expected process_noise=force_error.*received fitted"):
        UKFEvaluation(**options | {"novelty": 500.0})
    with pytest.raises(UserError, match=r"novelty: expected float >= 0 or None"):
        UKFEvaluation(**options | {"novelty": "much"})

    with pytest.raises(UserError, match=r"novelty: expected weights that describe their training data"):
        of_rate(None, 500.0)
    assert of_rate(None, None) is None


def test_a_scale_is_one_of_the_variance(monkeypatch):
    chosen = Filter("f", learned, torch.zeros(2, 2, dtype=F64), torch.tensor([[1e-4]], dtype=F64),
                    UnscentedKalmanFilter())  # fmt: skip
    monkeypatch.setattr(force_error_fit, "mean_nees", lambda *_: [1.0])
    monkeypatch.setattr(force_error_fit, "crossing", lambda *_: 9.0)
    given = problem(SETTING, 1.1)
    times = DT * torch.arange(STEPS + 1, dtype=F64).expand(20, -1)
    truth = Trajectories(given.truth, times)
    seen = float(force_error_fit.force_errors(learned, truth, DT).square().mean()) ** 0.5
    fit = fitted_force_error(chosen, SETTING, given, truth, 1.0)
    assert fit.error.size == pytest.approx(3 * seen, rel=1e-9)
    assert fit.scale == 9.0


def test_errors_of_a_force_are_over_the_growth_at_the_state_before():
    states = torch.randn(3, 7, 4, generator=torch.Generator().manual_seed(0), dtype=F64)
    given = Trajectories(states, DT * torch.arange(7, dtype=F64).expand(3, -1))
    by = lambda x: 2 + x[..., 0].square()  # noqa: E731
    plain = force_error_fit.force_errors(lambda x, dt: 0.5 * x + dt, given, DT)
    close(
        force_error_fit.force_errors(lambda x, dt: 0.5 * x + dt, given, DT, by),
        plain / by(states[:, :-1])[..., None],
        1e-12,
    )
    predicted = 0.5 * states[:, :-1] + DT
    moved = (predicted - states[:, :-1])[..., 2:]
    close(plain, (states[:, 1:] - predicted)[..., 2:] / moved.square().sum(-1, keepdim=True).sqrt(), 1e-12)
