"""Student's noise, its scale and degrees of freedom estimated: SciPy's fits, integrals, repetition."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from helpers import close, generator
from oscillators import Swing, segment
from scipy import integrate, stats
from torch.nn.utils import parameters_to_vector

from ahnn.measurements import NoiseEstimate, Position, UnknownNoise
from ahnn.measurements.student_noise import normal_scores
from ahnn.shooting.robust import ROBUST, information, loss_of, student
from ahnn.training.estimated_noise import conclude_with_noise
from ahnn.training.laplace import conclude
from ahnn.training.student_likelihood import deviations_of, most_likely_tails, without_fit

DOUBLE = {"dtype": torch.float64}
TRUE, SCALE = torch.tensor([2.0, 0.5], **DOUBLE), 0.01


def drawn(freedom, size, seed):
    rng = np.random.default_rng(seed)
    return torch.from_numpy(
        rng.standard_normal(size) if freedom == math.inf else rng.standard_t(freedom, size)
    )


@pytest.mark.parametrize("freedom", [3, 5, 30])
def test_the_most_likely_tails_are_those_of_scipy(freedom):
    e = 0.02 * drawn(freedom, 20000, freedom)
    found = most_likely_tails(e)
    nu, _, scale = stats.t.fit(e.numpy(), floc=0)
    assert found.scale == pytest.approx(scale, rel=1e-3)
    assert found.freedom == pytest.approx(nu, rel=3e-3)
    assert found.low < freedom < found.high


@pytest.mark.parametrize("freedom", [1.5, 4.0, 50.0])
def test_deviations_are_those_of_the_integrated_information(freedom):
    def scores(e):
        h = 1e-5
        scale = (stats.t.logpdf(e, freedom, 0, math.exp(h)) - stats.t.logpdf(e, freedom, 0, math.exp(-h))) / (
            2 * h
        )
        h *= freedom
        return scale, (stats.t.logpdf(e, freedom + h) - stats.t.logpdf(e, freedom - h)) / (2 * h)

    def entry(i, j):
        return (
            2
            * integrate.quad(
                lambda e: scores(e)[i] * scores(e)[j] * stats.t.pdf(e, freedom), 0, np.inf, limit=200
            )[0]
        )

    matrix = np.array([[entry(i, j) for j in (0, 1)] for i in (0, 1)])
    expected = np.sqrt(np.diag(np.linalg.inv(matrix)) / 300)
    assert deviations_of(freedom, 300) == pytest.approx(tuple(expected), rel=5e-3)


def test_normal_noise_is_not_told_apart_from_itself():
    """Chance tells it apart in 0.25 % of cases: of 40, two or more in 0.5 %."""
    found = [most_likely_tails(torch.randn(400, generator=generator(k), **DOUBLE)) for k in range(40)]
    assert sum(math.isfinite(one.freedom) for one in found) <= 1
    assert sum(one.low > 6 for one in found) >= 34
    assert all(one.scale == pytest.approx(1, rel=0.2) for one in found)
    normal = [one for one in found if math.isinf(one.freedom)]
    assert all(one.scale_sd == pytest.approx(one.scale / 800**0.5) for one in normal)


@pytest.mark.parametrize("freedom", [3.0, 5.0, math.inf])
def test_starts_that_were_fitted_do_not_change_the_tails(freedom):
    """Of 21 values two unknowns take a tenth, most of it from small ones: 1 / nu would be off by 0.03."""
    e = drawn(freedom, (1500, 21), 5)
    t = torch.linspace(-1, 1, 21, **DOUBLE)
    design, fitted = torch.stack((torch.ones_like(t), t), -1).expand(1500, -1, -1), torch.zeros_like(e)
    nu = None if math.isinf(freedom) else torch.tensor([freedom], **DOUBLE)
    weigh = loss_of("none", nu).weight
    for _ in range(60):
        weighted = design * weigh(e - fitted).unsqueeze(-1)
        fitted = (design @ torch.linalg.solve(weighted.mT @ design, weighted.mT @ e.unsqueeze(-1)))[..., 0]
    left = (e - fitted).unsqueeze(-1)
    of_start = (design * weigh(e - fitted).sqrt().unsqueeze(-1)).unsqueeze(2)
    found, alone = (
        most_likely_tails(without_fit(left, of_start, nu).flatten()),
        most_likely_tails(e.flatten()),
    )
    assert 1 / found.freedom == pytest.approx(1 / alone.freedom, abs=0.008)
    assert found.scale == pytest.approx(alone.scale, rel=0.008)


@pytest.mark.parametrize("freedom", [2.5, 7.0])
def test_scores_are_normal_quantiles_of_probabilities(freedom):
    e = torch.tensor([-40.0, -3.0, -0.2, 0.0, 1.0, 6.0], **DOUBLE).unsqueeze(-1)
    nu = torch.tensor([freedom], **DOUBLE)
    expected = stats.norm.ppf(stats.t.cdf(-e.abs().numpy(), freedom))
    close(normal_scores(e, nu), torch.as_tensor(-expected) * e.sign(), 1e-9)
    close(normal_scores(e, nu, torch.full_like(e, 1e-12)), normal_scores(e, nu), 1e-5)
    close(normal_scores(e, torch.tensor([torch.inf], **DOUBLE), torch.full_like(e, 3.0)), e / 2, 1e-12)


def test_scores_beside_an_error_are_those_of_the_convolution():
    nu, sd, e = 3.0, 1.7, torch.tensor([[0.4], [2.0], [9.0]], **DOUBLE)
    found = normal_scores(e, torch.tensor([nu], **DOUBLE), torch.full_like(e, sd**2))
    for value, score in zip(e.flatten().tolist(), found.flatten().tolist(), strict=True):
        product = lambda x, value=value: stats.norm.pdf(x, scale=sd) * stats.t.sf(value - x, nu)  # noqa: E731
        above = integrate.quad(product, -12, 12, limit=200)[0]
        assert score == pytest.approx(stats.norm.isf(above), rel=1e-4)


def test_the_information_is_that_of_repeated_fits():
    """Of 6,000 fits of one number to 200 with Student's noise: the sd of their variance is 2 %."""
    noise, robust = drawn(3.0, (6000, 200), 1), student(3.0)
    fitted = torch.zeros(6000, 1, **DOUBLE)
    for _ in range(40):
        weight = robust.weight(noise - fitted)
        fitted = (weight * noise).sum(1, keepdim=True) / weight.sum(1, keepdim=True)
    expected = 1 / (200 * float(information(torch.tensor(3.0, **DOUBLE))))
    assert float(fitted.square().mean()) == pytest.approx(expected, rel=0.08)


