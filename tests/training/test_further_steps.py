"""Further steps of a training that would otherwise end before its optimum."""

from __future__ import annotations

import torch
from oscillators import Swing
from test_laplace import batch_of, flat, learned

from ahnn.data.segments import shortened
from ahnn.training import laplace
from ahnn.training.laplace import conclude


def test_a_training_goes_on_until_it_reaches_its_optimum(caplog):
    batch, other = batch_of(0), batch_of(1, rows=10)
    optimum, early = flat(learned(batch, 7)), Swing(2.01, 0.49)
    with caplog.at_level("INFO"):
        found = conclude(early, batch, other, 0)
    assert "the training has not reached its optimum: further steps follow, about " in caplog.text
    assert found.about["remaining"] < 0.05 * found.about["determined"]
    gap = torch.linalg.solve(found.factor, flat(early) - optimum)
    assert float(gap.square().sum()) < 0.2
    caplog.clear()
    with caplog.at_level("INFO"):
        conclude(early, batch, other, 0)
    assert "has not reached" not in caplog.text


def test_further_steps_that_do_not_help_are_undone(monkeypatch):
    batch, other = batch_of(0), batch_of(1, rows=10)
    before = flat(early := Swing(2.01, 0.49))

    def away(problem, here, damping):
        del problem
        return here.theta + 0.05, damping, 1e9

    monkeypatch.setattr(laplace, "lower", away)
    found = conclude(early, batch, other, 0)
    assert torch.equal(flat(early), before)
    assert found.about["remaining"] > found.about["determined"]


def test_a_lost_path_is_noticed_at_an_optimum_and_a_worse_fit_is_not_taken(monkeypatch, caplog):
    batch, other = batch_of(0), batch_of(1, rows=10)
    fitted = learned(batch, 7)
    before, found = flat(fitted), conclude(fitted, batch, other, 0)
    assert 1.0 < found.about["uneven"] < laplace.UNEVEN
    values = batch.values.clone()
    values[0, 10:] += 100 * batch.instrument.deviations
    with caplog.at_level("INFO"):
        strange = conclude(fitted, batch._replace(values=values), other, 0)
    assert "further steps follow" in caplog.text
    assert strange is not None
    monkeypatch.setattr(laplace, "UNEVEN", 0.0)
    again = conclude(fitted, batch, other, 0)
    assert again.about["chi_square"] <= found.about["chi_square"] * (1 + 1e-3)
    gap = torch.linalg.solve(found.factor, flat(fitted) - before)
    assert float(gap.square().sum()) < 0.2


def test_segments_of_a_fraction_of_the_length_hold_about_all_measurements():
    batch = batch_of(0, rows=12)
    for share in (2, 4, 8):
        parts = shortened(batch, share)
        assert parts.times.shape[1] - 1 == max(21 // share, 4)
        assert 0.7 * batch.measured.sum() < parts.measured.sum() < 1.5 * batch.measured.sum()
        windows = batch.times.unfold(1, parts.times.shape[1], 1).flatten(0, 1)
        same = (windows[:, None] - parts.times).abs().amax(-1) == 0
        assert bool(same.any(0).all())
        assert int(same.any(1).sum()) == len(parts.times)  # no segment twice


def test_a_nearer_optimum_that_fits_worse_is_not_taken(monkeypatch):
    batch, other = batch_of(0), batch_of(1, rows=10)
    before = flat(early := Swing(2.01, 0.49))
    monkeypatch.setattr(laplace, "WORSE", 0.1)
    found = conclude(early, batch, other, 0)
    assert torch.equal(flat(early), before)
    assert found.about["remaining"] > found.about["determined"]


def test_longer_segments_are_left_out_if_short_ones_are_not_fitted(monkeypatch):
    seen = []

    def approached(dynamics, train, steps, *more, **options):
        seen.append((train.times.shape[1] - 1, steps))
        return here(dynamics, train, 0, *more, **options)

    here = laplace.approached
    monkeypatch.setattr(laplace, "approached", approached)
    conclude(Swing(2.01, 0.49), batch_of(0), batch_of(1, rows=10), 0)
    assert seen == [(20, 0), (4, 10), (20, 0)]
