"""Interactive plotly figures for an offline HTML page."""

from __future__ import annotations

import html
import json
import math
from importlib.resources import files
from typing import Any

import numpy as np
import torch
from matplotlib.ticker import MaxNLocator
from torch import Tensor

from ahnn.evaluation.style import SKY
from ahnn_plugins.report.drawing import Drawing, Panel, Series
from ahnn_plugins.report.looks import INK, OPACITY, SMALL, Look, is_dots, look

SCRIPT = "interactive.js"
SYMBOLS = {"circle": "circle", "square": "square-open", "line": "line-ew-open", "x": "x-thin-open"}
ABOVE, BELOW, GAP = 34, 46, 58
"""Pixels above the first panel, between the last one and the legend, and between panels."""
TALL, LOW, SPACE = 250, 150, 500
"""Heights of a panel among few, of a panel among many, and of a scene."""
NARROW, SHORT, LONG = 2.5, 30.0, 1e6
"""Dynamic ranges of log axes below which labels are linear, between powers of ten, or not left to plotly."""
DISTANCE = 2.3
"""Distance of the camera from a scene, in units of its size."""


def library() -> str:
    """Return the script that `to_html` requires once per page: plotly and the renderer.

    Raises:
        ImportError: plotly is not installed (the extra `report`).
    """
    from plotly.offline import get_plotlyjs

    own = files("ahnn_plugins.report").joinpath(SCRIPT).read_text("utf-8")
    return f"{get_plotlyjs()}\n{own}".replace("</script", "<\\/script")


def to_html(drawing: Drawing) -> str:
    """Render a figure as a `div` with its script, without title and caption.

    A page must contain the `library` once before its figures. Texts of a drawing are untrusted.

    Raises:
        ImportError: plotly is not installed (the extra `report`).
    """
    figure = _scene(drawing) if drawing.kind == "orbit" else _stack(drawing)
    name = html.escape(f"figure_{drawing.name}")
    content = f"ahnnFigures.add({json.dumps(f'figure_{drawing.name}')}, {figure.to_json()});"
    return (
        f'<div id="{name}" class="figure" role="img" aria-label="{html.escape(drawing.title)}" '
        + f'style="height:{figure.layout.height}px"></div>\n<script>{_in_script(content)}</script>\n'
    )


def _in_script(text: str) -> str:
    """Escape a script so that strings cannot terminate it."""
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _stack(drawing: Drawing) -> Any:
    """Return stacked panels as plotly data."""
    from plotly.graph_objects import Figure

    count = len(drawing.panels)
    height = TALL if count <= 3 else LOW
    inner = count * height + (count - 1) * GAP
    layout: dict[str, Any] = _layout(inner + ABOVE + BELOW + 60, {"y": -BELOW / inner, "yanchor": "top"})
    layout["annotations"] = []
    shown: set[str] = set()
    traces = []
    for i, panel in enumerate(drawing.panels):
        number = "" if i == 0 else str(i + 1)
        top = 1 - i * (height + GAP) / inner
        layout[f"xaxis{number}"] = _horizontal(panel, number, last=i == count - 1)
        layout[f"yaxis{number}"] = _vertical(panel, number, [max(top - height / inner, 0.0), top])
        for series in panel.series:
            for trace in _traces(series, drawing):
                place = {"xaxis": f"x{number}", "yaxis": f"y{number}"}
                legend = trace["showlegend"] and series.label not in shown
                traces.append(trace | place | {"showlegend": legend})
            shown.add(series.label)
        layout["annotations"].append(_heading(panel, top))
    return Figure(traces, layout)


def _heading(panel: Panel, top: float) -> dict[str, Any]:
    """Return the label of a vertical axis, placed above it, since narrow screens lack space to its left."""
    place = {"xref": "paper", "yref": "paper", "x": 0, "y": top, "xanchor": "left", "yanchor": "bottom"}
    text = html.escape(", ".join(filter(None, (panel.y, panel.note))))
    return {"text": text, "showarrow": False, "yshift": 2, **place}