def test_losses_of_several_numbers_have_their_own_tails_and_normal_ones_are_squares():
    e = torch.linspace(-9, 9, 41, **DOUBLE).unsqueeze(-1).expand(-1, 2)
    loss = loss_of("none", torch.tensor([3.0, torch.inf], **DOUBLE))
    for part in ("cost", "weight", "slope"):
        both = getattr(loss, part)(e)
        close(both[:, 0], getattr(student(3.0), part)(e[:, 0]), 1e-12)
        close(both[:, 1], getattr(ROBUST["none"], part)(e[:, 1]), 1e-9)


def heavy(seed, rows, freedom):
    """Measurements of an oscillator with Student's noise of scale `SCALE`, stated three times as large."""
    _, batch = segment(rows=rows, intervals=25, measurement=Position(1), longest=0.1, sd=1e-9, seed=seed)
    values = batch.values + SCALE * drawn(freedom, tuple(batch.values.shape), seed)
    stated = torch.full_like(batch.instrument.deviations, 3 * SCALE)
    return batch._replace(values=values, instrument=batch.instrument._replace(deviations=stated))


def test_tails_are_found_with_the_dynamics_and_bands_become_as_wide_as_errors():
    train, other = heavy(21, 60, 3.0), heavy(22, 15, 3.0)
    plain, model = conclude(Swing(), train, other, 6), Swing(2.02, 0.47)
    found, noise = conclude_with_noise(model, train, other, 6, "none", UnknownNoise(tails=True))
    assert plain is not None
    assert found is not None
    assert noise is not None
    assert noise.deviations == pytest.approx([SCALE], rel=0.1)
    assert noise.freedom_low[0] < 3 < noise.freedom_high[0]
    off = parameters_to_vector(model.parameters()).detach() - TRUE
    assert float(off @ torch.linalg.solve(found.covariance, off)) < 13.8  # chi-square of 2, 99.9 %
    given = train.instrument._replace(
        deviations=torch.full((1,), SCALE, **DOUBLE), freedom=torch.full((1,), 3.0, **DOUBLE)
    )
    right = conclude(Swing(), *(part._replace(instrument=given) for part in (train, other)), 6)
    assert right is not None
    close(found.covariance, right.covariance, 0.15)
    (said,) = noise.sentences(("q",), ("m",))
    assert said.startswith("the noise of q follows Student's t with ")


def test_normal_noise_leaves_the_fit_of_squares():
    train, other = heavy(23, 60, math.inf), heavy(24, 15, math.inf)
    found, noise = conclude_with_noise(Swing(), train, other, 4, "none", UnknownNoise(tails=True))
    assert found is not None
    assert noise is not None
    assert noise.freedom == [0.0]
    assert noise.freedom_low[0] > 15
    assert noise.deviations == pytest.approx([SCALE], rel=0.06)
    unknown = UnknownNoise(tails=True)
    assert noise.applied(train.instrument, unknown).freedom is None
    (said,) = noise.sentences(("q",), ("m",))
    assert "cannot be distinguished from those of normal noise (more than " in said


def test_the_last_fit_is_that_of_the_noise_that_was_found():
    """Also where the stated scale was right, so that only the supposed tails of the first fit were wrong."""
    given = {"deviations": torch.full((1,), SCALE, **DOUBLE)}
    train, other = (
        part._replace(instrument=part.instrument._replace(**given))
        for part in (heavy(26, 40, math.inf), heavy(27, 10, math.inf))
    )
    (found, _), (squares, _) = (
        conclude_with_noise(Swing(), train, other, 6, "none", UnknownNoise(**{name: True}))
        for name in ("tails", "sizes")
    )
    assert found is not None
    assert squares is not None
    close(found.factor @ found.factor.mT, squares.factor @ squares.factor.mT, 0.03)


def test_an_estimate_keeps_tails_for_the_evaluation():
    kept = {"fractions": [], "memories": [], "bias": [], "bias_sd": [], "prior_sd": []}
    ends = {"freedom_low": [2.0, 40.0], "freedom_high": [4.0, 0.0], "scale_sd": [0.1, 0.1]}
    noise = NoiseEstimate(deviations=[1.0, 2.0], stated=[1.0, 1.0], freedom=[3.0, 0.0], **ends, **kept)
    train = heavy(25, 2, 3.0).instrument._replace(deviations=torch.ones(2, **DOUBLE))
    seen = noise.applied(train, UnknownNoise(tails=True))
    assert seen.deviations.tolist() == [1.0, 2.0]
    assert seen.freedom is not None
    assert seen.freedom.tolist() == [3.0, math.inf]
    said = noise.sentences(("q", "p"), ("m", "m/s"))
    assert said[0].endswith("its standard deviation, for filters, is 1.73 m")
    assert said[1].startswith("noise tails of p cannot be distinguished")
