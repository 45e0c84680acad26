"""What this program did not write is never replaced, removed, or written through a link: at any door."""

from __future__ import annotations

import hashlib
import math
import threading

import pytest
from cases import MODEL, make_results, scores
from entry import SMALL, call
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure

from ahnn.errors import Occupied, UserError
from ahnn.evaluation import Row
from ahnn.evaluation.results import write_results
from ahnn.files import claimed, write_atomically
from ahnn.manifest import NAME, is_own, recorded, remove_own, require_folder, require_own

START = "start=[7000,0,0,0,7.5,0]"
PREDICT = ("pretrained=molniya_central_body", START, "duration=10min")
MINE = b"the work of an afternoon"


def contents(folder):
    """Every file below a folder but manifests, links as what they point to."""
    return {
        str(path.relative_to(folder)): f"-> {path.readlink()}" if path.is_symlink() else path.read_bytes()
        for path in folder.rglob("*")
        if path.name != NAME and (path.is_symlink() or path.is_file())
    }


def test_ours_is_replaced_while_it_is_unchanged(tmp_path):
    path = tmp_path / "a.csv"
    write_atomically(path, b"1")
    write_atomically(path, b"2")
    assert path.read_bytes() == b"2"
    assert recorded(tmp_path) == {"a.csv": {hashlib.sha256(c).hexdigest() for c in (b"1", b"2")}}
    path.write_bytes(MINE)
    with pytest.raises(UserError, match=r"a\.csv, a file that"):
        write_atomically(path, b"3")
    remove_own(path)
    assert path.read_bytes() == MINE


STEPS = st.lists(st.tuples(st.sampled_from(["ours", "theirs", "remove", "delete"]), st.binary(max_size=3)))


@given(steps=STEPS)
def test_a_file_of_theirs_survives_whatever_we_do(tmp_path_factory, steps):
    path = tmp_path_factory.mktemp("folder") / "x"
    written, theirs = set(), None  # what we wrote, and what lies there of theirs
    for what, content in steps:
        if what == "theirs":
            path.write_bytes(content)
            theirs = None if content in written else content
        elif what == "delete":
            path.unlink(missing_ok=True)
            theirs = None
        elif what == "remove":
            remove_own(path)
        elif theirs is None:
            write_atomically(path, content)
            written.add(content)
            assert path.read_bytes() == content
        else:
            with pytest.raises(UserError):
                write_atomically(path, content)
        assert theirs is None or path.read_bytes() == theirs


def test_a_cut_manifest_keeps_what_it_has_and_goes_on(tmp_path):
    write_atomically(tmp_path / "a", b"1")
    manifest = tmp_path / NAME
    manifest.write_bytes(manifest.read_bytes()[:-2])
    assert not is_own(tmp_path / "a")
    write_atomically(tmp_path / "b", b"2")
    assert is_own(tmp_path / "b")


def test_the_manifest_is_neither_a_link_nor_a_file_of_somebody_else(tmp_path):
    for name, make in (
        ("link", lambda p: p.symlink_to(tmp_path / "kept")),
        ("file", lambda p: p.write_bytes(MINE)),
    ):
        folder = tmp_path / name
        folder.mkdir()
        make(folder / NAME)
        with pytest.raises(UserError, match="expected the files that ahnn wrote there"):
            write_atomically(folder / "a", b"1")
        assert not (folder / "a").exists()
    assert not (tmp_path / "kept").exists()


@pytest.mark.parametrize("kept", [True, False], ids=["link", "dangling"])
def test_nothing_is_written_through_a_link(tmp_path, kept):
    target, path = tmp_path / "target", tmp_path / "a.csv"
    if kept:
        target.write_bytes(MINE)
    path.symlink_to(target)
    with pytest.raises(UserError, match="a link that"):
        write_atomically(path, b"1")
    assert path.is_symlink()
    assert target.exists() == kept


