"""Mistakes of a user of the kernel by itself: each is one message that says who, expected and received."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from ahnn.estimation import Belief, initial_belief
from ahnn.measurements import Position
from ahnn_plugins.ukf import UnscentedParameters, unscented_filter

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

    def __call__(self, x, t):
        return self.answer(x)


class Subtracts(Position):
    """A model with another difference."""

    def __init__(self, difference, size=1):
        super().__init__(size)
        self.residual = difference


def parameters(alpha=1.0, beta=2.0, kappa=0.0):
    return {"parameters": UnscentedParameters(alpha, beta, kappa)}


MISTAKES = {
    "R a number": ({"r": 0.1}, r"R: expected shape \(1, 1\) or \(2, 1, 1\); received \(\)"),
    "R a word": ({"r": "small"}, "R: expected numbers in a tensor, an array or nested lists; received str"),
    "Q a number": ({"q": 0.1}, r"Q: expected shape \(2, 2\) or \(2, 2, 2\); received \(\)"),
    "Q nothing": ({"q": None}, "Q: expected numbers .*; received NoneType"),
    "Q ragged": ({"q": [[1.0], [0.0, 1.0]]}, "Q: expected numbers .*; received list"),
    "Q of dt a number": ({"q": lambda dt: 0.1 * dt}, r"Q: expected shape \(2, 2\) .* received \(\)"),
    "rows a word": ({"rows": "none"}, "measurements: expected numbers .*; received str"),
    "rows flat": (
        {"rows": [1.0, 2.0]},
        r"measurements: expected shape \(2, T, 1\) with T >= 1; received \(2,\)",
    ),
    "dt a word": ({"dt": "1 s"}, "dt: expected numbers .*; received str"),
    "dt too short": ({"dt": [1.0, 1.0]}, r"dt: expected a number or shape \(4,\); received \(2,\)"),
    "dt zero": ({"dt": 0.0}, "dt: expected finite steps > 0; received 0.0"),
    "dt negative": ({"dt": [1.0, 1.0, -2.0, 1.0]}, "dt: expected finite steps > 0; received -2.0"),
    "dt NaN": ({"dt": math.nan}, "dt: expected finite steps > 0; received nan"),
    "dt infinite": ({"dt": math.inf}, "dt: expected finite steps > 0; received inf"),
    "start NaN": ({"start_time": math.nan}, "start_time: expected a finite number; received nan"),
    "Position too wide": (
        {"model": Position(), "rows": torch.zeros(2, 4, 3), "r": torch.eye(3)},
        r"to return a real tensor \(2, 5, 3\) for x \(2, 5, 2\) .* received Tensor \(2, 5, 2\)",
    ),
    "model too wide": (
        {"model": Answers(lambda x: x)},
        r"a real tensor \(2, 5, 1\) .* received Tensor \(2, 5, 2\)",
    ),
    "model too flat": ({"model": Answers(lambda x: x[..., 0])}, r"\(2, 5, 1\) .* received Tensor \(2, 5\)"),
    "model of NumPy": ({"model": Answers(lambda x: x[..., :1].numpy())}, r"received ndarray \(2, 5, 1\)"),
    "model complex": (
        {"model": Answers(lambda x: x[..., :1] + 1j)},
        "a real tensor .* Tensor of torch.complex128",
    ),
    "model that lost an axis of its residual": (
        {"model": Subtracts(lambda y, p: (y - p)[..., 0])},
        r"residual\(y, y_pred\) to return a real tensor \(2, 4, 1\) .* received Tensor \(2, 4\)",
    ),
    "model whose residual would be broadcast": (
        {
            "model": Subtracts(lambda y, p: (y - p)[..., :1], 2),
            "rows": torch.zeros(2, 4, 2),
            "r": EYE,
        },
        r"return a real tensor \(2, 4, 2\) for y of that shape .* received Tensor \(2, 4, 1\)",
    ),
    "residual complex": ({"model": Subtracts(lambda y, p: y - p + 0j)}, "residual.* of torch.complex128"),
    "rows complex": (
        {"rows": ROWS + 0j},
        r"measurements: expected real numbers; received Tensor of torch.complex128",
    ),
    "R complex": ({"r": [[1j]]}, "R: expected real numbers; received list"),
    "Q complex array": (
        {"q": np.eye(2) * 1j},
        "Q: expected real numbers; received ndarray of",
    ),
    "dt complex": ({"dt": 1j}, "dt: expected real numbers; received complex"),
    "flow complex": ({"flow": lambda x, _: x + 0j}, "flow: .* real tensor .* Tensor of torch.complex128"),
    "model a function": (
        {"model": lambda x, _: x},
        "expected a measurement model .* without names",
    ),
    "model a class": (
        {"model": Position},
        "expected a measurement model .* received <class .* without names",
    ),
    "flow a tuple": ({"flow": lambda x, _: (x, x)}, r"flow\(x, dt\) to return .* \(10, 2\); received tuple"),
    "flow nothing": ({"flow": lambda x, _: None}, r"\(10, 2\); received NoneType"),  # noqa: ARG005
    "flow of NumPy": ({"flow": lambda x, _: x.numpy()}, r"\(10, 2\); received ndarray \(10, 2\)"),
    "three alphas": (
        parameters(alpha=torch.ones(3)),
        "expected alpha to be one finite number or one .* of 2",
    ),
    "beta NaN": (parameters(beta=math.nan), "expected beta to be one finite .* received nan"),
    "beta infinite": (parameters(beta=math.inf), "expected beta to be one finite .* received inf"),
    "kappa infinite": (parameters(kappa=math.inf), "expected kappa to be one finite .* received inf"),
    "form by name": ({"form": "standard"}, "expected a Form, SQUARE_ROOT or STANDARD; received 'standard'"),
    "gate a number": ({"gate": 0.99}, r"expected a Gate\(probability in .* received 0.99"),
    "no belief": (
        {"belief": torch.zeros(2, 2)},
        r"expected a Belief; received Tensor \(2, 2\); use initial_belief",
    ),
    "flat belief": (
        {"belief": Belief(torch.zeros(2, dtype=F64), EYE)},
        r"expected a float64 belief .* \(2,\)",
    ),
    "empty belief": (
        {"belief": Belief(torch.zeros(0, 2, dtype=F64), torch.zeros(0, 2, 2, dtype=F64))},
        r"B >= 1, .* received torch.float64 \(0, 2\)",
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
        ([[1e-12, 0.0], [0.0, -1e-12]], r"Q: expected no negative variance; received \[1, 1\] = -1e-12"),
        ([[-1e-11, 0.0], [0.0, -1e-11]], r"Q: expected no negative variance; received \[0, 0\] = -1e-11"),
        ([[0.0, 1e-11], [0.0, 1.0]], r"Q: expected a symmetric matrix; received \[0, 1\] = 1e-11"),
        (
            [[0.0, 1e-11], [1e-11, 1.0]],
            r"Q: expected zeros in the row of the zero variance \[0, 0\]; received \[0, 1\]",
        ),
        ([[1e-20, 2e-20], [2e-20, 1e-20]], "Q: expected no negative eigenvalue"),
    ],
)
def test_no_noise_is_too_small_to_be_refused(noise, message):
    with pytest.raises(ValueError, match=message):
        run(q=noise)


def test_a_tiny_negative_measurement_noise_is_refused():
    with pytest.raises(ValueError, match=r"R: expected no negative variance; received \[0, 0\] = -1e-11"):
        run(r=[[-1e-11]])
    with pytest.raises(ValueError, match=r"R: expected no negative variance; .* of member 1"):
        run(r=[[[1.0]], [[-1e-11]]])
