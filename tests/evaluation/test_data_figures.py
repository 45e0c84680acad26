"""Figures of the data doctor: rings around numbers, lines or counts for the rest, and gaps that stay open."""

from __future__ import annotations

import numpy as np
import pytest

from ahnn.data.doctor import examine
from ahnn.data.files.reading import FileReading
from ahnn.evaluation.data_figures import LINES, picture


def drawn(folder, present, outliers):
    """The figure of a swing with some of 2,000 samples, and with outliers at given ones of them."""
    at = np.flatnonzero(present)
    x, v = np.sin(at / 100), np.cos(at / 100)
    x[outliers] += 3.0
    rows = "".join(
        f"{k * 0.01!r},{a!r},{b!r}\n" for k, a, b in zip(at.tolist(), x.tolist(), v.tolist(), strict=True)
    )
    (folder / "a.csv").write_text(f"t,x,v\n{rows}")
    found = examine([folder / "a.csv"], FileReading())
    return picture(found.contents[0], found.findings)


def curve(axes):
    (line,) = [line for line in axes.lines if line.get_label() == "x"]
    return line.get_xdata(), line.get_ydata()


def test_an_outlier_has_a_ring_at_its_value_and_its_row_beside_it(tmp_path):
    figure = drawn(tmp_path, np.ones(2000, dtype=bool), [700])
    rings = [line for line in figure.axes[0].lines if line.get_label() == "suspicious value"]
    assert [(ring.get_xdata()[0], ring.get_ydata()[0]) for ring in rings] == [
        (7.0, pytest.approx(3 + np.sin(7)))
    ]
    assert [text.get_text() for text in figure.axes[0].texts] == ["row 702"]
    assert len(figure.axes) == 2


def test_a_file_of_many_days_has_days_and_labels_from_its_beginning_to_its_end(tmp_path):
    t = 600.0 * np.arange(4000)  # 27.8 days
    x, v = np.sin(t / 1e5), np.cos(t / 1e5) / 1e5
    outliers = np.arange(20, 4000, 130)
    x[outliers] += 3.0
    rows = "".join(f"{a!r},{b!r},{c!r}\n" for a, b, c in zip(t.tolist(), x.tolist(), v.tolist(), strict=True))
    (tmp_path / "a.csv").write_text(f"t [s],x [m],v [m/s]\n{rows}")
    found = examine([tmp_path / "a.csv"], FileReading())
    figure = picture(found.contents[0], found.findings)
    assert figure.axes[-1].get_xlabel() == "time [d]"
    times, _ = curve(figure.axes[0])
    assert times[-1] == pytest.approx(t[-1] / 86400)
    labels = [text.xy[0] for text in figure.axes[0].texts]
    assert len(labels) >= 4
    assert min(labels) < 5 < 22 < max(labels)
    rings = [line.get_xdata()[0] for line in figure.axes[0].lines if line.get_label() == "suspicious value"]
    assert rings == pytest.approx(t[outliers] / 86400)
    (change,) = [line for line in figure.axes[1].lines if "change" in str(line.get_label())]
    assert np.median(np.abs(change.get_ydata())) < 2e-5  # m/s, as the stated velocities


def test_few_gaps_are_lines_and_are_not_bridged(tmp_path):
    present = np.ones(2000, dtype=bool)
    present[800:900] = False
    figure = drawn(tmp_path, present, [])
    assert [line.get_xdata()[0] for line in figure.axes[0].lines if line.get_label() == "warning"] == [9.0]
    times, values = curve(figure.axes[0])
    assert times[np.isnan(values)].tolist() == [9.0]


def test_many_gaps_are_counted_in_bins(tmp_path):
    present = np.random.default_rng(0).random(2000) > 0.1
    figure = drawn(tmp_path, present, [])
    gaps = int((np.diff(np.flatnonzero(present)) > 1).sum())
    assert gaps > LINES
    assert len(figure.axes) == 3
    assert not [line for line in figure.axes[0].lines if line.get_label() == "warning"]
    (counts,) = figure.axes[2].patches
    heights = counts.get_xy()[1:-1:2, 1]
    assert heights.sum() == pytest.approx(gaps)
