"""A stand-in for the figures of a report: one orbit in three dimensions and one curve."""

from __future__ import annotations

import sys
from types import ModuleType

import pytest
from synthetic_runs import SPRING, run


@pytest.fixture(scope="module")
def springs(tmp_path_factory):
    """Four runs of the spring, one model with two seeds."""
    folder = tmp_path_factory.mktemp("springs")
    for model, seed in (("MLP", 7), ("AHNN3", 7), ("AHNN5", 7), ("AHNN5", 201)):
        run(folder, SPRING, model, seed)
    return folder


def draw(collection):
    import torch

    from ahnn_plugins.report.drawing import Drawing, Panel, Series

    t = torch.linspace(0, 6.28, 60)
    name = collection.systems()[0]
    orbit = Series("AHNN5", t.cos(), t.sin(), 0.3 * t.sin())
    curve = Series("HNN", t, t.square())
    return [
        Drawing(f"{name}_orbit", "An orbit", "Seen from above.", (Panel((orbit,), "x", "y", "z"),), "orbit"),
        Drawing("../../curve", "A <b>curve</b>", "Rises.", (Panel((curve,), "t", "error"),)),
    ]


def to_html(drawing):
    import plotly.graph_objects as go

    (series,) = drawing.panels[0].series
    points = [axis.tolist() for axis in (series.x, series.y, series.z) if axis is not None]
    trace = go.Scatter3d if len(points) == 3 else go.Scatter
    figure = go.Figure(trace(**dict(zip("xyz", points, strict=False)), mode="lines"))
    return figure.to_html(full_html=False, include_plotlyjs=False, config={"responsive": True})


def library():
    from plotly.offline import get_plotlyjs

    return get_plotlyjs()


def to_matplotlib(drawing):
    from matplotlib.figure import Figure

    figure = Figure(figsize=(1, 1))
    figure.text(0.1, 0.5, drawing.title)
    return figure


@pytest.fixture
def stand_in(monkeypatch):
    """Figures that need no trained run."""
    pytest.importorskip("plotly", reason="the extra `report` is needed")
    for name, functions in (
        ("figures", (draw,)),
        ("interactive", (to_html, library)),
        ("static", (to_matplotlib,)),
    ):
        module = ModuleType(name)
        for function in functions:
            setattr(module, function.__name__, function)
        monkeypatch.setitem(sys.modules, f"ahnn_plugins.report.{name}", module)
