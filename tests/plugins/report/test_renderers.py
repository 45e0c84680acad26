"""Every drawing becomes an interactive figure without a network, and a picture; texts are never markup."""

from __future__ import annotations

import json
import re

import pytest
import torch
from matplotlib.colors import to_hex
from synthetic_runs import ORBITS, SPRING, run

from ahnn_plugins.report.collection import collect
from ahnn_plugins.report.drawing import Drawing, Panel, Series
from ahnn_plugins.report.figures import draw
from ahnn_plugins.report.interactive import library, to_html
from ahnn_plugins.report.looks import INK, look
from ahnn_plugins.report.static import to_matplotlib

EVIL = "</script><script>alert(1)</script> $x_{ %{y} <a href='http://b.c'>_&amp;"


@pytest.fixture(scope="module")
def drawings(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    for system in (SPRING, ORBITS):
        for model in ("HNN", "AHNN5"):
            run(folder / system.name, system, model)
    return draw(collect([folder]))


def lines(x: torch.Tensor, **changes) -> Drawing:
    series = Series("mine", x, x**2)._replace(**changes)
    return Drawing("name", "title", "caption", (Panel((series,), "x [s]", "y [m]"),))


def content(html: str) -> dict:
    """The figure in a script, as a browser reads it."""
    (script,) = re.findall(r"ahnnFigures\.add\((.*)\);</script>", html, re.DOTALL)
    return json.loads(f"[{script}]")[1]


def test_interactive_figures_load_nothing(drawings):
    for drawing in drawings:
        html = to_html(drawing)
        assert "http" not in html
        assert "src=" not in html
        figure = content(html)
        shown = {trace["name"] for trace in figure["data"] if trace.get("showlegend")}
        assert shown == {series.label for panel in drawing.panels for series in panel.series}
        assert len(html) < 250_000


def test_arrays_are_typed():
    x = torch.tensor([0.0, 1.0, torch.nan, 3.0])
    (trace,) = content(to_html(lines(x)))["data"]
    assert (trace["x"]["dtype"], trace["y"]["dtype"], trace["mode"]) == ("f4", "f4", "lines")


@pytest.mark.parametrize(("greatest", "expected"), [(9.0, ("2", "0.05")), (900.0, 1), (1e9, None)])
def test_labels_of_log_axes(greatest, expected):
    x = torch.tensor([1.0, 2.0])
    panel = Panel((Series("mine", x, torch.tensor([0.5, greatest])),), "x", "y", log=True)
    axis = content(to_html(Drawing("name", "title", "", (panel,))))["layout"]["yaxis"]
    if isinstance(expected, tuple):
        assert dict(zip(axis["ticktext"], axis["tickvals"], strict=True))["2"] == 2.0
        assert set(expected) <= set(axis["ticktext"])
    else:
        assert axis.get("dtick") == expected


def test_a_page_has_its_library_once():
    script = library()
    assert "</script" not in script
    assert "ahnnFigures" in script
    drawing = lines(torch.arange(3.0))
    assert to_html(drawing).count("<script>") == 1
    assert "Plotly.react" not in to_html(drawing)


def test_texts_are_no_markup_in_html():
    x = torch.arange(3.0)
    panel = Panel((Series(EVIL, x, x, hover={EVIL: x}),), EVIL, EVIL, ticks=(EVIL,))
    drawing = Drawing(EVIL, EVIL, EVIL, (panel,))
    for kind in ("lines", "dots"):
        html = to_html(drawing._replace(kind=kind))
        assert html.count("<script>") == html.count("</script>") == 1
        assert "<a" not in html
        figure = content(html)
        # plotly takes some tags and entities for markup: none may be left.
        texts = json.dumps([figure["data"], figure["layout"]])
        assert "<a" not in texts
        assert "<script" not in texts
        templates = [trace["hovertemplate"] for trace in figure["data"]]
        assert all("%{y}" not in text for text in re.findall(r"^.*?<br>", templates[0]))
    scene = Drawing(EVIL, EVIL, EVIL, (Panel((Series(EVIL, x, x, x),), EVIL, EVIL, EVIL),), "orbit")
    assert to_html(scene).count("<script") == 1


@pytest.mark.filterwarnings("error")
def test_texts_are_no_formulas_in_pictures():
    x = torch.arange(3.0)
    for label in (EVIL, "_hidden", "$\\frac$", "a $ b"):
        panel = Panel((Series(label, x, x + 1),), label, label, log=True)
        figure = to_matplotlib(Drawing("name", label, "", (panel,)))
        figure.canvas.draw()
        (legend,) = figure.legends
        assert [text.get_text().replace("\\$", "$").strip() for text in legend.get_texts()] == [label]


def test_every_drawing_becomes_a_picture(drawings):
    for drawing in drawings:
        figure = to_matplotlib(drawing)
        shown = [axes for axes in figure.axes if axes.get_visible()]
        assert len(shown) == len(drawing.panels)
        for axes, panel in zip(shown, drawing.panels, strict=False):
            assert panel.y in {axes.get_ylabel() for axes in shown}
            assert len(axes.get_legend_handles_labels()[1]) >= 1


def test_a_model_has_its_colour_in_both_renderers(drawings):
    for drawing in drawings:
        colours = {}
        for series in (series for panel in drawing.panels for series in panel.series):
            colours[series.label] = look(series).colour
        for axes in to_matplotlib(drawing).axes:
            for line in axes.get_lines():
                label = line.get_label()
                if label in colours and colours[label] != INK:
                    assert to_hex(line.get_color()).upper() == colours[label]
        for trace in content(to_html(drawing))["data"]:
            if trace.get("showlegend"):
                part = trace["marker"] if trace["mode"] == "markers" else trace["line"]
                expected = None if colours[trace["name"]] == INK else colours[trace["name"]]
                assert part.get("color") == expected
                assert (trace.get("meta") == INK) == (expected is None)


def test_thirty_models_look_different():
    x = torch.arange(2.0)
    looks = [look(Series("m", x, x, slot=slot)) for slot in range(30)]
    assert len({(each.colour, each.dash) for each in looks}) == 30
    assert len({each.dash for each in looks[:5]}) == 5  # the models of the paper, in print without colour
    floor = look(Series("floor", x, x, role="floor"))
    assert floor.colour not in {each.colour for each in looks}


def test_a_scene_has_its_planet_and_looks_along_its_normal(drawings):
    (drawing,) = [d for d in drawings if d.kind == "orbit"]
    figure = content(to_html(drawing))
    assert [trace["type"] for trace in figure["data"]] == ["surface", *["scatter3d"] * 3]
    assert figure["layout"]["scene"]["aspectmode"] == "data"
    truth = drawing.panels[0].series[-1]
    points = torch.stack((truth.x, truth.y, truth.z), dim=-1)
    normal = torch.linalg.cross(points[0], points[5])
    eye = torch.tensor(list(figure["layout"]["scene"]["camera"]["eye"].values())).double()
    assert float(eye @ normal / eye.norm() / normal.norm()) > 0.7
    bare = drawing._replace(panels=(drawing.panels[0]._replace(radius=0.0),))
    assert len(content(to_html(bare))["data"]) == 3
