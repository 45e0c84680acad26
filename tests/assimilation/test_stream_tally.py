"""The verdict on a stream says in words what a mean NIS above or below its band means."""

from __future__ import annotations

import pytest

from ahnn.assimilation.stream_tally import StreamTally


@pytest.mark.parametrize(
    ("nis", "words"),
    [
        (2.0, ": this one is overconfident, since process noise or measurement noise is set too small, or "),
        (1.0, "a consistent filter has 0.914 to 1.09"),
        (0.5, ": this one is too cautious, since process noise or measurement noise is set too large"),
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
