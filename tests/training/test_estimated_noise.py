"""Noise that is estimated with the dynamics, on an oscillator whose two parameters are known."""

from __future__ import annotations

import pytest
import torch
from helpers import close, generator
from oscillators import Swing, segment
from torch.nn.utils import parameters_to_vector

from ahnn.measurements import Position, State, UnknownNoise
from ahnn.measurements.coloured_noise import Colour
from ahnn.shooting.robust import ROBUST
from ahnn.training import laplace
from ahnn.training.estimated_noise import alike, conclude_with_noise
from ahnn.training.laplace import conclude
from ahnn.training.maximum_posterior import WideProblem
from ahnn.training.noise_likelihood import FoundNoise, Residuals, most_likely, restricted
from ahnn.training.shared_bias import columns_of, of_biases

DOUBLE = {"dtype": torch.float64}
TRUE, SD = torch.tensor([2.0, 0.5], **DOUBLE), 0.01


def batch_of(seed, rows=40, measurement=None, colour=None, scale=1.0, bias=None):
    """Measurements whose noise is coloured, of another size than is stated, or biased."""
    seen = {"rows": rows, "intervals": 25, "measurement": measurement or Position(1), "longest": 0.1}
    _, batch = segment(**seen, seed=seed, sd=1e-9)
    batch = batch._replace(instrument=batch.instrument._replace(deviations=batch.instrument.deviations * 1e7))
    noise = torch.randn(batch.values.shape, generator=generator(seed + 500), **DOUBLE)
    if colour is not None:
        for k, gap in enumerate(batch.times.diff(dim=1).unbind(1), start=1):
            kept = (-gap / colour).exp()[:, None]
            noise[:, k] = kept * noise[:, k - 1] + (1 - kept**2).sqrt() * noise[:, k]
    values = batch.values + SD * scale * noise
    return batch._replace(values=values if bias is None else values + bias)


def with_noise(batch, **noise):
    return batch._replace(instrument=batch.instrument._replace(**noise))


def left_of(batch):
    problem = WideProblem(Swing(), batch, ROBUST["none"])
    _, now = problem._linearised(TRUE)
    return Residuals(now.residuals, now.of_start, batch.times, ~batch.values.isnan())


def test_the_restricted_likelihood_is_the_dense_formula():
    batch = batch_of(0, rows=2)
    left, scales = left_of(batch), torch.tensor([0.7], **DOUBLE)
    colour = Colour(torch.tensor([0.8], **DOUBLE), torch.tensor([0.3], **DOUBLE))
    total = torch.zeros((), **DOUBLE)
    for b in range(2):
        own = left.there[b, :, 0]
        t, r, x = left.times[b, own], left.rows[b, own, 0], left.of_start[b, own, 0]
        v = 0.49 * (0.8 * (-(t[:, None] - t).abs() / 0.3).exp() + 0.2 * torch.eye(len(t), **DOUBLE))
        inverse = v.inverse()
        normal = x.T @ inverse @ x
        projected = inverse - inverse @ x @ normal.inverse() @ x.T @ inverse
        total = total + v.logdet() + normal.logdet() + r @ projected @ r
    close(restricted(left, scales, colour), total, 1e-9)


def test_estimates_are_alike_where_all_their_numbers_are():
    one = FoundNoise(
        torch.tensor([0.5, 2.0], **DOUBLE), Colour(*torch.tensor([[0.5, 0.5], [3.0, 3.0]], **DOUBLE))
    )
    near = one._replace(scales=one.scales * (1 + 1e-9))
    assert alike(one, near)
    for other in (
        one._replace(scales=torch.tensor([0.5, 2.2], **DOUBLE)),
        one._replace(scales=1 / one.scales),
        one._replace(colour=Colour(*torch.tensor([[0.5, 0.5], [6.0, 3.0]], **DOUBLE))),
    ):
        assert not alike(one, other)


def test_white_noise_stays_white_and_its_size_is_found():
    found = most_likely(left_of(batch_of(1, scale=1 / 3)), sizes=True, correlation=True)
    assert found.colour is None
    assert float(found.scales) == pytest.approx(1 / 3, rel=0.08)


def test_colour_is_found_with_its_memory():
    found = most_likely(left_of(batch_of(2, colour=0.4)), sizes=True, correlation=True)
    assert found.colour is not None
    assert float(found.colour.fractions) == pytest.approx(1, abs=0.1)
    assert float(found.colour.memories) == pytest.approx(0.4, rel=0.35)
    assert float(found.scales) == pytest.approx(1, rel=0.1)


