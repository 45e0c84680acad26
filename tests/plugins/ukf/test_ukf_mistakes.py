"""Mistakes of a user of the kernel by itself: each is one message that says who, expected and received."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from ahnn_plugins.ukf import (
    Belief,
    Position,
    UnscentedParameters,
    every,
    initial_belief,
    schedule,
    unscented_filter,
)

F64 = torch.float64
EYE = torch.eye(2, dtype=F64)
ROWS = torch.arange(8.0, dtype=F64).reshape(2, 4, 1)


def run(belief=None, rows=ROWS, model=None, q=0.1 * EYE, r=EYE[:1, :1], dt=1.0, flow=None, **options):
    belief = initial_belief(torch.zeros(2, 2, dtype=F64), EYE) if belief is None else belief
    flow = (lambda x, _: x * 1.0) if flow is None else flow
    return unscented_filter(flow, belief, rows, Position(1) if model is None else model, q, r, dt, **options)


class Answers(Position):
    """A model that returns what it was given."""

    def __init__(self, answer):
        super().__init__(1)
        self.answer = answer

    def __call__(self, x, t):  # noqa: ARG002
        return self.answer(x)


def parameters(alpha=1.0, beta=2.0, kappa=0.0):
    return {"parameters": UnscentedParameters(alpha, beta, kappa)}


MISTAKES = {
    "R a number": ({"r": 0.1}, r"R: expected shape \(1, 1\) or \(2, 1, 1\), got \(\)"),
    "R a word": ({"r": "small"}, "R: expected numbers in a tensor, an array or nested lists, got str"),
    "Q a number": ({"q": 0.1}, r"Q: expected shape \(2, 2\) or \(2, 2, 2\), got \(\)"),
    "Q nothing": ({"q": None}, "Q: expected numbers .*, got NoneType"),
    "Q ragged": ({"q": [[1.0], [0.0, 1.0]]}, "Q: expected numbers .*, got list"),
    "Q of dt a number": ({"q": lambda dt: 0.1 * dt}, r"Q: expected shape \(2, 2\) .* got \(\)"),
    "rows a word": ({"rows": "none"}, "unscented_filter: measurements: expected numbers .*, got str"),
    "rows flat": ({"rows": [1.0, 2.0]}, r"expected measurements \(2, T, 1\) with T >= 1, got \(2,\)"),
    "dt a word": ({"dt": "1 s"}, "unscented_filter: dt: expected numbers .*, got str"),
    "dt too short": ({"dt": [1.0, 1.0]}, r"dt a number or of shape \(4,\), got \(2,\)"),
    "dt zero": ({"dt": 0.0}, "expected finite steps dt > 0, got 0.0"),
    "dt negative": ({"dt": [1.0, 1.0, -2.0, 1.0]}, "expected finite steps dt > 0, got -2.0"),
    "dt NaN": ({"dt": math.nan}, "expected finite steps dt > 0, got nan"),
    "dt infinite": ({"dt": math.inf}, "expected finite steps dt > 0, got inf"),
    "start NaN": ({"start_time": math.nan}, "expected a finite start_time, got nan"),
    "Position too wide": (
        {"model": Position(), "rows": torch.zeros(2, 4, 3), "r": torch.eye(3)},
        r"to return a tensor \(2, 5, 3\) for x \(2, 5, 2\) .* got Tensor \(2, 5, 2\)",
    ),
    "model too wide": ({"model": Answers(lambda x: x)}, r"a tensor \(2, 5, 1\) .* got Tensor \(2, 5, 2\)"),
    "model too flat": ({"model": Answers(lambda x: x[..., 0])}, r"\(2, 5, 1\) .* got Tensor \(2, 5\)"),
    "model of NumPy": ({"model": Answers(lambda x: x[..., :1].numpy())}, r"got ndarray \(2, 5, 1\)"),
    "model a function": (
        {"model": lambda x, _: x},
        "expected a measurement model .* without names, residual",
    ),
    "model a class": ({"model": Position}, "expected a measurement model .* got <class .* without names"),
    "flow a tuple": ({"flow": lambda x, _: (x, x)}, r"flow\(x, dt\) to return .* \(10, 2\), got tuple"),
    "flow nothing": ({"flow": lambda x, _: None}, r"\(10, 2\), got NoneType"),  # noqa: ARG005
    "flow of NumPy": ({"flow": lambda x, _: x.numpy()}, r"\(10, 2\), got ndarray \(10, 2\)"),
    "three alphas": (
        parameters(alpha=torch.ones(3)),
        "expected alpha to be one finite number or one .* of 2",
    ),
    "beta NaN": (parameters(beta=math.nan), "expected beta to be one finite .* got nan"),
    "beta infinite": (parameters(beta=math.inf), "expected beta to be one finite .* got inf"),
    "kappa infinite": (parameters(kappa=math.inf), "expected kappa to be one finite .* got inf"),
    "form by name": ({"form": "standard"}, "expected a Form, SQUARE_ROOT or STANDARD, got 'standard'"),
    "gate a number": ({"gate": 0.99}, r"expected a Gate\(probability in .* got 0.99"),
    "no belief": (
        {"belief": torch.zeros(2, 2)},
        r"expected a Belief, got Tensor \(2, 2\); use initial_belief",
    ),
    "flat belief": (
        {"belief": Belief(torch.zeros(2, dtype=F64), EYE)},
        r"expected a float64 belief .* \(2,\)",
    ),
    "empty belief": (
        {"belief": Belief(torch.zeros(0, 2, dtype=F64), torch.zeros(0, 2, 2, dtype=F64))},
        r"B >= 1, .* got torch.float64 \(0, 2\)",
    ),
    "float32 factor": (
        {"belief": Belief(torch.zeros(1, 2, dtype=F64), torch.eye(2)[None])},
        "expected a float64 belief .* torch.float32",
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_one_message(mistake):
    arguments, message = MISTAKES[mistake]
    with pytest.raises(ValueError, match=message):
        run(**arguments)


def test_mistakes_of_the_initial_belief():
    with pytest.raises(ValueError, match=r"P0: expected shape \(2, 2\) or \(1, 2, 2\), got \(\)"):
        initial_belief([[0.0, 0.0]], 1.0)
    with pytest.raises(ValueError, match=r"initial_belief: mean: expected numbers .* got str"):
        initial_belief("zero", EYE)
    with pytest.raises(ValueError, match=r"expected a mean of shape \(B, D\) with B >= 1, got \(0, 2\)"):
        initial_belief(torch.zeros(0, 2), EYE)


def test_arrays_lists_and_integers_do_as_well_as_tensors():
    expected = run(dt=torch.ones(4, dtype=F64))
    belief = initial_belief([[0.0, 0.0], [0, 0]], np.eye(2))
    for rows in (ROWS.numpy(), ROWS.tolist(), ROWS.to(torch.int64)):
        for dt in ([1.0] * 4, np.ones(4), [1, 1, 1, 1]):
            result = run(belief, rows, q=[[0.1, 0.0], [0.0, 0.1]], r=np.eye(1), dt=dt)
            assert torch.equal(result.means, expected.means)
            assert torch.equal(result.nis, expected.nis)


@pytest.mark.parametrize(
    ("noise", "message"),
    [
        ([[1e-12, 0.0], [0.0, -1e-12]], r"Q: expected no negative variance, got \[1, 1\] = -1e-12"),
        ([[-1e-11, 0.0], [0.0, -1e-11]], r"Q: expected no negative variance, got \[0, 0\] = -1e-11"),
        ([[0.0, 1e-11], [0.0, 1.0]], r"Q: expected a symmetric matrix, got \[0, 1\] = 1e-11"),
        ([[0.0, 1e-11], [1e-11, 1.0]], r"Q: expected zeros beside the zero variance \[0, 0\], got \[0, 1\]"),
        ([[1e-20, 2e-20], [2e-20, 1e-20]], "Q: expected no negative eigenvalue"),
    ],
)
def test_no_noise_is_too_small_to_be_refused(noise, message):
    with pytest.raises(ValueError, match=message):
        run(q=noise)


def test_a_tiny_negative_measurement_noise_is_refused():
    with pytest.raises(ValueError, match=r"R: expected no negative variance, got \[0, 0\] = -1e-11"):
        run(r=[[-1e-11]])
    with pytest.raises(ValueError, match=r"R: expected no negative variance, .* of member 1"):
        run(r=[[[1.0]], [[-1e-11]]])


@pytest.mark.parametrize("k", [0, -3, 2.5, math.nan, math.inf])
def test_a_cadence_is_a_whole_number_of_steps(k):
    with pytest.raises(ValueError, match=f"every: expected a cadence of a whole number .* got {k}"):
        every(ROWS, k)


def test_a_schedule_of_lists():
    dt, rows = schedule([1.0, 3.0], ROWS[:, :2].tolist(), 1)
    assert dt.tolist() == [1.0, 1.0, 1.0]
    assert torch.equal(rows[:, [0, 2]], ROWS[:, :2])
    with pytest.raises(ValueError, match=r"every: expected measurements \(B, T, M\), got \(2, 4\)"):
        every(ROWS[..., 0], 2)


@pytest.mark.parametrize(
    ("times", "max_step", "start_time", "message"),
    [
        ([1.0, 2.0], math.nan, 0.0, "max_step > 0, got .* max_step nan"),
        ([1.0, 2.0], 1.0, math.nan, "increasing from nan"),
        ([1.0, math.inf], 1.0, 0.0, "expected times increasing"),
        ([[1.0, 2.0]], 1.0, 0.0, r"expected times \(K,\) .* got \(1, 2\)"),
        ("now", 1.0, 0.0, "schedule: times: expected numbers"),
    ],
)
def test_mistakes_of_a_schedule(times, max_step, start_time, message):
    with pytest.raises(ValueError, match=message):
        schedule(times, ROWS[:, :2], max_step, start_time)
