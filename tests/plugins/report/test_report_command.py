"""The command writes a report whole, refuses what it cannot, and leaves the files of others alone."""

from __future__ import annotations

import sys

import pytest
from entry import call
from runs import reproduction, results, scores, write

from ahnn.evaluation import Row, Who
from ahnn.files import write_atomically

NONE = "report.figures=false"


@pytest.fixture
def run(tmp_path):
    return write(tmp_path / "run", results([Row(Who("model", "true"), scores(1.0))]))


@pytest.mark.usefixtures("stand_in")
def test_files_stand_beside_the_page_and_those_of_an_earlier_report_make_way(run, capsys):
    assert call("ahnn.report", str(run)) == 0
    assert "1 run, 2 figures" in capsys.readouterr().out
    folder = run / "report"
    for suffix in (".png", ".pdf"):
        write_atomically(folder / "figures" / f"old{suffix}", b"old")
    write_atomically(folder / "tables" / "old.tex", b"old")
    (folder / "notes.txt").write_text("mine")
    assert call("ahnn.report", f"run={run}") == 0
    names = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    names -= {f"{place}.ahnn-files" for place in ("", "figures/", "tables/")}
    pictures_of = {
        f"figures/{n}{s}" for n in ("mass_spring_orbit", "_curve") for s in (".png", ".svg", ".pdf")
    }
    table = ("tables/scores_mass_spring.tex", "tables/scores_mass_spring.md")
    assert names == {"report.html", "tables.csv", *table, "notes.txt", *pictures_of}
    printed = (folder / "figures" / "_curve.pdf").read_bytes()
    assert printed.startswith(b"%PDF")
    assert all(word not in printed for word in (b"Type3", b"CreationDate"))
    text = (folder / "report.html").read_text()
    assert "A &lt;b&gt;curve&lt;/b&gt;" in text
    assert text.count("Seen from above.") == 1


def test_a_folder_of_others_is_refused_and_left_alone(run, tmp_path, capsys):
    mine = tmp_path / "mine"
    (mine / "figures").mkdir(parents=True)
    (mine / "figures" / "mine.png").write_bytes(b"mine")
    assert call("ahnn.report", str(run), f"output={mine}", NONE) == 2
    assert "expected a new or empty folder" in capsys.readouterr().err
    assert [path.name for path in mine.rglob("*")] == ["figures", "mine.png"]


def test_many_folders_are_one_report_with_the_confidence_asked_for(tmp_path):
    one = reproduction(tmp_path / "a", models=("MLP",))
    other = reproduction(tmp_path / "b", models=("NODE",))
    out = f"output={tmp_path}/out"
    assert call("ahnn.report", str(one), str(other), out, NONE, "report.confidence=0.8") == 0
    text = (tmp_path / "out" / "report.html").read_text()
    assert "6 runs on mass_spring" in text
    assert "80%" in text
    assert not (tmp_path / "out" / "figures").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "usage: python -m ahnn.report DIR... | run=DIR [output=FOLDER]; received neither"),
        (["nowhere"], "nowhere: expected a run, or a folder of runs"),
        (["run=nowhere"], "run=nowhere: expected one evaluated run"),
        (["DIR", "run=DIR"], "received both"),
        (["DIR", "ouput=x"], "unknown key 'ouput'; did you mean 'output'?"),
        (["DIR", "report.confidence=2"], "report.confidence: expected float > 0.5 and < 1; received 2"),
        (["DIR", "report.figure=false"], "did you mean 'report.figures'?"),
    ],
)
def test_mistakes_are_one_message_and_write_nothing(run, arguments, said, capsys, monkeypatch):
    monkeypatch.chdir(run.parent)
    words = [word.replace("DIR", "run") if "DIR" in word else word for word in arguments]
    assert call("ahnn.report", *words) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert [path.name for path in run.iterdir()] == ["metrics.json"]


def test_without_plotly_one_message_says_how_to_get_it(run, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "plotly", None)
    assert call("ahnn.report", str(run)) == 2
    error = capsys.readouterr().err
    assert error.startswith("ahnn: figures, unless report.figures=false: expected the package plotly")
    assert "pip install 'ahnn[report]'" in error
    assert [path.name for path in run.iterdir()] == ["metrics.json"]
    assert call("ahnn.report", str(run), NONE) == 0


def test_help_says_what_is_written(capsys):
    assert call("ahnn.report", "--help") == 0
    out = capsys.readouterr().out
    assert "output=FOLDER" in out
    assert max(map(len, out.splitlines())) <= 100
