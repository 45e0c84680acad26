"""What a filter with learned parameters is told of a case: training paths, and what is seen of them."""

from __future__ import annotations

import dataclasses

import pytest
import torch
from helpers import close
from oscillators import DOUBLE, Swing, segment
from test_ukf_evaluation import SPRING, make_case

from ahnn.errors import UserError
from ahnn.estimation.scenario import Setting
from ahnn.measurements import Position
from ahnn.uncertainty import Uncertainty
from ahnn_plugins.ukf.estimator import UnscentedKalmanFilter
from ahnn_plugins.ukf.learned_parameters import learned_filter, simulated_filter
from ahnn_plugins.ukf.noise_options import online_parameters
from ahnn_plugins.ukf.online import online_process
from ahnn_plugins.ukf.square_root import SQUARE_ROOT
from ahnn_plugins.ukf.types import UnscentedParameters

__all__ = ["make_case"]

KNOWN = Uncertainty(0.02 * torch.eye(2, **DOUBLE), torch.zeros(2, **DOUBLE), 1.0, {})


@pytest.fixture
def learned(make_case):
    """A case whose measurements are known, and the true starts of these."""
    starts, measured = segment()
    return dataclasses.replace(make_case(SPRING, Swing()), learned_from=measured), starts


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


def test_a_learned_filter_follows_its_measurements_from_starts_that_meet_them(learned):
    case, starts = learned
    found = learned_filter(case)
    close(found.start, starts, 0.02)
    rms = starts.square().mean(0).sqrt()
    close(found.start_sd, rms, 0.02)
    assert torch.equal(found.segment.times, case.learned_from.times)


def test_trajectories_that_the_model_does_not_meet_are_left_out(learned):
    case, starts = learned
    values = case.learned_from.values.clone()
    values[2] = 5.0 * torch.sin(40.0 * case.learned_from.times[2, :, None])
    strange = dataclasses.replace(case, learned_from=case.learned_from._replace(values=values))
    close(learned_filter(strange).start, starts[[0, 1, 3, 4, 5]], 0.02)
    none = dataclasses.replace(case, learned_from=case.learned_from._replace(values=values).rows(slice(2, 3)))
    with pytest.raises(UserError, match="received one that meets none of 1 trajectories"):
        learned_filter(none)
    with pytest.raises(UserError, match="expected that of the measurements"):
        learned_filter(dataclasses.replace(case, learned_from=None))


def test_outliers_are_weighed_down_as_in_the_training(learned):
    case, starts = learned
    values = case.learned_from.values.clone()
    values[:, 10] += 0.5  # fifty standard deviations
    case = dataclasses.replace(case, learned_from=case.learned_from._replace(values=values))
    off = [
        float((learned_filter(dataclasses.replace(case, robust=robust)).start - starts).abs().max())
        for robust in ("none", "student")
    ]
    assert off[1] < 0.2 * off[0]


def process(case, **changes):
    estimator = UnscentedKalmanFilter(UnscentedParameters(0.33, 2.0, 0.0), SQUARE_ROOT, None)
    noise, error = online_parameters(case, dataclasses.replace(KNOWN, **changes), None)
    return online_process(estimator, case.flow, case.dt, noise, error)


def test_a_saved_filter_is_of_no_other_directions(learned):
    case, _ = learned
    about = process(case).about
    assert process(case).about == about
    assert process(case, factor=0.03 * torch.eye(2, **DOUBLE)).about != about
    shorter = dataclasses.replace(case, learned_from=case.learned_from.first(12))
    assert process(shorter).about["force_error"][0] == about["force_error"][0]
    assert process(shorter).about != about


def test_parameters_do_more_where_a_state_is_novel(learned):
    case, starts = learned
    case = dataclasses.replace(case, novelty=lambda x: torch.full_like(x[..., 0], 3.0))
    _, plain = online_parameters(case, KNOWN, None)
    _, grown = online_parameters(case, KNOWN, 2.0)
    assert float(plain.columns(starts).abs().max()) > 0.0
    close(grown.columns(starts), 5.0 * plain.columns(starts), 1e-6)
