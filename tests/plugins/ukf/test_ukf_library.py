"""The C library of the square-root form beside torch's linear algebra, member by member, and its absence."""

from __future__ import annotations

import pytest
import torch

from ahnn.estimation import Belief, Gate
from ahnn.estimation.linalg import tria
from ahnn.measurements import Position, State
from ahnn_plugins.ukf import SQUARE_ROOT, UnscentedParameters, members, unscented_filter
from ahnn_plugins.ukf.library import library
from ahnn_plugins.ukf.sigma_points import draw, unscented_weights

F64 = torch.float64


@pytest.fixture
def in_torch(monkeypatch):
    """Return a function that makes a call without the library."""

    def call(function, *arguments, **options):
        with monkeypatch.context() as patch:
            patch.setattr(members, "apply_to", lambda *_: False)
            return function(*arguments, **options)

    return call


@pytest.fixture(autouse=True)
def _compiled():
    if library() is None:
        pytest.skip("no C compiler")


class Twisted:
    """Three numbers of a state, one of them an angle that wraps."""

    names, units = ("a", "b", "angle"), ("1", "1", "rad")

    def __call__(self, x, t):
        return torch.stack((x[..., 0] * x[..., 1] + t, x[..., 1], 3.0 * x[..., 0]), dim=-1)

    def residual(self, y, y_pred):
        return torch.cat((y[..., :2] - y_pred[..., :2], (y - y_pred)[..., 2:].sin()), dim=-1)


def beliefs(batch, size, generator):
    rows = torch.randn(batch, 2 * size, size, generator=generator, dtype=F64)
    return Belief(torch.randn(batch, size, generator=generator, dtype=F64), tria(rows))


def equal(actual, expected, tolerance=1e-12):
    """Whether each member's numbers agree relative to their size, and what is not finite is so in both."""
    if actual.dtype != F64:
        return torch.equal(actual, expected)
    assert torch.equal(actual.isnan(), expected.isnan())
    actual, expected = (part.reshape(len(part), -1).nan_to_num() for part in (actual, expected))
    return bool(((actual - expected).abs().amax(1) <= tolerance * expected.abs().amax(1)).all())


PARAMETERS = [
    (1.0, 2.0, 0.0),
    (0.5, 2.0, 1.0),
    (torch.linspace(0.5, 1.5, 11, dtype=F64), 2.0, torch.linspace(0.0, 2.0, 11, dtype=F64)),
]


@pytest.mark.parametrize("parameters", PARAMETERS, ids=("default", "narrow", "each its own"))
@pytest.mark.parametrize("scale", [1.0, 1e-170, 1e150])
def test_one_step_equals_that_in_torch(in_torch, parameters, scale):
    # 11 members are two whole blocks and a rest; rows are whole, partly there, and empty.
    generator, model = torch.Generator().manual_seed(0), Twisted()
    belief = beliefs(11, 4, generator)
    weights = unscented_weights(UnscentedParameters(*parameters), 4, batch=11)
    points = draw(belief, weights)
    assert equal(points, in_torch(draw, belief, weights))
    chol_q = 0.1 * tria(torch.randn(1, 4, 4, generator=generator, dtype=F64)).expand(11, 4, 4)
    bent = scale * (points + 0.3 * points.square())
    predicted = SQUARE_ROOT.predict(bent, weights, scale * chol_q)
    expected = in_torch(SQUARE_ROOT.predict, bent, weights, scale * chol_q)
    assert all(map(equal, predicted.belief, expected.belief))
    assert predicted.sound == (scale != 1e-170)  # its variances are below the smallest number

    y = torch.randn(11, 3, generator=generator, dtype=F64)
    y[2, 1] = y[5, 0] = y[5, 2] = y[7] = torch.nan
    chol_r = tria(torch.randn(11, 3, 3, generator=generator, dtype=F64))
    arguments = (belief, model(points, 0.5), y, model.residual, weights, chol_r)
    updated, expected = SQUARE_ROOT.update(*arguments), in_torch(SQUARE_ROOT.update, *arguments)
    assert all(map(equal, (*updated.belief, *updated[1:6]), (*expected.belief, *expected[1:6])))
    assert not updated.sound
    assert SQUARE_ROOT.update(belief, arguments[1], y.nan_to_num(), *arguments[3:]).sound


@pytest.mark.parametrize("reading", [Position(2), State(2)], ids=("position", "state"))
@pytest.mark.parametrize("alpha", [1.0, 0.3])
def test_components_that_are_read_give_what_sigma_points_give(in_torch, reading, alpha):
    generator, width = torch.Generator().manual_seed(2), len(reading.names)
    prior = beliefs(11, 4, generator)
    weights = unscented_weights(UnscentedParameters(alpha, 2.0, 0.5), 4)
    y = torch.randn(11, width, generator=generator, dtype=F64)
    y[2, 1] = y[5, 0] = y[7] = torch.nan
    chol_r = tria(torch.randn(11, width, width, generator=generator, dtype=F64))
    points = reading(draw(prior, weights), 0.0)
    for rows, sound in ((y, False), (y.nan_to_num(), True)):
        updated = members.read(prior, rows, chol_r)
        expected = in_torch(SQUARE_ROOT.update, prior, points, rows, reading.residual, weights, chol_r)
        assert all(map(equal, (*updated.belief, *updated[1:6]), (*expected.belief, *expected[1:6])))
        assert updated.sound == sound