def _layout(height: int, legend: dict[str, Any]) -> dict[str, Any]:
    clear = "rgba(0,0,0,0)"
    return {
        "height": height,
        "autosize": True,
        "paper_bgcolor": clear,
        "plot_bgcolor": clear,
        "font": {"family": "system-ui, sans-serif", "size": 13},
        "margin": {"l": 54, "r": 24, "t": ABOVE, "b": BELOW},
        "legend": {"orientation": "h", "x": 0, "bgcolor": clear, "itemwidth": 44, **legend},
        "modebar": {"bgcolor": clear, "color": "#8a8a8a", "activecolor": SKY},
        "hovermode": "closest",
    }


def _horizontal(panel: Panel, number: str, *, last: bool) -> dict[str, Any]:
    axis: dict[str, Any] = {"anchor": f"y{number}", "zeroline": False, "automargin": True}
    if panel.ticks:
        places = {"tickvals": list(range(len(panel.ticks))), "range": [-0.6, len(panel.ticks) - 0.4]}
        return axis | places | {"ticktext": [html.escape(tick) for tick in panel.ticks]}
    if last or panel.equal:
        axis["title"] = {"text": html.escape(panel.x), "standoff": 6}
    return axis | ({"range": _span(panel)} if number == "" else {"matches": "x"})


def _span(panel: Panel) -> list[float] | None:
    """Return the range of the independent variable of a panel; None for paths."""
    columns = [series.x for series in panel.series if len(series.x)]
    if not columns or not all(bool((x.diff() >= 0).all()) for x in columns):
        return None
    return [min(float(x[0]) for x in columns), max(float(x[-1]) for x in columns)]


def _vertical(panel: Panel, number: str, domain: list[float]) -> dict[str, Any]:
    axis: dict[str, Any] = {
        "anchor": f"x{number}",
        "domain": domain,
        "zeroline": False,
        "exponentformat": "power",
        "automargin": True,
    }
    axis |= {"type": "log", **_decades(panel)} if panel.log else {}
    axis |= {"scaleanchor": f"x{number}"} if panel.equal else {}
    return axis | ({"range": list(panel.limits)} if panel.limits else {})


def _decades(panel: Panel) -> dict[str, Any]:
    """Return the labels of a log axis: powers of ten, or integers between them on short axes."""
    values = torch.cat([series.y for series in panel.series])
    values = values[(values > 0) & values.isfinite()]
    if not len(values) or float(values.max() / values.min()) >= LONG:
        return {}
    low, high = float(values.min()), float(values.max())
    if high >= SHORT * low:
        return {"dtick": 1}
    if low < high < NARROW * low:  # possibly none of the ticks below lies between
        ticks = list(map(float, MaxNLocator(4).tick_values(low, high)))
        return {"tickvals": ticks, "ticktext": [f"{tick:.6g}" for tick in ticks]}
    # plotly would label these ticks with a digit but no power of ten.
    decades = range(math.floor(math.log10(low)) - 2, math.ceil(math.log10(high)) + 3)
    ticks = [float(f"{digit}e{decade}") for decade in decades for digit in (1, 2, 5)]
    return {"tickvals": ticks, "ticktext": [f"{tick:g}" for tick in ticks]}


def _traces(series: Series, drawing: Drawing) -> list[dict[str, Any]]:
    """Return the traces of a series: its band, if it has one, below its line or dots."""
    style = look(series)
    name = html.escape(series.label)
    main: dict[str, Any] = {
        "type": "scatter",
        "x": _numbers(series.x),
        "y": _precise(series.y),
        "name": name,
        "legendgroup": name,
        "showlegend": True,
        **_hover(series, "%{x:.5g}, %{y:.4g}"),
        **({"meta": INK} if style.colour == INK else {}),
    }
    colour = {} if style.colour == INK else {"color": style.colour}
    if is_dots(series, drawing.kind):
        size = 5 if series.role in SMALL else 16 if style.symbol == "line" else 9
        line = {"width": 2, **colour} if style.symbol != "circle" else {}
        main |= {
            "mode": "markers",
            "marker": {"size": size, "symbol": SYMBOLS[style.symbol], **colour, "line": line},
        }
        return [main]
    main |= {"mode": "lines", "line": {"dash": style.dash, "width": 1.25 * style.width, **colour}}
    return [*_band(series, style, main), main]


