"""What a stream left behind and somebody changed: refused, and no byte of the output is touched."""

from __future__ import annotations

import io
import json
import re

import numpy as np
import pytest
from following import readings, session, written

from ahnn.assimilation.journal import Journal
from ahnn.errors import UserError
from ahnn.estimation import load_notes, load_state, save_state

TEXT = written(readings(12))


class Pipe(io.BytesIO):
    """It outlives who reads it."""

    def close(self):
        """Nothing."""


@pytest.fixture
def names(tmp_path):
    """Output and state of a stream that ended."""
    names = tmp_path / "out.csv", tmp_path / "state"
    session(TEXT, *names).run()
    return names


def changed(state, **keys):
    """Write other notes of the stream, under a checksum that is right."""
    notes = load_notes(state)
    stream = json.dumps({**json.loads(notes["stream"]), **keys})
    save_state(load_state(state), state, {**notes, "stream": stream})


def refused(names, message, **options):
    """A session is refused and leaves the output as it is."""
    before = names[0].read_bytes() if names[0].exists() else None
    with pytest.raises(UserError, match=message):
        session(TEXT, *names, **options)
    assert (names[0].read_bytes() if names[0].exists() else None) == before


def test_flipped_bits_of_the_state_are_refused(names):
    good, draw = names[1].read_bytes(), np.random.default_rng(1)
    for place in draw.choice(8 * len(good), 40, replace=False):
        content = bytearray(good)
        content[place // 8] ^= 1 << place % 8
        names[1].write_bytes(content)
        refused(names, "state: expected a file written by save")


@pytest.mark.parametrize(
    "keys",
    [
        *({"size": -1}, {"size": 1.5}, {"lines": -1}, {"place": "3"}, {"nis": -1.0}, {"nis": None}),
        *({"counts": []}, {"counts": {"taken": "x"}}, {"header": 3}, {"digest": 0}, {"more": 1}),
    ],
    ids=str,
)
def test_notes_beyond_their_limits_are_refused(names, keys):
    changed(names[1], **keys)
    refused(names, "state: expected the state of a stream")


def test_a_size_of_zero_or_any_other_never_cuts_rows_that_the_state_counts(names):
    whole = len(names[0].read_bytes())
    for size in (0, 1, whole - 1, whole - 60):
        changed(names[1], size=size)
        refused(names, "output: expected .* unchanged bytes, .* a changed file. Start over")


@pytest.mark.parametrize("kind", ["csv", "json"])
def test_what_somebody_added_or_changed_is_not_cut_off(tmp_path, kind):
    names = tmp_path / "out", tmp_path / "state"
    session(TEXT, *names, kind=kind).run()
    good = names[0].read_bytes()
    for content in (good + b"my remark\n", good + b"13,", good.replace(b"9", b"8", 1) + b"", good[::-1]):
        names[0].write_bytes(content)
        if content.endswith(b"13,") and kind == "csv":  # a row of line 13 that a kill cut
            continue
        refused(names, "output: .* a changed file", kind=kind)
    names[0].write_bytes(good)
    session(TEXT, *names, kind=kind).run()
    assert names[0].read_bytes() == good


def test_a_file_in_the_place_of_an_output_that_had_not_begun_stays(tmp_path):
    names = tmp_path / "out.csv", tmp_path / "state"
    begun = session(TEXT, *names)
    begun._save()
    begun.close()
    names[0].write_text("a,table\n1,2\n")
    refused(names, "output: .* a changed file")


def test_an_output_that_is_gone_is_not_begun_in_the_middle(names):
    names[0].unlink()
    refused(names, "output: expected .* unchanged; received no file")


def test_rows_of_another_kind_do_not_follow(names):
    refused(names, "format: expected the value stored in .*; received a different", kind="json")


def test_an_empty_reading_leaves_the_consistency_known(tmp_path):
    names = tmp_path / "out.csv", tmp_path / "state"
    session(TEXT + "99,ruler,,\n", *names).run()
    again = session(TEXT + "99,ruler,,\n", *names)
    assert again.nis > 0.0
    again.close()


def test_a_damaged_journal_is_refused(tmp_path):
    names, path = (tmp_path / "out.csv", tmp_path / "state"), tmp_path / "lines"
    pipe = Pipe(TEXT.encode())

    def killed(*_):
        raise InterruptedError

    with pytest.raises(InterruptedError):
        session(Journal(pipe, path), *names, every=1000).run(killed)
    good, draw = path.read_bytes(), np.random.default_rng(2)
    assert re.match(rb"\d+ \d+\n\d+", good)
    for place in draw.choice(8 * len(good), 60, replace=False):
        content = bytearray(good)
        content[place // 8] ^= 1 << place % 8
        path.write_bytes(content)
        with pytest.raises(UserError, match="state: expected an intact journal"):
            session(Journal(pipe, path), *names)