def test_temporary_files_of_others_stay(tmp_path):
    write_atomically(tmp_path / "a", b"1")
    left = tmp_path / f".a.{hashlib.sha256(b'1').hexdigest()[:24]}01234567.tmp"  # as a kill leaves it
    theirs = tmp_path / f".notes.{'0' * 32}.tmp"
    for path in (left, theirs):
        path.write_bytes(b"x")
    write_atomically(tmp_path / "b", b"2")
    assert (left.exists(), theirs.exists()) == (False, True)


def test_a_claim_takes_no_file_of_somebody_else(tmp_path):
    (tmp_path / ".claim").write_bytes(MINE)
    with pytest.raises(UserError, match="expected no file of that name"), claimed(tmp_path):
        pass
    assert (tmp_path / ".claim").read_bytes() == MINE


def test_a_manifest_that_another_process_has_only_begun_is_shared(tmp_path):
    (tmp_path / NAME).touch()
    write_atomically(tmp_path / "a.csv", b"x")
    require_own([tmp_path / "a.csv"], "test")
    (tmp_path / "mine.csv").write_bytes(MINE)
    with pytest.raises(UserError, match="neither"):
        require_own([tmp_path / "mine.csv"], "test")


def test_threads_share_a_manifest(tmp_path):
    paths = [tmp_path / f"{k}.csv" for k in range(40)]
    workers = [threading.Thread(target=write_atomically, args=(path, b"x")) for path in paths]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    require_own(paths, "test")


@pytest.mark.parametrize(
    "made", ["figures/mine.png", "config.yaml", "metrics.json", "predictions.safetensors", "notes.txt"]
)
@pytest.mark.sampled(2)
def test_a_training_takes_no_folder_of_somebody_else(tmp_path, monkeypatch, capsys, made):
    folder = tmp_path / "proj"
    (folder / made).parent.mkdir(parents=True)
    (folder / made).write_bytes(MINE)
    monkeypatch.chdir(tmp_path)
    before = contents(tmp_path)
    assert call("ahnn.train", "run=proj", *SMALL) == 2
    assert "run proj: expected a new or empty folder" in capsys.readouterr().err.replace(f"{tmp_path}/", "")
    monkeypatch.chdir(folder)
    assert call("ahnn.train", "run=.", *SMALL) == 2
    assert contents(tmp_path) == before


def test_a_sweep_takes_no_folder_of_somebody_else(tmp_path, monkeypatch, capsys):
    (tmp_path / "proj").mkdir()
    (tmp_path / "proj" / "multirun.yaml").write_bytes(MINE)
    monkeypatch.chdir(tmp_path)
    before = contents(tmp_path)
    assert call("ahnn.train", "-m", "hydra.sweep.dir=proj", "seed=1,2", *SMALL) == 2
    assert "hydra.sweep.dir proj: expected a new or empty folder" in capsys.readouterr().err
    assert contents(tmp_path) == before


@pytest.fixture
def evaluated(tmp_path):
    """A run folder with results, as one finds it in a colleague's folder."""
    write_results(tmp_path / "run", make_results(Row(MODEL, scores())))
    return tmp_path / "run"


def test_a_report_takes_no_folder_of_somebody_else(tmp_path, evaluated, capsys):
    thesis = tmp_path / "thesis"
    for name in ("figures/mine.png", "tables/mine.tex", "report.html"):
        (thesis / name).parent.mkdir(parents=True, exist_ok=True)
        (thesis / name).write_bytes(MINE)
    before = contents(thesis)
    assert call("ahnn.report", str(evaluated), f"output={thesis}") == 2
    assert "expected a new or empty folder" in capsys.readouterr().err
    (evaluated / "report").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "elsewhere").mkdir()
    assert call("ahnn.report", str(evaluated)) == 2
    assert "received a link that" in capsys.readouterr().err
    assert contents(thesis) == before
    assert not [*(tmp_path / "elsewhere").iterdir()]


