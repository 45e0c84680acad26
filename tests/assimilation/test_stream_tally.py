"""What is said of a stream: a verdict on its mean NIS, and invalid lines, the first of each kind."""

from __future__ import annotations

import logging

import pytest
from following import readings, session, written

from ahnn.assimilation.stream_tally import StreamTally
from ahnn.errors import TrainingError


@pytest.mark.parametrize(
    ("nis", "words"),
    [
        (2.0, ": this one is overconfident, since process noise or measurement noise is too small, or "),
        (1.0, "a consistent filter has 0.914 to 1.09"),
        (0.5, ": this one is too cautious, since process noise or measurement noise is too large"),
    ],
)
def test_the_verdict_names_the_noise_to_change(nis, words):
    tally = StreamTally()
    tally.nis, tally.numbers = 1000 * nis, 1000
    tally.counts["taken"] = 1000
    assert words in tally.verdict()
    assert tally.verdict().count("this one is") == (nis != 1.0)
    tally.numbers = 29
    assert tally.verdict() == ""


def test_bad_lines_of_one_kind_are_counted_after_the_fifth(tmp_path, caplog):
    caplog.set_level(logging.INFO, "ahnn")
    head, *good = written(readings(3)).splitlines()
    bad = [f"{k},rulr,1," for k in range(8)]
    for k, lines in enumerate(([*bad, "x,ruler,1,", *good], bad[:6], bad[:5])):
        caplog.clear()
        one = session("\n".join([head, *lines]), tmp_path / f"{k}.csv")
        if k:
            with pytest.raises(TrainingError, match=r"received \d of \d bad"):
                one.run()
        else:
            one.run()
        kind = "sensor: expected one of ruler, radar"
        each = [f"line {k}: {kind}; received 'rulr'; did you mean 'ruler'?; skipped" for k in range(2, 7)]
        rest = {
            0: [f"3 more lines skipped, up to line 9: {kind}"],
            1: [f"1 more line skipped, up to line 7: {kind}"],
        }
        assert [text for text in caplog.messages if kind in text] == [*each, *rest.get(k, [])]
        assert any(text.startswith("line 10: time") for text in caplog.messages) == (k == 0)