def test_a_reading_of_ones_own_is_asked(in_torch):
    """A class that is made from `Position` may do something else."""

    class Biased(Position):
        def __call__(self, x, t):
            return super().__call__(x, t) + 5.0

    start = beliefs(3, 4, torch.Generator().manual_seed(0))
    rows = torch.zeros(3, 4, 2, dtype=F64)
    arguments = (lambda x, _: x, start, rows, Biased(2), 0.1 * torch.eye(4), torch.eye(2), 1.0)
    result, expected = unscented_filter(*arguments), in_torch(unscented_filter, *arguments)
    assert equal(result.innovations, expected.innovations, 1e-11)
    assert float(result.means[..., :2].mean()) < -4.0


def test_every_status_is_that_of_torch(in_torch):
    # Members return NaN, overflow, collapse and are gated; their neighbours do not care.
    generator, steps = torch.Generator().manual_seed(1), 12
    start = Belief(torch.zeros(10, 2, dtype=F64), 0.1 * torch.eye(2, dtype=F64).expand(10, 2, 2))
    start.mean[:, 0] = torch.arange(10)

    def flow(x, dt):
        which = x.view(10, 5, 2)[:, :1, :1].round()
        moved = x.view(10, 5, 2) + dt * torch.tensor([0.0, 1.0], dtype=F64)
        moved = torch.where(which == 2.0, torch.nan, moved)
        moved = torch.where((which == 3.0) & (moved[..., 1:] > 3.5), torch.inf, moved)
        moved = torch.where(which == 4.0, moved * torch.tensor([1.0, 0.0], dtype=F64), moved)
        return moved.reshape(50, 2)

    class Second(Twisted):
        names, units = ("second",), ("1",)

        def __call__(self, x, t):
            del t
            return x[..., 1:]

        def residual(self, y, y_pred):
            return y - y_pred

    rows = 1.0 + torch.arange(steps).to(F64).repeat(10, 1).unsqueeze(-1)
    rows = rows + 0.01 * torch.randn(10, steps, 1, generator=generator, dtype=F64)
    rows[6, 3:] += 100.0
    rows[8, ::2] = torch.nan
    noise = torch.diag(torch.tensor([1e-4, 0.0], dtype=F64)), torch.full((1, 1), 1e-2)
    arguments = (flow, start, rows, Second(), *noise, 1.0)
    result = unscented_filter(*arguments, gate=Gate(0.9999))
    expected = in_torch(unscented_filter, *arguments, gate=Gate(0.9999))
    assert result.status.tolist() == expected.status.tolist() == [0, 0, 1, 1, 2, 0, 3, 0, 0, 0]
    for name in ("failed_step", "rejected", "measured", "means", "chols", "nis", "log_likelihood"):
        assert equal(getattr(result, name), getattr(expected, name), 1e-11), name
    # Alone, each member has the same bits.
    sound = [b for b in range(10) if b not in (2, 3, 4, 6)]
    alone = unscented_filter(
        lambda x, dt: x + dt * torch.tensor([0.0, 1.0], dtype=F64),
        Belief(*(part[sound[-1:]] for part in start)),
        rows[sound[-1:]],
        *arguments[3:],
        gate=Gate(0.9999),
    )
    assert torch.equal(alone.chols[0], result.chols[sound[-1]])


def test_the_library_has_no_part_where_derivatives_are_wanted():
    weights = unscented_weights(UnscentedParameters(), 2)
    plain, wanted = torch.zeros(1, 2, dtype=F64), torch.zeros(1, 2, dtype=F64, requires_grad=True)
    assert members.apply_to(weights, plain)
    assert not members.apply_to(weights, wanted)
    with torch.no_grad():
        assert members.apply_to(weights, wanted)
    assert not members.apply_to(weights, plain.float())
    assert not members.apply_to(unscented_weights(UnscentedParameters(1.0, -2.0, 0.0), 2), plain)
    factor = torch.eye(2, dtype=F64)[None]
    mapped = torch.func.vmap(lambda mean: draw(Belief(mean, factor), weights))(plain[None])
    assert torch.equal(mapped[0], draw(Belief(plain, factor), weights))


@pytest.mark.parametrize(("compiler", "warnings"), [("/nowhere/cc", 0), ("false", 1)])
def test_without_a_compiler_the_filter_goes_on(monkeypatch, tmp_path, recwarn, compiler, warnings):
    monkeypatch.setenv("CC", compiler)
    monkeypatch.setenv("AHNN_CACHE", str(tmp_path))
    assert library.__wrapped__() is None
    assert len(recwarn) == warnings
    assert not list(tmp_path.rglob("*.so"))


@pytest.mark.slow
def test_a_library_is_kept_and_one_that_is_damaged_or_of_others_is_not_used(monkeypatch, tmp_path):
    monkeypatch.setenv("AHNN_CACHE", str(tmp_path))
    assert library.__wrapped__() is not None
    (kept,) = tmp_path.rglob("*.so")
    content = kept.read_bytes()
    kept.chmod(0o644)
    kept.write_bytes(b"damaged")
    assert library.__wrapped__() is not None
    assert kept.read_bytes() == content
    monkeypatch.setenv("CC", "cc -DANOTHER")
    kept.parent.chmod(0o777)  # anybody could put one there
    assert library.__wrapped__() is not None
    assert list(tmp_path.rglob("*.so")) == [kept]
