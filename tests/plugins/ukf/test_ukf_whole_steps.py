"""Whole steps of the library beside the same steps one by one: the same bits, whatever happens on the way."""

from __future__ import annotations

import pytest
import torch

from ahnn.estimation import Gate, Status, initial_belief
from ahnn.estimation.loop import RunPlan
from ahnn.measurements import Position, State
from ahnn_plugins.ukf import SQUARE_ROOT, UnscentedParameters, unscented_filter
from ahnn_plugins.ukf.library import library
from ahnn_plugins.ukf.unscented_kernel import SigmaPoints
from ahnn_plugins.ukf.whole_steps import WholeSteps

F64, NAN = torch.float64, float("nan")
BATCH, STEPS = 11, 40


@pytest.fixture(autouse=True)
def _compiled():
    if library() is None:
        pytest.skip("no C compiler")


@pytest.fixture
def both(monkeypatch):
    """Filter with whole steps and without; return both results and how many steps were whole."""

    def run(flow, rows, measurement, **options):
        belief = initial_belief(torch.linspace(-1, 1, 2 * len(rows)).reshape(-1, 2), 0.1 * torch.eye(2))
        noise = [lambda dt: dt * 1e-4 * torch.eye(2), 0.04 * torch.eye(rows.shape[-1])]
        arguments = (belief, rows, measurement, *noise, options.pop("dt", 0.1))
        step, done = WholeSteps.steps, []

        def counted(*given):
            done.append(step(*given))
            return done[-1]

        with monkeypatch.context() as patch:
            patch.setattr(WholeSteps, "steps", counted)
            ours = unscented_filter(flow, *arguments, **options)
        with monkeypatch.context() as patch:
            patch.setattr(WholeSteps, "steps", lambda *_: None)
            single = unscented_filter(flow, *arguments, **options)
        return ours, single, sum(found[1].length for found in done if found is not None)

    return run


def swing(x, dt):
    p = x[:, 1:] - dt * torch.sin(x[:, :1])
    return torch.cat((x[:, :1] + dt * p, p), dim=1)


def rows(width):
    generator = torch.Generator().manual_seed(3)
    return 0.2 * torch.randn(BATCH, STEPS, width, generator=generator, dtype=F64)


def same(ours, single):
    for name in ours._fields:
        a, b = getattr(ours, name), getattr(single, name)
        if isinstance(a, torch.Tensor):
            assert torch.equal(a.nan_to_num(7.5), b.nan_to_num(7.5)), name
    for a, b in zip(ours.state[1:], single.state[1:], strict=True):
        assert torch.equal(a, b)
    assert all(torch.equal(a, b) for a, b in zip(ours.state.belief, single.state.belief, strict=True))
    return True


SETTINGS = {
    "positions": (Position(1), {}),
    "states": (State(1), {}),
    "weights of their own": (
        Position(1),
        {"parameters": UnscentedParameters(torch.linspace(0.5, 1.5, BATCH, dtype=F64))},
    ),
    "steps of two lengths": (Position(1), {"dt": torch.tensor([0.1, 0.2]).repeat(STEPS // 2)}),
    "a gate that takes all": (Position(1), {"gate": Gate(1 - 1e-15)}),
}


@pytest.mark.parametrize("name", SETTINGS)
def test_all_steps_are_whole_and_have_the_same_bits(both, name):
    measurement, options = SETTINGS[name]
    ours, single, whole = both(swing, rows(len(measurement.names)), measurement, **options)
    assert whole == STEPS
    assert same(ours, single)


def test_between_rows_nothing_is_read(both):
    told = rows(1)
    told[:, 3:30:2] = NAN
    told[4, 33] = NAN  # one member alone: this step is decided member by member
    ours, single, whole = both(swing, told, Position(1))
    assert whole == STEPS - 1
    assert same(ours, single)


def test_a_row_that_the_gate_refuses_is_refused_and_the_rest_goes_on(both):
    told = rows(1)
    told[2, 5:8], told[3, 20:] = 50.0, 50.0  # three in a row, then one too many
    ours, single, whole = both(swing, told, Position(1), gate=Gate(0.999999, patience=5))
    assert ours.rejected[2].sum() == 3
    assert ours.status[3] == Status.DIVERGED
    assert 15 <= whole < 25
    assert same(ours, single)


def test_a_flow_that_overflows_costs_its_member_alone(both):
    def flow(x, dt):
        return torch.where(x[:, :1] > 1.6, torch.inf, swing(x, dt))

    told = rows(1)
    told[5, 20:] = 3.0
    ours, single, whole = both(flow, told, Position(1))
    assert 20 <= whole < STEPS
    assert (ours.status != Status.OK).nonzero().tolist() == [[5]]
    assert same(ours, single)


@pytest.mark.parametrize("smoothing", [False, True])
def test_what_a_smoother_needs_is_left_to_single_steps(both, smoothing):
    ours, single, whole = both(swing, rows(1), Position(1), smoothing=smoothing)
    assert whole == (0 if smoothing else STEPS)
    assert same(ours, single)


def test_the_flow_is_asked_once_a_step_and_its_tensors_stay_its_own(both):
    given, returned = [], []

    def flow(x, dt):
        given.append((x, x.clone()))
        returned.append((y := swing(x, dt), y.clone()))
        return y

    both(flow, rows(1), Position(1))
    assert len(given) == 2 * STEPS
    assert all(torch.equal(a, b) for a, b in (*given, *returned))


@pytest.mark.parametrize("kind", ["other strides", "the same tensor", "float32"])
def test_flows_may_return_any_tensor(both, kind):
    flows = {
        "other strides": lambda x, dt: swing(x, dt).T.contiguous().T,
        "the same tensor": lambda x, dt: x,  # noqa: ARG005
        "float32": lambda x, dt: swing(x, dt).float(),
    }
    ours, single, whole = both(flows[kind], rows(1), Position(1))
    assert whole == STEPS
    assert same(ours, single)


def test_gradients_take_single_steps():
    scale = torch.tensor(1.0, dtype=F64, requires_grad=True)
    belief = initial_belief(torch.zeros(1, 2), 0.1 * torch.eye(2))
    noise = (1e-4 * torch.eye(2), 0.04 * torch.eye(1))
    found = unscented_filter(
        lambda x, dt: swing(x, scale * dt), belief, rows(1)[:1], Position(1), *noise, 0.1, gradients=True
    )
    (slope,) = torch.autograd.grad(found.log_likelihood.sum(), scale)
    assert slope.isfinite()
    assert slope != 0.0


def test_the_form_says_whether_there_are_whole_steps():
    kernel = SigmaPoints(None, SQUARE_ROOT._replace(read=None))
    assert WholeSteps(RunPlan.of(rows(1), None, None), kernel).possible == [False] * STEPS
