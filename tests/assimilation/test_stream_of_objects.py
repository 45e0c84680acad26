"""A stream of many objects: rows as of solo streams, kills, bad lines, other formats, and what is refused."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import logging

import numpy as np
import pytest
from fleet import NAMES, SHARED, fleet, mixed
from following import SENSORS, SPACE
from hypothesis import given, settings
from hypothesis import strategies as st

from ahnn.assimilation.catalogue_rows import CatalogueRows
from ahnn.assimilation.catalogue_session import CatalogueSession
from ahnn.assimilation.journal import Journal
from ahnn.assimilation.line_parser import Layout
from ahnn.assimilation.lines import Lines
from ahnn.assimilation.output_rows import Output
from ahnn.assimilation.parquet_stream import ParquetRows
from ahnn.assimilation.table_parser import TableParser
from ahnn.errors import TrainingError, UserError
from ahnn.estimation import Gate
from ahnn.files import write_state

PAIRS = mixed((9, 4, 12, 1, 7, 3, 15))


def written(pairs):
    """Readings as a table with a column of objects."""
    rows = ["time [s],name,sensor,q [m],p"]
    for name, reading in pairs:
        values = ["" if v != v else repr(v) for v in (*reading.values, np.nan)[:2]]
        rows.append(",".join([repr(reading.time), name, reading.sensor, *values]))
    return "\n".join(rows) + "\n"


TEXT = written(PAIRS)


def session(text, output, state=None, every=10, kind="csv", names=NAMES, **options):
    """The session of a text, a pipe, or a Parquet file."""
    stream = io.BytesIO(text.encode()) if isinstance(text, str) else text
    lines = stream if isinstance(stream, ParquetRows) else Lines(stream)
    catalogue = fleet(names, **({"gate": Gate(0.9999)} | options))
    rows = CatalogueRows(SPACE.components, SENSORS, kind)
    return CatalogueSession(catalogue, lines, rows, str(output), state, every, objects="name")


def rows_of(path):
    """The rows of a table."""
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_rows_are_the_estimates_of_the_catalogue(tmp_path):
    session(TEXT, tmp_path / "out.csv").run()
    found, catalogue = rows_of(tmp_path / "out.csv"), fleet(gate=Gate(0.9999))
    layout = Layout(TEXT.splitlines()[0], SENSORS, objects="name")
    parsed = TableParser(layout, catalogue.columns).of_lines([*range(2, 53)], TEXT.splitlines()[1:])
    parts = [parsed.table._replace(objects=parsed.table.objects)]
    estimates = catalogue.update(parts[0])
    assert [row["object"] for row in found] == [name for name, _ in PAIRS]
    assert [row["line"] for row in found] == [str(k) for k in range(2, 53)]
    assert [row["outcome"] for row in found] == estimates.outcomes
    for k, row in enumerate(found):
        assert float(row["q"]) == pytest.approx(float(estimates.means[k, 0]), rel=1e-12)
        assert float(row["cov_p_q"]) == pytest.approx(float(estimates.covariances[k, 1, 0]), rel=1e-12)
    for kind in ("json", "parquet"):
        session(TEXT, tmp_path / kind, kind=kind).run()
    lines = [json.loads(line) for line in (tmp_path / "json").read_text().splitlines()]
    assert [{n: "" if v is None else str(v) for n, v in line.items()} for line in lines] == found
    from pyarrow import parquet

    table = parquet.read_table(tmp_path / "parquet")
    assert [*table.column_names] == [*found[0]]
    numbers = [float(row["q"]) for row in found]
    assert table.column("q").to_pylist() == numbers
    assert len([*(tmp_path / "parquet").glob("*.parquet")]) == 6


class Killed(Exception):
    """The process is gone."""


def end_at(begun, moment):
    """Make a session end at one of its moments: before a state, behind it, or in the middle of rows."""
    left, saved, output = [moment], begun.filter.save, begun._output

    def gone():
        left[0] -= 1
        if left[0] < 0:
            raise Killed

    def save(*given):
        gone()
        saved(*given)
        gone()

    def torn(known):
        made = output(known)
        write = made.write

        def half(content):
            if isinstance(made, Output) and left[0] == 0:
                write(content[: len(content) // 2])
            gone()
            write(content)

        made.write = half
        return made

    begun.filter.save, begun._output = save, torn


@settings(max_examples=12)
@given(
    st.lists(st.integers(0, 6), min_size=1, max_size=4),
    st.sampled_from([5, 13]),
    st.sampled_from([0.0, 3.0]),
    st.sampled_from(["csv", "parquet"]),
)
def test_a_kill_at_any_moment_leaves_the_same_bytes(tmp_path_factory, kills, every, window, kind):
    folder = tmp_path_factory.mktemp("kills")
    options = {"every": every, "window": window, "kind": kind}
    session(TEXT, folder / "whole.csv", folder / "whole.state", **options).run()
    for moment in kills:
        begun = session(TEXT, folder / "parts.csv", folder / "parts.state", **options)
        end_at(begun, moment)
        with contextlib.suppress(Killed):
            begun.run()
    session(TEXT, folder / "parts.csv", folder / "parts.state", **options).run()
    assert content(folder / "parts.csv") == content(folder / "whole.csv")


def content(path):
    """The bytes of a file, or of all files of a folder."""
    if path.is_dir():
        return {one.name: one.read_bytes() for one in path.iterdir() if not one.name.startswith(".")}
    return path.read_bytes()


def test_a_pipe_loses_nothing(tmp_path):
    class Pipe(io.BytesIO):
        """It outlives who reads it."""

        def close(self):
            """Nothing."""

    session(TEXT, tmp_path / "whole.csv").run()
    pipe, names = Pipe(TEXT.encode()), (tmp_path / "parts.csv", tmp_path / "state")
    begun = session(Journal(pipe, tmp_path / "lines"), *names)

    def fail(*_):
        raise Killed

    saved = begun.filter.save
    begun.filter.save = lambda *given: saved(*given) if begun.counted < 20 else fail()
    with contextlib.suppress(Killed):
        begun.run()
    session(Journal(pipe, tmp_path / "lines"), *names).run()
    assert names[0].read_bytes() == (tmp_path / "whole.csv").read_bytes()


def test_parquet_in_gives_the_same_rows_and_is_gone_on_with(tmp_path):
    import pyarrow as pa
    from pyarrow import parquet

    values = [[r.values[0] for _, r in PAIRS], [(*r.values, np.nan)[1] for _, r in PAIRS]]
    columns = {"time": [r.time for _, r in PAIRS], "name": [n for n, _ in PAIRS]}
    columns |= {"sensor": [r.sensor for _, r in PAIRS], "q [m]": values[0], "p": values[1]}
    parquet.write_table(pa.table(columns), tmp_path / "in.parquet", row_group_size=20)
    session(TEXT, tmp_path / "text.csv", every=20).run()
    names = tmp_path / "out.csv", tmp_path / "state"
    begun = session(ParquetRows(str(tmp_path / "in.parquet")), *names, every=20)
    saved, counts = begun.filter.save, []

    def save(*given):
        saved(*given)
        counts.append(1)
        if len(counts) == 3:
            raise Killed

    begun.filter.save = save
    with contextlib.suppress(Killed):
        begun.run()
    session(ParquetRows(str(tmp_path / "in.parquet")), *names, every=20).run()
    one, other = rows_of(tmp_path / "text.csv"), rows_of(names[0])
    assert [row | {"line": ""} for row in one] == [row | {"line": ""} for row in other]
    parquet.write_table(pa.table(columns), tmp_path / "in.parquet", row_group_size=7)
    with pytest.raises(UserError, match="expected the file whose 51 rows were counted before"):
        session(ParquetRows(str(tmp_path / "in.parquet")), *names, every=20)


BAD = {
    "1,body 0,ruler,x,": "q: expected a finite number; received 'x'",
    "1,body 0,ruler,1": "expected 5 cells; received 4",
    "x,body 0,ruler,1,": "time: expected a finite number; received 'x'",
    ",body 0,ruler,1,": "time: expected a number; received none",
    "1,,ruler,1,": "name: expected the name of an object",
    "1,body 0,sonar,1,": "sensor: expected one of ruler, radar; received 'sonar'",
    "1,body 0,ruler,inf,": "q: expected a finite number; received 'inf'",
    "1,body 0,ruler,1_0,": "q: expected a finite number; received '1_0'",
    '1,"body, 0",ruler,1,': "name: expected the name of an object, without commas",
    "1,body 0,ruler,1e300,": "expected numbers that leave a finite, precise estimate; received q 1e+300",
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
    told = [text for text in caplog.messages if "has no start: not counted" in text]
    assert sorted(text.partition(": ")[2] for text in told) == [
        f"object {name} has no start: not counted" for name in NAMES[5:]
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
        "object body 2: expected a filter that follows its measurements; it is DIVERGED" in caplog.messages[0]
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
    "time,sensor,q\n1,ruler,2\n": "measurements: expected a header with time and name, q, p, each once",
    "time,name,sensor,x\n": "measurements: expected a header with time and name, q, p; received 'x'",
    "": "measurements: expected a header or JSON objects; received no line",
}


@pytest.mark.parametrize("text", REFUSED)
def test_a_bad_header_leaves_nothing_behind(tmp_path, text):
    with pytest.raises(UserError, match="measurements: ") as error:
        session(text, tmp_path / "out.csv", tmp_path / "state").run()
    assert REFUSED[text] in str(error.value)
    assert list(tmp_path.iterdir()) == []


def test_states_of_others_and_damaged_ones_are_refused(tmp_path):
    names = tmp_path / "out.csv", tmp_path / "state"
    session(TEXT, *names).run()
    with pytest.raises(UserError, match="expected one of this model, process noise, sensors and window"):
        session(TEXT, *names, window=3.0)
    with pytest.raises(UserError, match=r"start: expected the 7 objects of .* received others"):
        session(TEXT, *names, names=NAMES[:3])
    whole = names[1].read_bytes()
    for cut in (whole[:-40], whole[: len(whole) // 2], b""):
        write_state(names[1], cut)
        with pytest.raises(UserError, match="state: expected a file written by save"):
            session(TEXT, *names)


def test_a_column_that_a_sensor_has_names_no_object():
    with pytest.raises(UserError, match="objects: expected a column beside"):
        Layout("time,q", SENSORS, objects="q")
