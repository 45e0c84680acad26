"""Thinned curves keep their extremes exactly, their ends and their gaps, and are no longer than asked for."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from ahnn_plugins.report.thinning import along, extremes


@settings(max_examples=100, deadline=None)
@given(st.integers(1, 3), st.integers(1, 400), st.integers(11, 120), st.randoms(use_true_random=False))
def test_extremes_ends_and_length(width, count, most, random):
    columns = [
        torch.tensor([math.nan if random.random() < 0.1 else random.gauss(0, 1) for _ in range(count)])
        for _ in range(width)
    ]
    at = extremes(columns, most)
    assert len(at) <= max(most, 1)
    assert bool((at.diff() > 0).all())
    assert at[0] == 0
    assert at[-1] == count - 1
    for column in columns:
        there = column[~column.isnan()]
        if len(there):
            kept = column[at][~column[at].isnan()]
            assert kept.max() == there.max()
            assert kept.min() == there.min()
        assert bool(column[at].isnan().any()) == bool(column.isnan().any())


def test_every_block_keeps_its_own_spike():
    values = torch.zeros(10_000)
    spikes = torch.arange(50, 10_000, 100)
    values[spikes] = torch.arange(1.0, 101.0)
    at = extremes([values], 720)
    assert set(spikes.tolist()) <= set(at.tolist())


def test_a_gap_stays_a_gap():
    values = torch.sin(torch.arange(5000.0))
    values[2345] = torch.nan
    assert 2345 in extremes([values])


def test_short_curves_are_left_alone():
    assert extremes([torch.arange(720.0)]).tolist() == list(range(720))
    assert along(torch.rand(720, 3)).tolist() == list(range(720))


def test_too_few_samples_are_refused():
    with pytest.raises(ValueError, match="most: expected at least 8 for 2 columns; received 7"):
        extremes([torch.rand(100)] * 2, 7)


def test_an_orbit_keeps_its_periapsis_and_its_shape():
    # Equal times on an orbit of eccentricity 0.75: samples are far apart at periapsis alone.
    mean = torch.linspace(0, 4 * math.pi, 20_000, dtype=torch.float64)
    anomaly = mean.clone()
    for _ in range(60):
        anomaly = anomaly - (anomaly - 0.75 * anomaly.sin() - mean) / (1 - 0.75 * anomaly.cos())
    points = torch.stack((anomaly.cos() - 0.75, 0.75**0.5 * anomaly.sin()), dim=-1)
    at = along(points, 200)
    assert len(at) <= 200
    distance = points.norm(dim=-1)
    assert distance[at].min() == distance.min()
    for column in points.unbind(-1):
        assert column[at].max() == column.max()
        assert column[at].min() == column.min()
    # No step along the path is much longer than the even one, 2 x 4.3 semi-major axes of it over 200.
    assert float(points[at].diff(dim=0).norm(dim=-1).max()) < 2 * 2 * 5.5 / 200


def test_interruptions_of_a_path_stay():
    points = torch.rand(5000, 3, dtype=torch.float64)
    points[1000:1010] = torch.nan
    points[4000] = torch.nan
    at = set(along(points, 300).tolist())
    assert at & set(range(1000, 1010))
    assert 4000 in at