@pytest.mark.parametrize("coloured", [False, True])
def test_biases_are_eliminated_as_a_dense_fit_would(coloured):
    """The reduced equations are the Schur complement of those with biases among the parameters."""
    prior, begun = torch.tensor([0.02, 0.0], **DOUBLE), torch.tensor([0.003, 0.0], **DOUBLE)
    batch = with_noise(batch_of(3, rows=6, measurement=State(1)), bias_sd=prior, bias=begun)
    if coloured:
        batch = with_noise(
            batch, colour=Colour(torch.full((2,), 0.9, **DOUBLE), torch.full((2,), 0.3, **DOUBLE))
        )
    problem = WideProblem(Swing(), batch, ROBUST["none"])
    found = problem.equations(TRUE, [2])
    (block,) = found.blocks
    here, now = problem._linearised(TRUE)
    more = columns_of(of_biases(problem.batch), problem.batch.instrument)
    assert more.shape[-1] == 1

    def moved(step):
        instrument = problem.batch.instrument._replace(bias=begun + torch.tensor([step, 0.0], **DOUBLE))
        return problem.batch._replace(instrument=instrument).white_residuals(
            here.states[:, problem.steps.ends]
        )

    close(more[..., 0], (moved(1e-5) - moved(-1e-5)) / 2e-5, 1e-6)
    basis = torch.linalg.qr(now.of_start.flatten(1, 2)).Q
    left = lambda rows: rows - basis @ (basis.mT @ rows)  # noqa: E731
    column, rows = left(more.flatten(1, 2)).flatten(), left(now.residuals.flatten(1).unsqueeze(-1)).flatten()
    own, pull = column @ column + 0.02**-2, column @ rows + 0.003 / 0.02**2
    plain = WideProblem(Swing(), with_noise(batch, bias_sd=None), ROBUST["none"]).equations(TRUE, [2])
    assert problem.shared is not None
    coupling = problem.shared.coupling
    close(problem.shared.matrix, own.view(1, 1), 1e-6)
    close(block.matrix, plain.blocks[0].matrix - coupling @ coupling.T / own, 1e-9)
    close(block.gradient, plain.blocks[0].gradient - coupling[:, 0] * pull / own, 1e-6)
    close(found.loss, plain.loss + (0.003 / 0.02) ** 2 - pull**2 / own, 1e-9)
    close(problem.gradient(TRUE) - coupling[:, 0] * pull / own, block.gradient, 2e-3)  # by the reverse mode


def test_the_bias_of_a_sensor_is_found_beside_the_parameters():
    bias = torch.tensor([0.006, -0.004], **DOUBLE)
    seen = {"measurement": State(1), "bias": bias}
    train, other = (batch_of(seed, rows=rows, **seen) for seed, rows in ((4, 60), (5, 15)))
    unknown, model = UnknownNoise(bias_sd=torch.full((2,), 0.02, **DOUBLE)), Swing(2.02, 0.47)
    found, noise = conclude_with_noise(model, train, other, 6, "none", unknown)
    assert found is not None
    assert noise is not None
    error = torch.tensor(noise.bias, **DOUBLE) - bias
    assert (error.abs() < 4 * torch.tensor(noise.bias_sd, **DOUBLE)).all()
    assert max(noise.bias_sd) < 0.002
    off = parameters_to_vector(model.parameters()).detach() - TRUE
    assert float(off @ torch.linalg.solve(found.covariance, off)) < 13.8  # chi-square of 2, 99.9 %
    stated = conclude(Swing(), train, other, 6)
    assert stated is not None
    assert stated.about["chi_square"] > 1.2 > found.about["chi_square"]


def test_a_start_that_is_no_bias_keeps_the_prior():
    """Of a free fall nothing but the start says where zero is."""
    batch = with_noise(batch_of(6, rows=4), bias_sd=torch.tensor([0.02], **DOUBLE))
    problem = WideProblem(Swing(0.0, 0.0), batch, ROBUST["none"])
    problem.equations(torch.zeros(2, **DOUBLE), [2])
    assert problem.shared is not None
    close(problem.shared.matrix, torch.tensor([[0.02**-2]], **DOUBLE), 1e-6)


@pytest.mark.slow
def test_colour_widens_what_is_known_of_the_parameters():
    train, other = (batch_of(seed, rows=rows, colour=0.4) for seed, rows in ((7, 40), (8, 10)))
    plain = conclude(Swing(), train, other, 0)
    found, noise = conclude_with_noise(Swing(), train, other, 0, "none", UnknownNoise(correlation=True))
    assert plain is not None
    assert found is not None
    assert noise is not None
    assert noise.memories[0] == pytest.approx(0.4, rel=0.35)
    assert (found.covariance.diagonal() > 1.5 * plain.covariance.diagonal()).all()


def test_errors_of_the_dynamics_are_not_taken_for_noise(caplog, monkeypatch):
    monkeypatch.setattr(laplace, "FURTHER", 0)  # which would correct them
    train, other = (batch_of(seed, rows=10) for seed in (11, 12))
    wrong, unknown = Swing(3.0, 0.0), UnknownNoise(sizes=True, correlation=True)
    _, noise = conclude_with_noise(wrong, train, other, 0, "none", unknown)
    assert noise is not None
    assert noise.deviations == pytest.approx([SD])
    assert noise.fractions == [0.0]
    assert "the noise is not estimated: residuals are" in caplog.text


def test_noise_that_was_said_to_be_larger_makes_bands_as_wide_as_it_is():
    small, others = (batch_of(seed, rows=rows, scale=1 / 3) for seed, rows in ((9, 40), (10, 10)))
    wide = conclude(Swing(), small, others, 0)
    found, noise = conclude_with_noise(Swing(), small, others, 0, "none", UnknownNoise(sizes=True))
    assert wide is not None
    assert found is not None
    assert noise is not None
    assert noise.deviations[0] == pytest.approx(SD / 3, rel=0.06)
    assert found.about["chi_square"] == pytest.approx(1, abs=0.1)
    close(wide.factor @ wide.factor.mT, 9 * found.factor @ found.factor.mT, 0.3)
