"""A stream line by line: bad lines, kills at any moment, pipes, what comes out, and what is made of it."""

from __future__ import annotations

import contextlib
import io
import json
import logging
import math
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest
from following import SENSORS, SPACE, make, readings, session, written
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from ahnn.assimilation import Reading
from ahnn.assimilation.assimilation_record import read_record
from ahnn.assimilation.cells import BadLine
from ahnn.assimilation.journal import Journal
from ahnn.assimilation.line_parser import Layout
from ahnn.assimilation.lines import LONGEST
from ahnn.assimilation.stream_figures import figures_of
from ahnn.assimilation.view import View
from ahnn.data.files import read_oem, write_oem
from ahnn.data.files.object_name import ObjectName
from ahnn.data.reference import Reference
from ahnn.errors import TrainingError, UserError
from ahnn.jobs.assimilating import estimated
from ahnn.types import Space, Units

FOUND = readings(40)
TEXT = written(FOUND)


class Pipe(io.BytesIO):
    """It outlives who reads it."""

    def close(self):
        """Nothing."""


class Killed(Exception):
    """The process is gone."""


def killer(after):
    """A watcher that ends everything after so many lines."""
    left = [after]

    def watch(*_):
        left[0] -= 1
        if left[0] < 0:
            raise Killed

    return watch


def test_rows_are_the_estimates_of_the_filter(tmp_path):
    session(TEXT, tmp_path / "out.csv").run()
    filtering = make()
    for reading in FOUND:
        estimate = filtering.update(reading)
    lines = (tmp_path / "out.csv").read_text().splitlines()
    row = dict(zip(lines[0].split(","), lines[-1].split(","), strict=True))
    assert len(lines) == 41
    assert (row["line"], row["sensor"], row["outcome"]) == ("41", FOUND[-1].sensor, "taken")
    assert [float(row[name]) for name in ("q", "p")] == estimate.mean.tolist()
    assert float(row["cov_p_q"]) == float(estimate.covariance[1, 0])
    session(TEXT, tmp_path / "out.jsonl", kind="json").run()
    last = json.loads((tmp_path / "out.jsonl").read_text().splitlines()[-1])
    assert {name: "" if value is None else str(value) for name, value in last.items()} == row


def test_a_bad_line_is_reported_with_its_number_and_skipped(tmp_path, caplog):
    lines = TEXT.splitlines()
    bad = [
        "foo",
        "1,2",
        ",ruler,1,",
        "1,sonar,2,",
        "x,ruler,1,",
        "2,ruler,inf,",
        "3,ruler,1_0,",
        "\x00,\x00,\xff,",
    ]
    mixed = [lines[0], "# a remark", "", *bad, "y" * (LONGEST + 10), lines[0], *lines[1:]]
    content = io.BytesIO("\n".join(mixed).encode("latin-1"))
    with caplog.at_level(logging.INFO, "ahnn"):
        session(content, tmp_path / "mixed.csv").run()
    session(TEXT, tmp_path / "clean.csv").run()
    reported = {text.partition(": ")[0] for text in caplog.messages if text.endswith("; skipped")}
    assert reported == {f"line {k}" for k in range(4, 13)}
    clean, found = ((tmp_path / name).read_text().splitlines() for name in ("clean.csv", "mixed.csv"))
    assert [row.partition(",")[2] for row in found] == [row.partition(",")[2] for row in clean]


@settings(max_examples=8)
@given(st.lists(st.integers(0, 12), min_size=1, max_size=4), st.integers(1, 7))
def test_a_stream_that_is_killed_at_any_moment_ends_with_the_same_bytes(tmp_path_factory, kills, every):
    folder = tmp_path_factory.mktemp("kills")
    session(TEXT, folder / "whole.csv", folder / "whole.state", every, window=2.0).run()
    for after in kills:
        attempt = session(TEXT, folder / "parts.csv", folder / "parts.state", every, window=2.0)
        with contextlib.suppress(Killed):
            attempt.run(killer(after))
    session(TEXT, folder / "parts.csv", folder / "parts.state", every, window=2.0).run()
    assert (folder / "parts.csv").read_bytes() == (folder / "whole.csv").read_bytes()


@settings(max_examples=8)
@given(st.lists(st.integers(0, 12), min_size=1, max_size=4), st.integers(1, 7))
def test_a_pipe_loses_nothing_that_was_read_and_counts_nothing_twice(tmp_path_factory, kills, every):
    folder = tmp_path_factory.mktemp("pipes")
    session(TEXT, folder / "whole.csv").run()
    pipe = Pipe(TEXT.encode())  # what was read from it comes no second time
    names = folder / "parts.csv", folder / "parts.state", every
    for after in kills:
        with contextlib.suppress(Killed):
            session(Journal(pipe, folder / "lines"), *names).run(killer(after))
    session(Journal(pipe, folder / "lines"), *names).run()
    assert (folder / "parts.csv").read_bytes() == (folder / "whole.csv").read_bytes()
    assert len((folder / "lines").read_bytes()) < 40  # nothing but where it ended


