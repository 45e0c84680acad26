"""Lines of many objects that are no measurements, objects that are lost or unknown, and states of others."""

from __future__ import annotations

import logging

import numpy as np
import pytest
from fleet import NAMES, PAIRS, SHARED, TEXT, rows_of, session, written
from following import SENSORS

from ahnn.assimilation.line_parser import Layout
from ahnn.assimilation.table_parser import TableParser
from ahnn.errors import TrainingError, UserError
from ahnn.files import write_state

BAD = {
    "1,body 0,ruler,x,": "q: expected a finite number; received 'x'",
    "1,body 0,ruler,1": "expected 5 cells; received 4",
    "x,body 0,ruler,1,": "time: expected a finite number; received 'x'",
    ",body 0,ruler,1,": "time: expected a number; received none",
    "1,,ruler,1,": "name: expected an object name",
    "1,body 0,sonar,1,": "sensor: expected one of ruler, radar; received 'sonar'",
    "1,body 0,ruler,inf,": "q: expected a finite number; received 'inf'",
    "1,body 0,ruler,1_0,": "q: expected a finite number; received '1_0'",
    '1,"body, 0",ruler,1,': "name: expected an object name without commas",
    "1,body 0,ruler,1e300,": "expected values that give a finite, precise estimate; received q 1e+300",
}


@pytest.mark.parametrize("line", BAD)
def test_a_bad_line_is_reported_and_the_rest_are_unharmed(tmp_path, caplog, line):
    lines = TEXT.splitlines()
    lines[5:5] = [line, "# a remark", "", lines[0]]
    session(TEXT, tmp_path / "clean.csv", every=100).run()
    with caplog.at_level(logging.INFO, "ahnn"):
        session("\n".join(lines), tmp_path / "out.csv", every=100).run()
    assert [text for text in caplog.messages if text.startswith(f"line 6: {BAD[line]}")], caplog.messages
    one, other = rows_of(tmp_path / "clean.csv"), rows_of(tmp_path / "out.csv")
    assert [row | {"line": ""} for row in one] == [row | {"line": ""} for row in other]


def test_columns_and_lines_say_the_same():
    head, names = "t [min];name;sensor;q [cm];sd_q [mm];p;sd_p", ["ruler", "radar"]
    draw = np.random.default_rng(1)
    cells = ["", "nan", "NA", " 3.5 ", "1e-3", "-2", "x", "inf", "0", "7"]
    layout = Layout(head, SENSORS, objects="name")
    parser = TableParser(layout, tuple(SHARED))
    texts = [
        ";".join([draw.choice(["1", "2.5", "", "1e999"]), "a", draw.choice(names), *draw.choice(cells, 4)])
        for _ in range(400)
    ]
    whole = parser.of_lines([*range(400)], texts)
    singly = [parser._joined([k], None, parser._singly([k], [text])) for k, text in enumerate(texts)]
    assert whole.bad == {k: why for one in singly for k, why in one.bad.items()}
    assert whole.lines == [k for one in singly for k in one.lines]
    assert 20 < len(whole.lines) < 380
    for k, part in enumerate(whole.table[1:], 1):
        joined = np.concatenate([one.table[k] for one in singly])
        assert np.array_equal(part, joined, equal_nan=k > 2)


def test_unknown_objects_are_told_once_and_a_common_start_takes_them_in(tmp_path, caplog):
    known = NAMES[:5]
    with caplog.at_level(logging.INFO, "ahnn"):
        made = session(TEXT, tmp_path / "some.csv", names=known)
        made.run()
    told = [text for text in caplog.messages if "has no start: ignored" in text]
    assert sorted(text.partition(": ")[2] for text in told) == [
        f"object {name} has no start: ignored" for name in NAMES[5:]
    ]
    assert made.counts["unknown"] == sum(name not in known for name, _ in PAIRS)
    made = session(TEXT, tmp_path / "all.csv", names=None)
    made.run()
    assert {*made.filter.names} == {*NAMES}
    first = {row["object"]: row for row in rows_of(tmp_path / "some.csv")}["body 0"]
    assert first["q"] == {row["object"]: row for row in rows_of(tmp_path / "all.csv")}["body 0"]["q"]


def test_a_lost_object_is_told_and_a_stream_of_which_nothing_counts_ends_with_a_reason(tmp_path, caplog):
    wild = [
        (n, r._replace(values=tuple(1e4 * v for v in r.values)) if n == NAMES[2] else r) for n, r in PAIRS
    ]
    with caplog.at_level(logging.WARNING, "ahnn"):
        made = session(written(wild), tmp_path / "out.csv")
        made.run()
    assert len(caplog.messages) == 1
    assert (
        "object body 2: expected a filter that follows its measurements; received DIVERGED"
        in caplog.messages[0]
    )
    assert {*made.filter.lost} == {NAMES[2]}
    session(TEXT, tmp_path / "clean.csv").run()
    others = [[r for r in rows_of(tmp_path / f) if r["object"] != NAMES[2]] for f in ("out.csv", "clean.csv")]
    assert others[0] == others[1]
    with pytest.raises(TrainingError, match=r"received 51 of 51 unknown. Their objects have no start"):
        session(TEXT, tmp_path / "none.csv", tmp_path / "none.state", names=["x"]).run()
    assert not (tmp_path / "none.csv").exists()
    assert not (tmp_path / "none.state").exists()


REFUSED = {
    "time,sensor,q\n1,ruler,2\n": "objects: expected the name of a column; received 'name'; it takes time",
    "time,name,sensor,x\n": "measurements: expected a header with time and name, q, p; received 'x'",
    "": "measurements: expected a header or JSON objects; received no line",
}


@pytest.mark.parametrize("text", REFUSED)
def test_a_bad_header_leaves_nothing_behind(tmp_path, text):
    with pytest.raises(UserError, match=r"(measurements|objects): ") as error:
        session(text, tmp_path / "out.csv", tmp_path / "state").run()
    assert REFUSED[text] in str(error.value)
    assert list(tmp_path.iterdir()) == []


def test_states_of_others_and_damaged_ones_are_refused(tmp_path):
    names = tmp_path / "out.csv", tmp_path / "state"
    session(TEXT, *names).run()
    with pytest.raises(
        UserError, match=r"saved with different values of window. Repeat the original command"
    ):
        session(TEXT, *names, window=3.0)
    with pytest.raises(UserError, match=r"start: expected the 7 objects of .* received different objects"):
        session(TEXT, *names, names=NAMES[:3])
    whole = names[1].read_bytes()
    for cut in (whole[:-40], whole[: len(whole) // 2], b""):
        write_state(names[1], cut)
        with pytest.raises(UserError, match="state: expected a file written by save"):
            session(TEXT, *names)


def test_a_column_that_a_sensor_has_names_no_object():
    with pytest.raises(UserError, match="objects: expected a column other than"):
        Layout("time,q", SENSORS, objects="q")
