"""Results survive their file exactly, whatever their numbers; other files are refused by name."""

from __future__ import annotations

import json
import math
import os
import subprocess

import pytest
from cases import MODEL, make_case, make_results, scores
from hypothesis import given, settings
from hypothesis import strategies as st

from ahnn.errors import UserError
from ahnn.evaluation import Findings, Row, Who, evaluation_folder, load_results, report
from ahnn.evaluation.provenance import commit, provenance
from ahnn.evaluation.results import NOT_FINITE, decoded, encoded, plain, write_results
from ahnn.metrics import Scores

TEXT = st.text(max_size=12).filter(lambda text: text not in NOT_FINITE)
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | TEXT,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXT, inner, max_size=3),
    max_leaves=8,
)
NUMBERS = st.dictionaries(TEXT, VALUES, max_size=3)
WHO = st.builds(
    Who,
    st.sampled_from(["model", "exact flow"]) | st.text(),
    st.sampled_from(["true", "perturbed"]),
    st.none() | st.text(),
    st.sampled_from(["whole", "settled"]),
    st.booleans(),
)
SCORES = st.builds(
    Scores,
    *[st.floats()] * 4,
    st.none() | st.floats(),
    st.lists(st.floats(), max_size=4).map(tuple),
)
ROWS = st.lists(st.builds(Row, WHO, SCORES, st.text(), NUMBERS), max_size=3).map(tuple)


def same(a, b):
    """Equality in which nan is nan and -0.0 is not 0.0."""
    if isinstance(a, float) and isinstance(b, float):
        return math.isnan(a) == math.isnan(b) and (
            math.isnan(a) or (a, math.copysign(1, a)) == (b, math.copysign(1, b))
        )
    if isinstance(a, dict):
        return isinstance(b, dict) and a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    if isinstance(a, list | tuple):
        return type(a) is type(b) and len(a) == len(b) and all(map(same, a, b))
    return type(a) is type(b) and a == b


@settings(max_examples=150, deadline=None)
@given(ROWS, NUMBERS, NUMBERS, st.text())
def test_round_trip_is_exact(rows, training, numbers, label):
    results = make_results(*rows, training=training, numbers=numbers, label=label)
    text = json.dumps(encoded(results), allow_nan=False)
    assert same(decoded(json.loads(text)), results)


def test_the_file_of_a_report_is_read_again(tmp_path, capsys):
    plugins = {"rows": lambda _: Findings(numbers={"a": math.inf})}
    results = report(make_case(tmp_path), plugins, {"val_loss": math.nan}, figures=False)
    assert same(load_results(tmp_path), results)
    content = json.loads((tmp_path / "metrics.json").read_text())
    assert content["plugins"]["rows"] == {"a": "inf"}
    assert content["plugins"]["worth"]["worthless"] is False
    assert [row["name"] for row in content["rows"]][:2] == ["model of mine"] * 2
    assert content["rows"][0]["position"] == results.row(MODEL).scores.position
    assert {"ahnn", "commit", "command", "host", "threads", "torch", "python", "date"} <= set(
        content["about"]
    )
    assert "model of mine on spring: all but the stiffness" in capsys.readouterr().out


def test_energies_that_are_not_known_are_null(tmp_path):
    report(make_case(tmp_path, truth=None, perturbation=None), {}, {}, figures=False)
    assert json.loads((tmp_path / "metrics.json").read_text())["rows"][0]["energy"] is None
    assert load_results(tmp_path).rows[0].scores.energy is None