def _band(series: Series, style: Look, main: dict[str, Any]) -> list[dict[str, Any]]:
    if series.low is None or series.high is None:
        return []
    edge = {key: main[key] for key in ("type", "x", "name", "legendgroup")}
    edge |= {"mode": "lines", "line": {"width": 0}, "hoverinfo": "skip", "showlegend": False}
    r, g, b = (int(style.colour[k : k + 2], 16) for k in (1, 3, 5))
    fill = {"fill": "tonexty", "fillcolor": f"rgba({r},{g},{b},{OPACITY})"}
    return [edge | {"y": _precise(series.low)}, edge | {"y": _precise(series.high)} | fill]


def _hover(series: Series, values: str) -> dict[str, Any]:
    """Return the tooltip template, with texts escaped."""
    lines = [html.escape(series.label).replace("%{", "% {"), values]
    lines += [
        f"{html.escape(name).replace('%{', '% {')}: %{{customdata[{i}]:.5g}}"
        for i, name in enumerate(series.hover)
    ]
    found: dict[str, Any] = {"hovertemplate": "<br>".join(lines) + "<extra></extra>"}
    if series.hover:
        found["customdata"] = np.stack([_numbers(v) for v in series.hover.values()], axis=-1)
    return found


def _scene(drawing: Drawing) -> Any:
    """Return an orbit in three dimensions as plotly data."""
    from plotly.graph_objects import Figure

    panel = drawing.panels[0]
    layout = _layout(SPACE + 60, {"y": 0, "yanchor": "top"})
    layout["margin"] = {"l": 0, "r": 0, "t": ABOVE, "b": 0}
    titles = zip("xyz", (panel.x, panel.y, panel.z), strict=True)
    axes = {f"{n}axis": {"title": {"text": html.escape(t)}, "showbackground": False} for n, t in titles}
    layout["scene"] = {"aspectmode": "data", "dragmode": "orbit", "camera": _camera(panel), **axes}
    return Figure([*_planet(panel), *(_path(series) for series in panel.series)], layout)


def _path(series: Series) -> dict[str, Any]:
    assert series.z is not None
    style = look(series)
    line: dict[str, Any] = {"dash": style.dash, "width": 2.5 * style.width}
    x, y, z = (_numbers(part) for part in (series.x, series.y, series.z))
    main = {"type": "scatter3d", "mode": "lines", "x": x, "y": y, "z": z, "name": html.escape(series.label)}
    ink = {"meta": INK, "line": line} if style.colour == INK else {"line": line | {"color": style.colour}}
    return main | ink | {"showlegend": True} | _hover(series, "%{x:.5g}, %{y:.5g}, %{z:.5g}")


def _planet(panel: Panel) -> list[dict[str, Any]]:
    """Return a plain sphere about the origin, or none without a radius."""
    if panel.radius <= 0:
        return []
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 33), np.linspace(0, np.pi, 17))
    sphere = (np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v))
    x, y, z = ((panel.radius * part).astype(np.float32) for part in sphere)
    look = {"colorscale": [[0, SKY], [1, SKY]], "opacity": 0.55, "showscale": False, "hoverinfo": "skip"}
    light = {"lighting": {"ambient": 0.75, "diffuse": 0.4, "specular": 0.05}}
    return [{"type": "surface", "x": x, "y": y, "z": z, "showlegend": False, **look, **light}]


def _camera(panel: Panel) -> dict[str, Any]:
    """Return a camera position near the normal to the plane of the last path, which is the truth."""
    last = panel.series[-1]
    assert last.z is not None
    points = np.stack([_numbers(part) for part in (last.x, last.y, last.z)], axis=-1).astype(np.float64)
    points = points[np.isfinite(points).all(-1)]
    normal = np.cross(points[:-1], points[1:]).sum(0) if len(points) > 1 else np.zeros(3)
    size = float(np.linalg.norm(normal))
    eye = (normal / size if size > 0 else np.array([0.7, 0.7, 0.0])) + np.array([0.25, 0.25, 0.25])
    eye *= DISTANCE / np.linalg.norm(eye)
    return {"eye": dict(zip("xyz", eye.tolist(), strict=True)), "up": {"x": 0, "y": 0, "z": 1}}


def _precise(values: Tensor) -> np.ndarray:
    """Return values in full precision, since energies vary by less than the resolution of float32."""
    return values.detach().numpy()


def _numbers(values: Tensor) -> np.ndarray:
    """Return values as float32, embedded as bytes; values out of range are infinite and not drawn."""
    return values.detach().float().numpy()
