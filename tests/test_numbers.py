"""Numbers as users have them: what passes is what it was, whatever its kind, and the rest is one message."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import torch

from ahnn.errors import UserError
from ahnn.numbers import as_count, as_float64, in_percent

COUNTING = np.arange(4.0)
MASKED = np.ma.masked_greater(COUNTING, 2)
RIGHT = {
    "number": (1.5, 1.5),
    "big endian": (COUNTING.astype(">f8"), [0.0, 1.0, 2.0, 3.0]),
    "backwards": (COUNTING[::-1], [3.0, 2.0, 1.0, 0.0]),
    "half": (np.arange(3, dtype=np.float16), [0.0, 1.0, 2.0]),
    "unsigned": (np.arange(3, dtype=np.uint64), [0.0, 1.0, 2.0]),
    "extended": (np.array([1e300], dtype=np.longdouble) * np.longdouble(1e300), [np.inf]),
    "objects": (np.array([1, 2.5, Fraction(1, 2)], dtype=object), [1.0, 2.5, 0.5]),
    "tensors in lists": ([torch.ones(2), torch.zeros(2)], [[1.0, 1.0], [0.0, 0.0]]),
    "brain floats": (torch.ones(2, dtype=torch.bfloat16), [1.0, 1.0]),
}
WRONG = {
    "text": "1",
    "texts": ["1", "2"],
    "nothing": None,
    "truths": [True, False],
    "tensor of truths": torch.tensor([True]),
    "dates": np.array(["2020-01-01"], dtype="datetime64[s]"),
    "complex": np.array([1j]),
    "complex tensor": torch.tensor([1j]),
    "objects": np.array([None]),
    "no rectangle": [[1.0], [1.0, 2.0]],
    "no rectangle of tensors": [torch.ones(2), torch.ones(3)],
    "without numbers": torch.ones(2, device="meta"),
    "sparse": torch.ones(2).to_sparse(),
    "too large": [10**400],
    "mapping": {"a": 1.0},
    "records": np.zeros(2, dtype=[("a", "f8")]),
}


@pytest.mark.parametrize("kind", RIGHT)
def test_numbers_of_every_kind_are_float64_tensors(kind):
    given, expected = RIGHT[kind]
    got = as_float64(given, "it")
    assert got.dtype == torch.float64
    assert got.tolist() == expected


@pytest.mark.parametrize("masked", [MASKED, [MASKED, COUNTING], [[MASKED], [COUNTING]], [1.0, np.ma.masked]])
def test_what_is_masked_is_absent(masked):
    got = as_float64(masked, "it").flatten()
    assert got.isnan().nonzero().tolist() == [[3 if len(got) > 2 else 1]]


@pytest.mark.parametrize("kind", WRONG)
def test_what_is_no_number_is_refused_by_name(kind):
    with pytest.raises(UserError, match=r"it: expected (real )?numbers"):
        as_float64(WRONG[kind], "it")


def test_gradients_flow_and_arrays_are_copied():
    x = torch.ones(2, requires_grad=True)
    as_float64([x, 2 * x], "it").sum().backward()
    assert x.grad is not None
    assert x.grad.tolist() == [3.0, 3.0]
    array = np.zeros(2)
    as_float64(array, "it").add_(1)
    assert array.tolist() == [0.0, 0.0]


def test_counts_are_whole():
    assert [as_count(n, "n") for n in (3, np.int64(3), torch.tensor(3))] == [3, 3, 3]
    for wrong in (-1, 2.5, 3.0, "3", None, True, torch.tensor([1, 2]), torch.tensor(2.0)):
        with pytest.raises(UserError, match="n: expected a whole number >= 0; received"):
            as_count(wrong, "n")


@pytest.mark.parametrize(
    ("fraction", "text"),
    [
        (1.0, "100"),
        (0.9951, "100"),
        (0.994, "99"),
        (0.0995, "10"),
        (0.0123, "1.2"),
        (0.001, "0.1"),
        (0.0, "0"),
    ],
)
def test_a_fraction_in_percent_has_two_digits_and_no_exponent(fraction, text):
    assert in_percent(fraction) == f"{text} %"
    assert in_percent(1e-9) == "less than 0.01 %"
