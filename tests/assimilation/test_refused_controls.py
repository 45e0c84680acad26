"""Controls that a stream refuses: missing, of another number, no numbers, twice; and names that it takes."""

from __future__ import annotations

import logging
import math

import pytest
from following import make
from steering import steered_filter, steered_session
from test_controlled_streams import rows_of

from ahnn.assimilation import Reading
from ahnn.assimilation.cells import BadLine
from ahnn.assimilation.line_parser import Layout
from ahnn.controls import ControlTable
from ahnn.errors import UserError

TABLE = ControlTable.of([0.0], [[1.0, 2.0]])
PUSH = Reading(1.0, controls=(1.0, 2.0))


@pytest.mark.parametrize(
    ("reading", "options", "message"),
    [
        (
            Reading(1.0, (1.0,), "ruler"),
            {},
            "expected values at the start, time 0; received none before a reading at time 1",
        ),
        (PUSH, {}, r"controls: expected values .* at time 1\. Begin with a reading at time 0"),
        (PUSH._replace(controls=(1.0,)), {}, r"controls: expected 2 finite numbers .*; received \(1.0,\)"),
        (PUSH._replace(controls=(1.0, math.nan)), {}, r"expected 2 finite numbers .*; received \(1.0, nan\)"),
        (PUSH._replace(controls=(1.0, 1e200)), {}, r"expected 2 finite numbers up to 1e\+150"),
        (
            PUSH,
            {"controls": TABLE},
            r"expected controls either in a table or in readings; received a table and \(1.0, 2.0\)",
        ),
        (Reading(math.nan), {}, "reading: expected a finite time"),
    ],
)
def test_a_reading_whose_controls_are_none_is_refused_and_changes_nothing(reading, options, message):
    filtering = steered_filter(**options)
    before = filtering.window
    with pytest.raises(UserError, match=message):
        filtering.update(reading)
    assert filtering.window is before


def test_controls_of_a_model_that_has_none_and_tables_of_others_are_refused():
    with pytest.raises(
        UserError, match="expected none, since no force in the model depends on controls; received"
    ):
        make().update(PUSH)
    with pytest.raises(
        UserError, match="expected none, since no force in the model depends on controls; received"
    ):
        make(controls=TABLE)
    with pytest.raises(UserError, match=r"controls: expected a table of 2; received \(1, 1\)"):
        steered_filter(controls=ControlTable.of([0.0], [[1.0]]))
    with pytest.raises(
        UserError, match="controls: expected values at the start, time -1; received the first"
    ):
        steered_filter(controls=TABLE, time=-1.0)
    for times, values in (([0.0, 0.0], [[1.0], [2.0]]), ([0.0], [[math.nan]]), ([0.0], [1.0]), ([], [])):
        with pytest.raises(UserError, match=r"controls: expected increasing times \(T,\) and finite"):
            ControlTable.of(times, values)


HEADS = {
    "time,sensor,q,w": "expected a header with time and q, p, u, brake; received 'w'",
    "time,sensor,q,u,u": "with time and q, p, u, brake, each once; received",
    "time,sensor,q,torque": "received 'torque'",  # one of two controls is guessed by nobody
}


@pytest.mark.parametrize("head", HEADS)
def test_a_header_of_other_controls_is_refused_and_leaves_nothing(tmp_path, head):
    with pytest.raises(UserError) as error:
        steered_session(head + "\n", tmp_path / "out.csv", tmp_path / "state").run()
    assert HEADS[head] in str(error.value)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "options", "said"),
    [
        ("time,sensor,q\n1,ruler,2\n", {}, "controls: expected values at the start, time 0"),
        ('{"time": 1, "u": 1, "brake": 0}\n', {}, "controls: expected values at the start"),
        ("time,u,brake\n0,1,2\n", {"controls": TABLE}, "expected controls either in a table or in readings"),
    ],
)
def test_a_stream_without_its_controls_or_with_both_is_refused_and_leaves_nothing(
    tmp_path, text, options, said
):
    with pytest.raises(UserError) as error:
        steered_session(text, tmp_path / "out.csv", tmp_path / "state", **options).run()
    assert said in str(error.value)
    assert "\n" not in str(error.value)
    assert list(tmp_path.iterdir()) == []


def test_a_control_that_no_line_brings_is_named(tmp_path):
    with pytest.raises(UserError, match="received 1 of 2 before a reading at time 1"):
        steered_session("time,u,brake\n0,1,\n1,,2\n", tmp_path / "out.csv").run()


def test_a_control_that_cannot_be_read_is_a_bad_line_and_the_old_ones_hold(tmp_path, caplog):
    good = ["time,u,brake,sensor", "0,1,0,", "3,,,"]
    bad = ["1,inf,0,", "1,x,0,", "1,1e200,0,", "1,true,0,", "1,1_0,0,"]
    with caplog.at_level(logging.INFO, "ahnn"):
        steered_session("\n".join([*good[:2], *bad, good[2]]), tmp_path / "bad.csv").run()
    assert sum(text.endswith("; skipped") for text in caplog.messages) == len(bad)
    steered_session("\n".join(good), tmp_path / "good.csv").run()
    (*_, one), (*_, other) = (rows_of(tmp_path / f"{name}.csv") for name in ("bad", "good"))
    assert {**one, "line": ""} == {**other, "line": ""}


def test_the_only_control_may_have_any_name_of_a_control():
    sensors = steered_filter().sensors
    for head in ("time,sensor,q,u1", "time,sensor,q,torque_cmd", "time,sensor,q,Command [N]"):
        layout = Layout(head, sensors, controls=("u",))
        assert layout.reading("1,ruler,2,3").controls == (3.0,)
    assert Layout("{", sensors, controls=("u",)).reading('{"t": 1, "input": 2}') == Reading(
        1.0, controls=(2.0,)
    )
    with pytest.raises(BadLine, match="a duplicate key"):
        Layout("{", sensors, controls=("u",)).reading('{"t": 1, "input": 2, "u": 3}')
    with pytest.raises(UserError, match="expected sensors that do not measure controls; received q"):
        Layout("t,q", sensors, controls=("q",))
    assert Layout("t;u1", sensors, controls=("u",)).asks