def test_a_kill_between_the_state_and_the_journal_counts_nothing_twice(tmp_path, monkeypatch):
    names = tmp_path / "out.csv", tmp_path / "state", 10
    with monkeypatch.context() as patch:
        session(TEXT, tmp_path / "whole.csv").run()
        begun = session(Journal(Pipe(TEXT.encode()), tmp_path / "lines"), *names)
        patch.setattr(Journal, "saved", lambda *_: None)  # it keeps what the state holds already
        begun.run()
    again = session(Journal(Pipe(b""), tmp_path / "lines"), *names)
    again.run()
    assert again.counted == 41
    assert names[0].read_bytes() == (tmp_path / "whole.csv").read_bytes()


def test_a_journal_without_its_state_is_refused_and_a_bad_header_leaves_none(tmp_path):
    names = tmp_path / "out.csv", tmp_path / "state"
    with pytest.raises(UserError, match="measurements: expected a header with time and q, p; received 'x'"):
        session(Journal(Pipe(b"time,x\n"), tmp_path / "lines"), *names).run()
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "lines").write_text("left by a process that is gone")
    with pytest.raises(UserError, match="expected the state that belongs to the journal"):
        session(Journal(Pipe(b""), tmp_path / "lines"), *names)


def test_lines_that_changed_and_files_of_others_are_refused(tmp_path):
    names = tmp_path / "out.csv", tmp_path / "state"
    session(TEXT, *names).run()
    with pytest.raises(UserError, match="expected a new file"):
        session(TEXT, names[0])
    with pytest.raises(UserError, match="expected the lines already processed, up to line 41"):
        session(TEXT.replace("ruler", "radar", 1), *names).run()
    first = session(TEXT, *names)
    with pytest.raises(UserError, match="no other process writes"):
        session(TEXT, *names)
    first.close()
    names[0].write_text("short")
    with pytest.raises(UserError, match="unchanged"):
        session(TEXT, *names)


def test_a_file_that_grew_is_gone_on_with(tmp_path):
    names = tmp_path / "out.csv", tmp_path / "state"
    session("\n".join(TEXT.splitlines()[:20]) + "\n", *names).run()
    session(TEXT, *names).run()
    session(TEXT, tmp_path / "whole.csv").run()
    assert names[0].read_bytes() == (tmp_path / "whole.csv").read_bytes()


@pytest.mark.parametrize(
    "text", ["", "# nothing\n", "q,p\n1,2\n", "time,q,q\n", "time,x\n1,2\n", "time,q [kg]\n", "0.1,0.2\n"]
)
def test_a_bad_header_leaves_nothing_behind(tmp_path, text):
    with pytest.raises(UserError, match="measurements: "):
        session(text, tmp_path / "out.csv", tmp_path / "state").run()
    assert list(tmp_path.iterdir()) == []


def test_a_filter_that_diverges_names_the_line(tmp_path):
    text = "time,sensor,q\n" + "".join(f"{k},ruler,1e6\n" for k in range(1, 9))
    with pytest.raises(TrainingError, match=r"line 6: .* DIVERGED"):
        session(text, tmp_path / "out.csv").run()


def test_cells_and_objects_say_the_same():
    table, lines = Layout("t;sensor;q [m];sd_q;p", SENSORS), Layout("{", SENSORS)
    expected = Reading(2.0, (math.nan, 3.0), "radar", (0.3, 0.05))
    for reading in (
        table.reading("2;radar;NA;0.3;3"),
        lines.reading('{"time": 2, "sensor": "radar", "q": null, "sd_q": 0.3, "p": 3}'),
    ):
        assert repr(reading) == repr(expected)
    assert table.reading('"2";"ruler";"1";;').deviations is None


def test_numbers_come_in_any_unit_that_fits_the_sensor():
    plain = Layout("t;sensor;q;sd_q;p", SENSORS).reading("2;radar;0.04;0.003;3")
    other = Layout("t;sensor;q [cm];sd_q [mm];p", SENSORS).reading("2;radar;4;3;3")
    assert other.values == pytest.approx(plain.values, rel=1e-15)
    assert other.deviations == pytest.approx(plain.deviations, rel=1e-15)
    with pytest.raises(UserError, match=r"expected q in m, or in a compatible unit; received rad"):
        Layout("t;q [rad]", SENSORS)
    with pytest.raises(UserError, match=r"expected q in m, or in a compatible unit; received ell"):
        Layout("t;sd_q [ell]", SENSORS)


