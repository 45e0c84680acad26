"""Lines that arrive together or one by one: the same rows, the same messages, and nothing waits."""

from __future__ import annotations

import io
import logging

import pytest
from following import readings, session, written
from hypothesis import given, settings
from hypothesis import strategies as st

from ahnn.assimilation import session as module
from ahnn.assimilation.lines import LONGEST, Lines
from ahnn.errors import TrainingError

FOUND = readings(60, 4)
ODD = [
    "foo",
    "# a remark",
    "",
    "time [s],sensor,q [m],p",
    "3,ruler,1_0,",
    '9,"ruler",1e4,',
    ",ruler,1,",
    "7,sonar,1,",
]


def mixed():
    """A table with odd lines, outliers, and readings that change places."""
    lines = written(FOUND).splitlines()
    for k in range(9, len(lines), 10):
        lines[k - 1], lines[k] = lines[k], lines[k - 1]
    for k, line in enumerate(ODD):
        lines.insert(6 * k + 4, line)
    return "\n".join(lines) + "\n"


class Pieces(io.RawIOBase):
    """A pipe that brings a text in pieces."""

    def __init__(self, content, lengths):
        self.content, self.lengths, self.asked = content, [*lengths], []
        self.before = lambda: None

    def readable(self):
        return True

    def readinto(self, buffer):
        self.before()
        length = min(self.lengths.pop(0) if self.lengths else len(self.content), len(buffer))
        piece, self.content = self.content[:length], self.content[length:]
        buffer[: len(piece)] = piece
        return len(piece)


def outcome(text, folder, caplog, together, **options):
    """Bytes of the output, and messages."""
    caplog.clear()
    with pytest.MonkeyPatch.context() as patch, caplog.at_level(logging.INFO, "ahnn"):
        patch.setattr(module, "TOGETHER", together)
        session(text, folder / f"{together}.csv", folder / f"{together}.state", every=17, **options).run()
    return (folder / f"{together}.csv").read_bytes(), [*caplog.messages]


@pytest.mark.parametrize("window", [0.0, 3.0])
@pytest.mark.parametrize("kind", ["csv", "json"])
def test_blocks_of_any_size_give_the_same_rows_and_messages(tmp_path, caplog, window, kind):
    whole, *others = [outcome(mixed(), tmp_path, caplog, n, window=window, kind=kind) for n in (512, 1, 3)]
    assert len(whole[0]) > 2000
    assert len(whole[1]) >= 5
    assert all(other == whole for other in others)


@settings(max_examples=10)
@given(st.lists(st.integers(1, 300), max_size=12))
def test_pieces_of_any_length_give_the_same_rows(tmp_path_factory, lengths):
    folder, text = tmp_path_factory.mktemp("pieces"), mixed()
    session(text, folder / "whole.csv", window=3.0).run()
    pipe = io.BufferedReader(Pieces(text.encode(), lengths))
    session(pipe, folder / "parts.csv", window=3.0).run()
    assert (folder / "parts.csv").read_bytes() == (folder / "whole.csv").read_bytes()


def test_the_row_of_a_line_is_written_before_the_next_line_is_waited_for(tmp_path):
    lines, seen = written(FOUND).encode().splitlines(keepends=True), []
    pipe = Pieces(b"".join(lines), map(len, lines))
    out = tmp_path / "out.csv"
    pipe.before = lambda: seen.append(out.read_bytes().count(b"\n") if out.exists() else 0)
    session(io.BufferedReader(pipe), out).run()
    assert seen[: len(lines) + 1] == [0, *range(1, len(lines) + 1)]


def test_the_rows_before_a_line_that_ends_the_filter_are_written(tmp_path):
    text = "time,sensor,q\n" + "".join(f"{k},ruler,{1.2 if k < 9 else 1e6}\n" for k in range(1, 20))
    with pytest.raises(TrainingError, match=r"line 14: .* DIVERGED"):
        session(text, tmp_path / "out.csv").run()
    rows = (tmp_path / "out.csv").read_text().splitlines()
    assert [row.split(",")[0] for row in rows[1:]] == [str(k) for k in range(2, 14)]


@settings(max_examples=15)
@given(
    st.lists(st.integers(1, 40_000), max_size=8), st.integers(1, 5), st.sampled_from([b"\n", b"\r\n", b"\r"])
)
def test_lines_are_those_of_the_whole_text_however_they_arrive(lengths, most, end):
    long = b"y" * (LONGEST + 70_000)
    content = end.join([b"\xef\xbb\xbftime,q", b" 1,2 ", b"", long, b"3,\xff", b"x" * 9000, b"4,5"])
    pieces = [
        len(content) - 1 if end == b"\r" else 30,
        *lengths,
    ]  # what ends lines is told by the first piece
    lines = Lines(io.BufferedReader(Pieces(content, pieces)))
    found = []
    while texts := lines.arrived(most):
        assert len(texts) <= most
        found += texts
    assert found == ["time,q", "1,2", "", "y" * LONGEST, "3,�", "x" * 9000, "4,5"]
    assert (lines.number, lines.place) == (7, len(content))
    again = Lines(io.BytesIO(content))
    again.resume(7, len(content), lines.digest)