def write(folder, change):
    write_results(folder, make_results(Row(MODEL, scores())))
    content = json.loads((folder / "metrics.json").read_text())
    change(content)
    (folder / "metrics.json").write_text(json.dumps(content))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda c: c.update(schema=1), "expected schema 2; received 1"),
        (lambda c: c.pop("schema"), "expected schema 2; received none"),
        (lambda c: c.pop("rows"), "damaged file: no 'rows'"),
        (
            lambda c: c["rows"][0].update(start="late"),
            "start: expected one of true, perturbed, fitted; received 'late'",
        ),
        (lambda c: c["rows"][0].update(position=None), "position: expected float; received None"),
        (lambda c: c["rows"][0].update(position="many"), "damaged"),
        (lambda c: c["units"].update(mass="kg"), "damaged"),
        (lambda c: c.update(rows=3), "damaged"),
        (lambda c: c.update(inertia=[1.0, "one"]), "damaged"),
        (lambda c: c.update(components="qp"), "damaged"),
        (lambda c: c.update(model=None), "damaged"),
        (lambda c: c["rows"][0].update(note=1), "damaged"),
        (lambda c: c["rows"][0].update(components=[True]), "damaged"),
        (lambda c: c.update(plugins=[1]), "damaged"),
        (lambda c: c.update(model={"_target_": "os.system"}), "damaged file: a key _target_"),
        (lambda c: c["rows"][0].update(note={"_target_": "os.system"}), "damaged file: a key _target_"),
    ],
)
def test_other_files_are_refused(tmp_path, change, reason):
    write(tmp_path, change)
    with pytest.raises(UserError) as error:
        load_results(tmp_path)
    assert str(tmp_path / "metrics.json") in str(error.value)
    assert reason in str(error.value)


@pytest.mark.parametrize("content", [b"", b"[1, 2]", b"{", b"\xff", b"null", b"[" * 100_000])
def test_damaged_files_are_refused(tmp_path, content):
    (tmp_path / "metrics.json").write_bytes(content)
    with pytest.raises(UserError, match=r"metrics\.json: expected the results of an evaluation"):
        load_results(tmp_path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(UserError, match=r"metrics\.json: .*No such file"):
        load_results(tmp_path)


def test_tensors_become_numbers_and_paths_texts(tmp_path):
    import torch

    assert plain({"a": torch.tensor([1.0, math.inf]), 3: tmp_path}) == {"a": [1.0, "inf"], "3": str(tmp_path)}


def test_no_password_is_kept(monkeypatch, tmp_path):
    monkeypatch.setattr(
        "sys.orig_argv", ["python", "-m", "ahnn.train", "storage=postgresql://me:secret@host/db"]
    )
    assert provenance()["command"] == "python -m ahnn.train storage=postgresql://***@host/db"
    assert commit(tmp_path) is None


def test_a_later_evaluation_has_a_folder_of_its_own(tmp_path):
    with evaluation_folder(tmp_path) as first, evaluation_folder(tmp_path) as second:
        assert first != second
        assert first.parent == second.parent == tmp_path / "evaluations"
    with evaluation_folder(tmp_path, "ukf_ground_station") as named:
        pass
    with evaluation_folder(tmp_path, "ukf_ground_station") as again:
        assert again == named
        (named / "metrics.json").write_text("{}")
    with pytest.raises(UserError, match="expected a new name"), evaluation_folder(tmp_path, named.name):
        pass


@pytest.mark.parametrize(
    "name", ["", "..", ".", "a/b", "a\\b", ".hidden", "a\nb", "a\n", "a b", "-x", "x" * 101]
)
def test_names_that_are_paths_are_refused(tmp_path, name):
    with (
        pytest.raises(UserError, match="evaluation name: expected"),
        evaluation_folder(tmp_path / "run", name),
    ):
        pass
    assert not (tmp_path / "run").exists()


def test_a_run_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "evaluations").write_text("a file")
    with pytest.raises(UserError, match="evaluations: expected a folder"), evaluation_folder(tmp_path):
        pass


def test_the_commit_is_read_without_a_lock_on_the_repository(tmp_path):
    git = ["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@b"]
    (tmp_path / "file").write_text("a")
    for words in (["init", "-q"], ["add", "file"], ["commit", "-qm", "a"]):
        subprocess.run([*git, *words], check=True)
    head = subprocess.run(
        [*git, "rev-parse", "HEAD"], check=True, capture_output=True, text=True
    ).stdout.strip()
    index = tmp_path / ".git" / "index"
    os.utime(tmp_path / "file", (1, 1))  # the index is out of date, git would write it anew
    before = index.stat().st_ino
    assert commit(tmp_path) == head
    assert index.stat().st_ino == before
    (tmp_path / "file").write_text("b")
    assert commit(tmp_path) == f"{head}-dirty"
