"""A page is whole HTML that loads nothing, and what a run folder says is text in it and never more."""

from __future__ import annotations

from html.parser import HTMLParser

import pytest
from runs import ORBIT, SPRING, paper_rows, reproduction, results, scores, write

from ahnn.evaluation import Row, Who
from ahnn_plugins.report import Report
from ahnn_plugins.report.markup import VOID, Markup, escaped, safe_name, tag
from ahnn_plugins.report.plugin_numbers import listed
from ahnn_plugins.report.spreadsheet import scores_csv

EVIL = "<script>alert(1)</script>"


class Reader(HTMLParser):
    """Reads a page, and asserts that its elements close in turn."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.ids, self.links, self.loads, self.texts = [], [], [], [], [], []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        named = dict(attrs)
        self.tags.append(tag)
        self.ids += [named["id"]] if "id" in named else []
        self.links += [named["href"]] if tag == "a" else []
        self.loads += [v for k, v in attrs if k in ("src", "srcset") or (k == "href" and tag != "a")]
        assert not [key for key in named if key.startswith("on")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)


def report(folders, output, **options):
    Report(figures=False, **options)(folders, output)
    text = (output / "report.html").read_text()
    return text, Reader(text)


def test_the_page_of_a_reproduction_is_whole_and_loads_nothing(tmp_path):
    folders = [reproduction(tmp_path / "a"), reproduction(tmp_path / "b", ORBIT)]
    text, page = report(folders, tmp_path / "out")
    assert not page.loads
    assert "default-src &#x27;none&#x27;" in text
    assert len({*page.ids}) == len(page.ids)
    assert {link.removeprefix("#") for link in page.links} <= {*page.ids}
    said = " ".join(page.texts)
    for part in (
        "Table 1 of the paper",
        "Table 2 of the paper",
        "Ablation of the window W",
        "Cost.",
        "does not hold",
    ):
        assert part in said
    assert page.tags.count("h1") == 1
    names = sorted(str(path.relative_to(tmp_path / "out")) for path in (tmp_path / "out").rglob("*.tex"))
    assert {"tables/table1_mass_spring.tex", "tables/table2_molniya.tex"} <= {*names}


def test_scores_of_measurements_and_the_frame_mean_in_a_report_what_they_mean_in_the_terminal(tmp_path):
    rows = [Row(Who("model", "fitted"), scores(1.0), extra={"outliers": 0.0047})]
    found = results(rows, space=ORBIT._replace(frame="EME2000, from 2026-03-05T00:00:00.000 UTC"))
    _, page = report([write(tmp_path / "run", found)], tmp_path / "out")
    said = " ".join(page.texts)
    assert "errors are differences from the measurements and include their noise; 0.47 %" in said
    assert "in EME2000, EARTH, UTC, time zero 2026-03-05T00:00:00.000" in said


def evil_results(label=EVIL, **changes):
    rows = [
        Row(Who("model", "true"), scores(1.0), note=EVIL, extra={EVIL: EVIL}),
        Row(Who(EVIL, "true"), scores(1.0)),
        Row(Who("model", "true", EVIL), scores(1.0)),
        Row(Who(f"floor {EVIL}", "true", floor=True), scores(1.0)),
    ]
    space = SPRING._replace(name=f"../{EVIL}", frame=EVIL, units=SPRING.units._replace(position=EVIL))
    training = {"seed": EVIL, "window": EVIL, EVIL: [EVIL], "steps": {"a": EVIL}}
    band = {"mean": 1.0, "band_95": [0.0, 2.0]}
    judged = {"verdict": {"findings": [EVIL]}}
    numbers = {EVIL: {EVIL: band}, "b": EVIL, "c": [EVIL] * 20, **judged}
    more = {"training": training, "numbers": numbers}
    about = {"command": EVIL, EVIL: EVIL, "date": EVIL, "commit": EVIL, "ahnn": EVIL, "threads": EVIL}
    return results(rows, label, space=space, **more, about=about)._replace(assumes=EVIL, **changes)


@pytest.mark.parametrize("count", [1, 2])
def test_what_a_run_folder_says_is_shown_as_text(tmp_path, count):
    for number in range(count):
        folder = write(tmp_path / "runs" / f"a {number} &lt;{EVIL.replace('/', '')}", evil_results())
        (folder / "config.yaml").write_text(
            f"loss: !!python/object/apply:os.system ['touch {tmp_path}/hacked']\n# {EVIL}"
        )
    text, page = report([tmp_path / "runs"], tmp_path / "out")
    own = 1  # the page's own script, which opens details for print
    assert page.tags.count("script") == own
    assert "alert(1)" in " ".join(page.texts)
    assert "<script>alert" not in text
    assert not (tmp_path / "hacked").exists()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "runs"]
    for path in (tmp_path / "out" / "tables").iterdir():
        assert "<" not in path.read_text().replace("$<$", "")


def test_a_spreadsheet_computes_nothing_that_a_run_folder_says(tmp_path):
    from ahnn_plugins.report.collection import collect

    write(tmp_path / "a", evil_results("=HYPERLINK(1)"))
    assert ",'=HYPERLINK(1)," in scores_csv(collect([tmp_path]))


def test_the_page_of_one_run_has_its_settings_consistency_and_notes(tmp_path):
    band = {"nees": {"mean": 9.0, "band_95": [1.0, 2.0]}}
    rows = [*paper_rows("mass_spring", "HNN", 1.0), Row(Who("model", "fitted"), scores(1.0), note="a remark")]
    judged = {"findings": ["not good: relative error 1 %", "a reason"]}
    folder = write(tmp_path / "run", results(rows, numbers={"ukf": band, "verdict": judged}))
    (folder / "config.yaml").write_text("seed: 7\nmodel: {width: 64}\n")
    text, page = report([folder], tmp_path / "out")
    said = " ".join(page.texts)
    for part in ("width: 64", "overconfident", "a remark", "0123456789abcdef", "UKF, perturbed start"):
        assert part in said
    places = [said.index(part) for part in ("not good: relative error 1 %", "a reason", "prior knowledge")]
    assert places == sorted(places)
    assert "their cells are empty" not in said
    assert "Claims" not in text
    assert {link.removeprefix("#") for link in page.links} <= {*page.ids}


def test_markup_escapes_all_that_it_did_not_make():
    made = tag("p", "a<b", [tag("b", '"&"')], title='x" y', class_="c", data_x=1, hidden=None)
    assert made == '<p title="x&quot; y" class="c" data-x="1">a&lt;b<b>&quot;&amp;&quot;</b></p>'
    assert isinstance(made, Markup)
    assert escaped([made, "<"]) == made + "&lt;"
    assert tag("br") == "<br>"
    assert [safe_name(name) for name in ("a_b-1", "../../x", "", "<b>")] == ["a_b-1", "_x", "_", "_b_"]


def test_further_numbers_are_listed_by_path_with_yes_and_no_and_without_missing_ones():
    numbers = {
        "held_out": 1.25,
        "mu": [398600.6, None],
        "consistent": True,
        "single": None,
        "right": [[0.1, 1.0], [0.5, 1.0]],
        "strengths": {"field.log_mu": 2},
        "parts": [{"name": "x"}, {"name": "y"}],
        "long": [*range(20)],
    }
    assert dict(listed(numbers)) == {
        "held out": "1.25",
        "mu": "398601, –",
        "consistent": "yes",
        "right": "0.1, 1; 0.5, 1",
        "strengths / field.log_mu": "2",
        "parts 1 / name": "x",
        "parts 2 / name": "y",
        "long": "0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, ... 20 in all",
    }
