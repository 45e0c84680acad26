"""A browser shows a report from the disk: nothing is loaded, logged as an error, or wider than a phone."""

from __future__ import annotations

import io

import numpy as np
import pytest
from browser import CHROMIUM, browser
from PIL import Image
from synthetic_runs import ORBITS, run

from ahnn_plugins.report import Report

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")

ORBIT = "[...document.querySelectorAll('.js-plotly-plot')].find(plot => plot._fullLayout.scene)"
CAMERA = f"JSON.stringify({ORBIT}._fullLayout.scene.camera.eye)"
MIDDLE = (
    f"(() => {{ const plot = {ORBIT}; plot.scrollIntoView({{block: 'center'}});"
    " const r = plot.getBoundingClientRect(); return [r.x + r.width / 2, r.y + r.height / 2]; })()"
)


@pytest.fixture
def page(tmp_path):
    pytest.importorskip("plotly", reason="the extra `report` is needed")
    Report()([run(tmp_path, ORBITS, "AHNN5", seed) for seed in (7, 201)], tmp_path / "out")
    with browser(tmp_path / "profile") as shown:
        yield shown


@pytest.mark.slow
def test_a_report_is_shown_on_a_desk_and_on_a_phone_and_its_orbit_turns(page, tmp_path):
    path = tmp_path / "out" / "report.html"
    grounds = []
    for width, dark in ((1280, False), (390, False), (1280, True)):
        page.open(path, width, dark=dark)
        assert page.value("document.documentElement.scrollWidth <= innerWidth")
        assert page.value("document.querySelector('.modebar-btn') !== null") == (width > 640)
        pixels = np.asarray(Image.open(io.BytesIO(page.picture())).convert("L"))
        assert pixels.std() > 10, "a blank page"
        grounds.append(int(np.median(pixels)))
    assert min(grounds[:2]) > 200 > 60 > grounds[2]
    assert page.value("[...document.querySelectorAll('.scroll')].some(e => e.scrollWidth > e.clientWidth)")

    before = page.value(CAMERA)
    x, y = page.value(MIDDLE)
    for kind, at, buttons in (
        ("mousePressed", 0, 1),
        ("mouseMoved", 40, 1),
        ("mouseMoved", 90, 1),
        ("mouseReleased", 90, 0),
    ):
        page(
            "Input.dispatchMouseEvent", type=kind, x=x + at, y=y, button="left", buttons=buttons, clickCount=1
        )
        page.value("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))")
    assert page.value(CAMERA) != before

    page("Emulation.setEmulatedMedia", media="print")
    for hidden in ("nav", ".modebar"):
        assert page.value(f"getComputedStyle(document.querySelector('{hidden}')).display") == "none"
    page.value("dispatchEvent(new Event('beforeprint'))")
    assert page.value("document.querySelectorAll('details:not([open])').length") == 0
    assert not page.problems
    assert {*page.requests} == {path.resolve().as_uri()}
