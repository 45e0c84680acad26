"""From options to a setting: which samples are measured, and how well."""

from __future__ import annotations

import copy
from types import SimpleNamespace

import pytest
import torch
from helpers import MOLNIYA, SPRING, SYSTEMS

from ahnn.errors import UserError
from ahnn.estimation.online import weights_hash
from ahnn.estimation.setting import make_setting

HEAVY = SYSTEMS["heavy_spring"]


def setting(system=SPRING, steps=8, **changes):
    options = {
        "measurement": "position",
        "measurement_sd": None,
        "start_sd": None,
        "cadence": 2,
        "times": None,
    }
    return make_setting(system, steps, **(options | changes))


@pytest.mark.parametrize(
    ("cadence", "updates"), [(1, (1, 2, 3, 4, 5, 6, 7, 8)), (3, (3, 6)), (4, (4, 8)), (5, (5,)), (8, (8,))]
)
def test_every_so_many_steps_up_to_the_last(cadence, updates):
    assert setting(cadence=cadence).updates == updates


def test_times_are_samples_from_the_first_step_to_the_last():
    dt = SPRING.dt
    assert setting(times=[dt, 3 * dt, 8 * dt]).updates == (1, 3, 8)
    assert setting(times=[2 * dt * (1 + 4e-7)]).updates == (2,)
    for wrong in ([0.0], [9 * dt], [dt, dt], [3 * dt, 2 * dt], [dt * (1 + 3e-6)], [float("inf")], []):
        with pytest.raises(UserError, match="times: expected increasing multiples of dt"):
            setting(times=wrong)


def test_deviations_are_the_systems_own_or_those_given():
    own = setting()
    assert own.measurement_sd.tolist() == [SPRING.noise.measurement]
    assert torch.equal(own.start_sd, SPRING.deviations())
    given = setting(HEAVY, start_sd=[0.2, 0.3], measurement_sd=0.05)
    assert given.start_sd.tolist() == [0.2, 0.3]
    assert given.measurement_sd.tolist() == [0.05]
    wide = setting(MOLNIYA, measurement="state", measurement_sd=[1, 2, 3, 4, 5, 6], start_sd=[1.0, 1e-3])
    assert wide.measurement_sd.tolist() == [1, 2, 3, 4, 5, 6]
    assert wide.start_sd.tolist() == [1.0] * 3 + [1e-3] * 3
    for wrong in (0.0, -1.0, float("inf"), [1.0, 2.0], []):
        with pytest.raises(UserError, match=r"measurement_sd: expected .*> 0"):
            setting(measurement_sd=wrong)
    for wrong in ([1.0], [1.0, 2.0, 3.0], [0.0, 1.0], [1.0, float("inf")]):
        with pytest.raises(UserError, match="start_sd: expected"):
            setting(start_sd=wrong)
    with pytest.raises(UserError, match="measurement_sd"):
        setting(measurement="state")  # nothing is known of the noise of momenta


def test_a_model_that_reads_velocities_must_know_the_mass():
    model = SimpleNamespace(names=("q",), units=("m",), mass=1.0, residual=None)
    with pytest.raises(UserError, match="with mass=3, the mass of the system"):
        setting(HEAVY, measurement=model, measurement_sd=1.0)


def test_a_flow_is_known_by_its_weights_and_one_without_by_none():
    flow = torch.nn.Linear(2, 2)
    known = weights_hash(flow)
    assert weights_hash(copy.deepcopy(flow)) == known != ""
    flow.weight.data[0, 0] += 1e-6
    assert weights_hash(flow) not in ("", known)
    assert weights_hash(torch.add) == ""


def test_a_model_is_tried_at_the_time_of_its_first_measurement():
    asked = []

    class Watched:
        names, units, residual = ("q",), ("m",), None

        def __call__(self, x, time):
            asked.append(float(time))
            return x[..., :1]

    setting(measurement=Watched(), measurement_sd=1.0, cadence=3)
    assert asked[0] == pytest.approx(3 * SPRING.dt)
