"""No line is fatal: numbers of any size, fields of any length and any signs are bad lines, and skipped."""

from __future__ import annotations

import logging

import pytest
from following import SENSORS, SPACE, make, readings, session, written

from ahnn.assimilation import Reading, skipped_lines
from ahnn.assimilation.cells import BadLine
from ahnn.assimilation.line_parser import Layout
from ahnn.assimilation.online import Diverged
from ahnn.errors import UserError
from ahnn.estimation import Gate

UNGATED = ["{t},ruler,-1e100,,", "{t},ruler,1.2,,1e-160", "{t},ruler,1.2,,1e-200"]
"""They have a NIS, which a gate refuses."""
HEAD = "time [s],sensor,q [m],p,sd_q"
BAD = [
    "{t},ruler,1e155,,",
    "{t},ruler,1e300,,",
    "{t},ruler,1.2,,1e200",
    "{t},ruler,1e300,,1e300",
    "{t},radar,1e200,1e200,",
    '{t},ruler,"' + 131_073 * "1" + '",,',
    '{t},ruler,"1,,',
    "{t},ruler,\x00,,",
    '{t},"ruler\x00",1,,',
    "{t},ruler," + 400 * "9" + ",,",
    "9" * 400 + ",ruler,1,,",
    "2024-03-01T12:00:99,ruler,1,,",
]


@pytest.mark.parametrize("gate", [None, Gate(0.9999)])
def test_what_no_filter_can_take_is_a_bad_line_and_the_rest_as_without_it(
    tmp_path, caplog, gate, monkeypatch
):
    monkeypatch.setattr(skipped_lines, "SAID", len(BAD) + len(UNGATED))  # each of them is reported
    found = readings(20)
    clean = [HEAD, *(f"{line}," for line in written(found).splitlines()[1:])]
    bad = [*BAD, *(UNGATED if gate is None else [])]
    mixed = [*clean[:10], *(line.format(t=found[8].time + 1e-3) for line in bad), *clean[10:]]
    session("\n".join(clean), tmp_path / "clean.csv", gate=gate).run()
    with caplog.at_level(logging.INFO, "ahnn"):
        session("\n".join(mixed), tmp_path / "mixed.csv", gate=gate).run()
    reported = [text.partition(":")[0] for text in caplog.messages if text.endswith("; skipped")]
    assert reported == [f"line {k}" for k in range(11, 11 + len(bad))]
    assert "received q 1e+155; skipped" in caplog.messages[0]
    one, other = ((tmp_path / name).read_text().splitlines() for name in ("clean.csv", "mixed.csv"))
    assert [row.partition(",")[2] for row in one] == [row.partition(",")[2] for row in other]


def test_a_filter_that_cannot_take_what_it_expects_is_lost_and_not_the_line():
    filtering = make()
    before = filtering.update(Reading(0.1, (1.0,), "ruler"))
    broken = filtering.window.entries[-1]._replace(
        state=filtering.window.state._replace(
            belief=filtering.window.state.belief._replace(chol=before.covariance[None] * float("nan"))
        )
    )
    filtering.window = filtering.window._replace(entries=(broken,))
    with pytest.raises(Diverged, match=r"NOT_FINITE at time 0\.2"):
        filtering.update(Reading(0.2, (1.0,), "ruler"))


def test_columns_and_keys_that_come_twice_are_refused():
    with pytest.raises(UserError, match="a header with time and q, p, each once"):
        Layout("time,t,q", SENSORS)
    for text in ('{"time": 1, "t": 2, "sensor": "ruler", "q": 1}', '{"time": 1, "q": 1, "q": 2}'):
        with pytest.raises(BadLine):
            Layout("{", SENSORS).reading(text)
    with pytest.raises(UserError, match="expected lines that end with LF; received CR"):
        Layout("time,q\r1,2\r", SENSORS)
    with pytest.raises(UserError, match="measurements: expected a header"):
        Layout('time,"' + 131_073 * "q" + '"', SENSORS)


def test_quotes_and_units_of_a_header_are_those_of_files():
    table = Layout('"time (s)" ; "sensor";"q [cm]" ; p (m/s)', SENSORS)
    assert table.reading('"2" ;"radar"; "150";3').values == pytest.approx((1.5, 3.0))
    with pytest.raises(BadLine, match="q: expected a finite number"):
        table.reading("2;radar;1e308e;3")
    assert SPACE.units.position == "m"
    with pytest.raises(BadLine, match="q: expected a finite number"):
        Layout("time;sensor;q [km]", SENSORS).reading("2;ruler;1e307")
