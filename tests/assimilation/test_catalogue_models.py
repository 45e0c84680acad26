"""A catalogue with what a filter of one object may have: other filters, errors as states, clocks, biases."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import ahnn
from ahnn.assimilation import Assimilation, Catalogue, Process, Reading, StreamSensor
from ahnn.errors import UserError
from ahnn.estimation import Belief, initial_belief
from ahnn.estimation.force_error import ForceError
from ahnn.estimation.parameter_error import ParameterError
from ahnn.measurements import GroundStation, Position
from ahnn.systems.truth import exact_flow
from ahnn_plugins.ekf import ExtendedKalmanFilter
from ahnn_plugins.enkf import EnsembleKalmanFilter
from ahnn_plugins.ukf import UnscentedKalmanFilter, online_process

RUN = ahnn.load("molniya_mechanical")
FIRST = torch.tensor([0.0, -3145.0, -6173.0, 10.0, 0.0, 0.0], dtype=torch.float64)
STARTS = FIRST + torch.arange(3)[:, None] * torch.tensor([90.0, 40.0, 20.0, 0.01, 0.0, 0.0]).double()
BELIEF = initial_belief(STARTS, np.diag([1.0] * 3 + [1e-6] * 3))
BEGUN = [0.0, 3.0, -20.0]
Q = torch.diag(torch.tensor([1e-3] * 3 + [1e-5] * 3, dtype=torch.float64) ** 2)
GNSS = {"gnss": StreamSensor.of(Position(), 0.1, RUN.space)}
STATION = {"radar": StreamSensor.of(GroundStation(67.9, 21.0), [0.1, 1e-3, 1e-3], RUN.space)}
BIASED = {"gnss": StreamSensor.of(Position(), 0.1, RUN.space, bias_sd=0.3, bias_memory=500.0)}


def pushes(x):
    """What two parameters add to the field."""
    return 1e-6 * torch.stack((x, x.flip(-1)), -1)


class Driven:
    """A body in a field that turns with time."""

    clock = 1

    def __call__(self, z, dt):
        """Return the extended states after dt."""
        q, t, p, _ = z.split((3, 1, 3, 1), dim=-1)
        step = dt.unsqueeze(-1) if isinstance(dt, torch.Tensor) and dt.ndim else dt
        pushed = p + 1e-3 * step * torch.cat((torch.sin(t / 300), torch.cos(t / 300), t / 1e3), dim=-1)
        return torch.cat((q + step * pushed, t + step, pushed, torch.ones_like(t)), dim=-1)


def made(kind):
    """A process and its sensors."""
    flow, error, sensors, estimator = RUN.dynamics, None, GNSS, UnscentedKalmanFilter()
    if kind == "extended":
        estimator = ExtendedKalmanFilter()
    if kind == "driven":
        flow = Driven()
    if kind == "station":
        sensors = STATION
    if kind == "biased":
        sensors = BIASED
    if kind == "force error":
        error = ForceError(1e-3, 1800.0)
    if kind == "parameter error":
        error = ParameterError(pushes, 2)
    return online_process(estimator, flow, 60.0, Q, error), sensors


KINDS = ["extended", "driven", "station", "biased", "force error", "parameter error"]


@pytest.mark.parametrize("kind", KINDS)
def test_each_object_is_as_alone(kind):
    process, sensors = made(kind)
    ((_, sensor),) = sensors.items()
    names, draw = ["a", "b", "c"], np.random.default_rng(0)
    times = np.cumsum(draw.uniform(5.0, 150.0, (4, 3)), axis=0)
    catalogue = Catalogue(process, sensors, BELIEF, names, times=BEGUN)
    alone = [
        Assimilation(process, sensors, Belief(BELIEF.mean[b : b + 1], BELIEF.chol[b : b + 1]), time=time)
        for b, time in enumerate(BEGUN)
    ]
    for row in times:
        x = [RUN.rollout(STARTS[b : b + 1], 1, float(t) - BEGUN[b])[0, -1] for b, t in enumerate(row)]
        noise = 0.05 * torch.from_numpy(draw.normal(size=(3, 3))) * (kind != "station")
        seen = [sensor.measurement(x[b], float(t)) for b, t in enumerate(row)]
        y = torch.stack(seen) + noise
        found = catalogue.update(catalogue.table(names, row, y))
        for b, time in enumerate(row.tolist()):
            estimate = alone[b].update(Reading(time, tuple(y[b].tolist())))
            assert found.outcomes[b] == estimate.outcome
            sd = estimate.covariance.diagonal().sqrt()
            for part in (slice(3), slice(3, 6)):
                off = (found.means[b, part] - estimate.mean[part]).abs()
                assert bool((off < 1e-12 * estimate.mean[part].norm() + 1e-8 * sd[part]).all())
            apart = (found.covariances[b] - estimate.covariance) / torch.outer(sd, sd)
            assert float(apart.abs().max()) < 1e-8


def test_an_exact_flow_takes_the_step_of_each_member_alone():
    system = ahnn.systems.Molniya(**{k: v for k, v in RUN.config["system"].items() if k[0] != "_"})
    compiled = exact_flow(system)
    lengths = torch.tensor([10.0, 200.0, 59.0], dtype=torch.float64)
    for flow in (compiled, compiled.flow):
        whole = flow(STARTS, lengths)
        single = torch.cat([flow(STARTS[b : b + 1], float(dt)) for b, dt in enumerate(lengths)])
        assert torch.allclose(whole, single, rtol=1e-13, atol=0.0)


def test_what_many_objects_cannot_have_is_refused():
    process, sensors = made("plain")
    ensemble = online_process(EnsembleKalmanFilter(), RUN.dynamics, 60.0, Q)
    with pytest.raises(UserError, match="process: expected a Gaussian filter"):
        Catalogue(ensemble, sensors, BELIEF, ["a", "b", "c"])
    with pytest.raises(UserError, match="start: expected beliefs about 2 objects; received 3"):
        Catalogue(process, sensors, BELIEF, ["a", "b"])
    with pytest.raises(UserError, match="objects: expected each name once; received 'a' twice"):
        Catalogue(process, sensors, BELIEF, ["a", "b", "a"])
    with pytest.raises(UserError, match="start: expected one belief if no objects are named"):
        Catalogue(process, sensors, BELIEF)
    catalogue = Catalogue(process, sensors, BELIEF, ["a", "b", "c"])
    with pytest.raises(UserError, match=r"values: expected shape \(1, 3\); received \(1, 2\)"):
        catalogue.table(["a"], [1.0], [[1.0, 2.0]])
    with pytest.raises(UserError, match="readings: expected finite times and values"):
        catalogue.update(catalogue.table(["a"], [np.nan], [[1.0, 2.0, 3.0]]))
    with pytest.raises(UserError, match="sensor: expected one of gnss; received 'radar'"):
        catalogue.table(["a"], [1.0], [[1.0, 2.0, 3.0]], "radar")
    assert isinstance(process, Process)