OBJECTS = [
    *("3", "[]", "{", "[" * 9999, '{"time": true, "sensor": "ruler"}', '{"time": 1e999, "sensor": "ruler"}'),
    *('{"sensor": "ruler", "q": 1}', '{"time": 1, "x": 2}', '{"time": 1, "sensor": ["ruler"], "q": 1}'),
    *('{"time": 1, "sensor": "ruler", "q": 1, "sd_q": -1}', '{"time": 1, "sensor": "ruler", "q": "a"}'),
]


@pytest.mark.parametrize("text", OBJECTS)
def test_an_object_that_is_no_measurement_is_a_bad_line(text):
    with pytest.raises(BadLine):
        Layout("{", SENSORS).reading(text)


ORBIT = Space("orbit", ("x", "y", "z", "px", "py", "pz"), Units("s", "km", "km/s", "J"), 2.0)
ABOUT = Reference.of("EME2000, EARTH, UTC, from 2024-03-01T00:00:00")


def test_an_output_becomes_pictures_and_an_ephemeris(tmp_path):
    session(TEXT, tmp_path / "out.csv").run()
    record = read_record(tmp_path / "out.csv", SPACE)
    assert (len(record.time), record.measured) == (40, ("q", "p"))
    assert len(read_record(tmp_path / "out.csv", SPACE, most=10).time) in (10, 11)
    assert {*figures_of(record, SPACE, {})} == {"innovations", "consistency", "deviations"}
    with pytest.raises(UserError, match="expected an orbit"):
        estimated(record, ObjectName("X"), SPACE, ABOUT)
    draw = np.random.default_rng(0)
    factor = draw.normal(size=(40, 6, 6))
    covariance = factor @ factor.transpose(0, 2, 1)
    mean = draw.normal(size=(40, 6)) * 7000
    record = record._replace(mean=mean, covariance=covariance)
    write_oem(tmp_path / "it.oem", estimated(record, ObjectName("X"), ORBIT, ABOUT))
    (read,) = read_oem(tmp_path / "it.oem")
    assert np.allclose(read.states, mean / [1, 1, 1, 2, 2, 2], rtol=1e-14, atol=0)
    assert np.allclose(read.covariances[3].matrix[4, 1], covariance[3, 4, 1] / 2, rtol=1e-14)
    assert np.allclose(read.times, record.time - record.time[0], atol=1e-9)


def test_the_view_is_drawn_in_place_on_a_terminal_and_in_lines_elsewhere(tmp_path):
    shown = {}
    for terminal in (True, False):
        console = Console(file=io.StringIO(), force_terminal=terminal, width=120)
        with View(SPACE, console) as view:
            session(TEXT, tmp_path / f"{terminal}.csv").run(view)
        shown[terminal] = console.file.getvalue()
    assert "3 sigma" in shown[True]
    assert "\x1b[" in shown[True]
    assert "\x1b[" not in shown[False]
    for text in shown.values():
        assert "q [m]" in text
        assert "95 % band" in text
        assert "3 predicted, 37 taken" in text


def test_the_view_averages_accepted_readings():
    view = View(SPACE, Console(file=io.StringIO()))
    view.drawn = math.inf  # nothing is drawn
    for outcome, nis in (("taken", 1.0), ("rejected", 99.0), ("taken", 3.0)):
        estimate = SimpleNamespace(outcome=outcome, innovation=SimpleNamespace(nis=nis, measured=1))
        view(1, None, estimate, Counter())
    assert view.consistency().startswith("mean NIS of the last 2 accepted readings 2, 95 % band")


def test_lines_may_end_with_cr_alone_and_are_gone_on_with(tmp_path):
    clean, mixed = TEXT.splitlines(), TEXT.splitlines()
    mixed.insert(20, "y" * (LONGEST + 10))
    session(TEXT, tmp_path / "clean.csv").run()
    path, state = tmp_path / "mac.csv", tmp_path / "state"
    path.write_bytes("\r".join(mixed[:30]).encode() + b"\r")
    session(path.open("rb"), tmp_path / "mixed.csv", state).run()
    path.write_bytes("\r".join(mixed).encode())
    session(path.open("rb"), tmp_path / "mixed.csv", state).run()
    one, other = ((tmp_path / name).read_text().splitlines() for name in ("clean.csv", "mixed.csv"))
    assert len(one) == len(clean)
    assert [row.partition(",")[2] for row in one] == [row.partition(",")[2] for row in other]
    assert other[-1].partition(",")[0] == str(len(mixed))


def test_a_number_of_another_sensor_is_said_once(tmp_path, caplog):
    lines = ["time,sensor,q,p", "1,ruler,1.0,", *(f"{k},ruler,1.{k},0.3" for k in (2, 3)), "4,radar,1.1,0.3"]
    with caplog.at_level(logging.WARNING, "ahnn"):
        session("\n".join(lines), tmp_path / "out.csv").run()
    assert caplog.messages == [
        "measurements: p is ignored on lines from sensor ruler, which does not measure it"
    ]
