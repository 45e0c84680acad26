"""The table fits 80 columns, cuts no number, and can be printed in any encoding."""

from __future__ import annotations

import io
import math
import re
import sys

import pytest
from cases import MODEL, SPACE, make_results, scores
from hypothesis import example, given, settings
from hypothesis import strategies as st

from ahnn.evaluation import Row, Who
from ahnn.evaluation.score_table import number, results_table, table_lines
from ahnn.evaluation.terminal import show, writable
from ahnn.evaluation.titles import described, metric_name, title
from ahnn.types import Units

FLOOR = Who("exact field, rk4", "true", floor=True)
UKF = Who("model", "perturbed", "ukf", "settled")
VALUES = (
    st.floats(min_value=0.0) | st.just(-0.0) | st.sampled_from([math.nan, math.inf, 1e-300, 9999.5, 999.96])
)
IDENTITIES = st.builds(
    Who,
    st.sampled_from(["model", "exact flow", "another process of a plugin with quite a long name"]),
    st.sampled_from(["true", "perturbed"]),
    st.sampled_from([None, "ukf", "ukf_tuned", "ukf_" + "long_" * 30]),
    st.sampled_from(["whole", "settled"]),
    st.booleans(),
)
ROWS = st.lists(
    st.builds(
        Row, IDENTITIES, st.builds(scores, VALUES, st.none() | VALUES), st.text(max_size=200), st.just({})
    ),
    unique_by=lambda row: row.who,
    max_size=8,
)


@settings(max_examples=200, deadline=None)
@given(ROWS, st.text("km²/s·µ[]", max_size=40), st.booleans())
@example(
    [Row(who, scores(1e-300, 1e-300)) for who in (MODEL, FLOOR, UKF, UKF._replace(floor=True))], "m", True
)
def test_it_fits_and_holds_every_number(rows, unit, detail):
    space = SPACE._replace(units=Units("s", unit, "m/s", "J"))
    text = results_table(make_results(*rows, space=space, label="m" * 90), detail=detail)
    assert max(map(len, text.splitlines())) <= 80
    words = text.split()
    for row in rows:
        assert number(row.scores.position) in words
        assert number(row.scores.energy) in words or row.scores.energy is None


@given(st.floats(max_value=1.7e308) | st.just(math.inf))
def test_a_number_keeps_two_digits_and_its_exponent(value):
    text = number(value)
    assert len(text) <= 9
    assert (
        float(text) == pytest.approx(value, rel=0.05, nan_ok=True) or abs(value) < 1e-307 or value < -1.7e308
    )
    assert math.copysign(1, float(text)) == math.copysign(1, value) or math.isnan(value)


def test_model_and_floor_stand_side_by_side():
    rows = [
        Row(MODEL, scores(1.5, 7.25)),
        Row(FLOOR, scores(0.25, None)),
        Row(UKF, scores(3.0)),
        Row(Who("exact flow", "perturbed", "ukf", "settled", floor=True), scores(4.0)),
        Row(Who("a rival", "true"), scores(5.0)),
        Row(FLOOR._replace(process="another floor"), scores(6.0)),
    ]
    pairs = {(line.section, line.name): line.rows for line in table_lines(rows, "mine")}
    assert pairs == {
        ("no measurements", "true start"): (rows[0], rows[1]),
        ("UKF", "perturbed, settled"): (rows[2], rows[3]),
        ("a rival", "true start"): (rows[4], None),
        ("another floor", "true start"): (None, rows[5]),
    }
    text = results_table(make_results(*rows))
    assert re.search(r"true start +1\.50 +0\.250 +1\.50 +0\.250 +7\.25 +-\n", text)
    assert re.search(r"position \[m\] +velocity \[m/s\] +energy \[J\]\n( +model +floor){3}\n", text)


def test_without_floors_and_energies_there_are_no_empty_columns():
    text = results_table(make_results(Row(MODEL, scores(1.5, None))))
    assert "energy" not in text
    assert "floor" not in text
    assert re.search(r"\n  true start +1\.50 +1\.50\n", text)


def test_notes_and_details_stand_below():
    row = Row(UKF, scores(), note="2 of 6 lost (not finite)")
    assert "model of mine + UKF, perturbed start, settled: 2 of 6 lost" in results_table(make_results(row))
    long = "a second finding that is longer than a line of the table, and goes on below, indented"
    several = results_table(make_results(Row(MODEL, scores(), note=f"a first finding\n{long}")))
    head, *below = several.splitlines()[-4:]
    assert head == "model of mine, true start:"
    assert below[0] == "  a first finding"
    assert below[1].startswith("  a second")
    assert below[2].startswith("    ")
    assert " ".join(line.strip() for line in below[1:]) == long
    detail = results_table(make_results(Row(MODEL, scores(1.5, None, (3.25, 4.5)))), detail=True)
    assert "components q 3.25, p/m 4.50" in detail


def test_components_that_were_never_measured_have_no_error_in_the_details():
    unseen = scores(1.5, None, (3.25, math.nan))._replace(velocity_pooled=math.nan)
    detail = results_table(make_results(Row(MODEL, unseen)), detail=True)
    assert "components q 3.25" in detail
    assert "nan" not in detail.rpartition("pooled position")[2]


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp1252", "utf-8"])
def test_any_encoding_can_show_it(monkeypatch, encoding):
    space = SPACE._replace(units=Units("s", "km", "km/s", "km²/s²"))
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, encoding=encoding))
    show(results_table(make_results(Row(MODEL, scores(), note="σ – 轨道 [red]"), space=space)))
    sys.stdout.flush()
    text = raw.getvalue().decode(encoding)
    assert ("km^2/s^2" if encoding == "ascii" else "km²/s²") in text
    assert ("σ" if encoding == "utf-8" else "sigma") in text
    assert "[red]" in text


def test_signs_without_a_stand_in_become_question_marks():
    assert writable("轨道 ±", "ascii") == "?? +/-"
    assert writable("x", None) == "x"


def test_names_follow_from_the_identity():
    assert title(MODEL, "mine") == "mine"
    assert title(Who("exact flow", "true", "ukf_tuned", floor=True), "mine") == "exact flow + UKF tuned"
    assert described(UKF, "mine") == "mine + UKF, perturbed start, settled"
    assert metric_name(MODEL, "position") == "score/position"
    assert metric_name(UKF, "position") == "score/position/ukf/perturbed/settled"
