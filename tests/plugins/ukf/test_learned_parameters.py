"""What a filter with learned parameters is told of a case: training paths, and what is seen of them."""

from __future__ import annotations

import dataclasses

import pytest
import torch
from helpers import close
from oscillators import DOUBLE, Swing
from test_ukf_evaluation import SPRING

from ahnn.cli.build import plain_config
from ahnn.cli.compose import compose_job
from ahnn.errors import UserError
from ahnn.estimation.parameter_error import field_columns
from ahnn.estimation.scenario import Setting
from ahnn.evaluation.estimators.learned_parameters import simulated_filter
from ahnn.evaluation.estimators.noise_options import ParameterOptions, given_noise
from ahnn.evaluation.estimators.noise_options import grown as of_rate
from ahnn.measurements import Position
from ahnn.uncertainty import Uncertainty
from ahnn_plugins.ukf.plugin import UKFEvaluation

TWO = 0.02 * torch.eye(2, **DOUBLE)
KNOWN = Uncertainty(TWO, torch.zeros(2, **DOUBLE), 1.0, {}, TWO)


def test_a_simulated_filter_sees_training_trajectories_when_measurements_are_made(make_case):
    case = make_case(SPRING, Swing())
    sds = torch.tensor([0.1, 0.3], **DOUBLE)
    setting = Setting(Position(1), torch.tensor([0.05], **DOUBLE), sds, (3, 7, 10_000))
    start, start_sd, seen = simulated_filter(case, setting)
    assert torch.equal(start, case.train.states[:, 0])
    assert torch.equal(start_sd, sds)
    close(seen.times, case.train.times, 1e-12)
    assert (~seen.values.isnan()).any(-1).any(0).nonzero().flatten().tolist() == [3, 7]
    assert seen.instrument.deviations.tolist() == [0.05]
    assert seen.instrument.longest == case.dt


def process(case, novelty=None, rate=None, **changes):
    options = plain_config(compose_job(["plugins=ukf_parameter_error"], "x").plugins.ukf)
    options |= {"measurement": "position", "novelty": rate}
    del options["_target_"]
    return UKFEvaluation(**options).online(
        case.flow, case.dt, case.space, lambda: case, novelty, dataclasses.replace(KNOWN, **changes)
    )


def test_a_saved_filter_is_of_no_other_directions(make_case):
    case = make_case(SPRING, Swing())
    about = process(case).about
    assert process(case).about == about
    other = process(case, directions=0.03 * torch.eye(2, **DOUBLE)).about
    assert other["force_error"][0] == about["force_error"][0] == 2
    assert other != about


def test_a_training_that_kept_no_directions_is_refused(make_case):
    with pytest.raises(UserError, match="expected a run that stored its least observable parameters"):
        process(make_case(SPRING, Swing()), directions=None)


def test_parameters_do_more_where_a_state_is_novel(make_case):
    case, far = make_case(SPRING, Swing()), lambda x: torch.full_like(x[..., 0], 3.0)
    plain, grown = (
        given_noise(ParameterOptions(), case.space, None, case.flow, KNOWN),
        given_noise(ParameterOptions(), case.space, of_rate(far, 2.0), case.flow, KNOWN),
    )
    states = case.test.states[:, 0]
    assert float(plain[1].columns(states).abs().max()) > 0.0
    close(grown[1].columns(states), 9.0 * plain[1].columns(states), 1e-6)
    assert process(case, far, 2.0).about["novelty"] == 2.0


def test_of_functions_that_took_a_step_the_parameters_before_it_are_states(make_case):
    """They say the same of how functions may move, with a third of the network."""
    case, narrow = make_case(SPRING, Swing()), Swing(2.2, 0.4)
    moved = dataclasses.replace(KNOWN, directions=None, tangent=(narrow, KNOWN))
    _, error = given_noise(ParameterOptions(), case.space, None, case.flow, moved)
    states = case.test.states[:, 0]
    close(error.columns(states), field_columns(narrow, KNOWN.directions)(states), 1e-7)
