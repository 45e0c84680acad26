"""A stream of many objects: rows as those of a catalogue, kills at any moment, pipes, and Parquet."""

from __future__ import annotations

import contextlib
import io
import json

import numpy as np
import pytest
from fleet import PAIRS, TEXT, fleet, rows_of, session
from following import SENSORS
from hypothesis import given, settings
from hypothesis import strategies as st

from ahnn.assimilation.journal import Journal
from ahnn.assimilation.line_parser import Layout
from ahnn.assimilation.output_rows import Output
from ahnn.assimilation.parquet_stream import ParquetRows
from ahnn.assimilation.table_parser import TableParser
from ahnn.errors import UserError
from ahnn.estimation import Gate


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
    with pytest.raises(UserError, match="expected the file whose 51 rows were processed before"):
        session(ParquetRows(str(tmp_path / "in.parquet")), *names, every=20)