@pytest.mark.parametrize("inside", ["figures", "tables"])
def test_a_report_is_written_anew_and_follows_no_link_inside(tmp_path, evaluated, capsys, inside):
    arguments = (str(evaluated), "report.figures=false", f"output={tmp_path / 'out'}")
    assert call("ahnn.report", *arguments) == 0
    (tmp_path / "out" / inside).mkdir(exist_ok=True)
    (tmp_path / "out" / inside / "mine.txt").write_bytes(MINE)
    assert call("ahnn.report", *arguments) == 0
    assert (tmp_path / "out" / inside / "mine.txt").read_bytes() == MINE
    (tmp_path / "out" / inside).rename(tmp_path / "elsewhere")
    (tmp_path / "out" / inside).symlink_to(tmp_path / "elsewhere")
    before = contents(tmp_path)
    assert call("ahnn.report", *arguments) == 2
    assert "received a link that" in capsys.readouterr().err
    assert contents(tmp_path) == before


@pytest.mark.parametrize(("key", "name"), [("output", "orbit.csv"), ("figure", "orbit.png")])
@pytest.mark.parametrize("link", [False, True])
def test_a_prediction_replaces_its_own_files_alone(tmp_path, capsys, key, name, link):
    path = tmp_path / name
    assert call("ahnn.predict", *PREDICT, f"{key}={path}") == 0
    assert call("ahnn.predict", *PREDICT, f"{key}={path}") == 0
    path.unlink()
    if link:
        path.symlink_to(tmp_path / "elsewhere")
    else:
        path.write_bytes(MINE)
    before = contents(tmp_path)
    assert call("ahnn.predict", *PREDICT, f"{key}={path}") == 2
    assert f"{key}: expected a new file" in capsys.readouterr().err
    assert contents(tmp_path) == before


def test_a_prediction_is_not_written_over_its_start(tmp_path, capsys):
    path = tmp_path / "orbit.oem"
    assert (
        call(
            "ahnn.predict", *PREDICT, "epoch=2026-01-01T00:00:00", "frame=[GCRF,EARTH,UTC]", f"output={path}"
        )
        == 0
    )
    before = contents(tmp_path)
    words = ("pretrained=molniya_central_body", f"start={path}", "duration=10min")
    assert call("ahnn.predict", *words, f"output={path}") == 2
    assert "expected a file other than the start" in capsys.readouterr().err
    assert contents(tmp_path) == before


def test_pictures_of_data_replace_no_others(tmp_path, capsys):
    table = tmp_path / "swing.csv"
    table.write_text(
        "t [s],x [m],vx [m/s]\n" + "".join(f"{k},{math.cos(k)},{-math.sin(k)}\n" for k in range(40))
    )
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "swing.csv.png").write_bytes(MINE)
    before = contents(tmp_path)
    assert call("ahnn.data.__main__", "check", str(table), f"figures={tmp_path / 'figures'}") == 2
    assert "figures: expected a new file" in capsys.readouterr().err
    assert contents(tmp_path) == before


def test_an_evaluation_has_its_name_alone(tmp_path):
    from ahnn.evaluation import evaluation_folder

    with evaluation_folder(tmp_path, "first"), pytest.raises(Occupied), evaluation_folder(tmp_path, "first"):
        pass
    (tmp_path / "evaluations" / "mine").mkdir()
    (tmp_path / "evaluations" / "mine" / "figure.png").write_bytes(MINE)
    with (
        pytest.raises(UserError, match="expected a new or empty folder"),
        evaluation_folder(tmp_path, "mine"),
    ):
        pass


def test_a_resumed_run_keeps_the_pictures_of_others(tmp_path):
    for name in ("config.yaml", "figures/error.png"):
        write_atomically(tmp_path / name, b"x")
    require_folder(tmp_path, "run", [tmp_path / "figures" / "error.png"], ("figures",))
    (tmp_path / "figures" / "error.png").write_bytes(MINE)
    with pytest.raises(UserError, match=r"run: expected a new file.*error\.png"):
        require_folder(tmp_path, "run", [tmp_path / "figures" / "error.png"], ("figures",))


def test_pictures_are_not_drawn_through_a_link(tmp_path):
    from ahnn.evaluation.sinks.figure_files import write_figures

    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "figures").symlink_to(tmp_path / "elsewhere")
    found = {"error": Figure(figsize=(1, 1))}
    with pytest.raises(UserError, match="received a link that"):
        write_figures(tmp_path, found)
    assert not [*(tmp_path / "elsewhere").iterdir()]
