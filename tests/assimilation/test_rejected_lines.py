"""Rejected lines of a stream are reported one by one until they follow each other."""

from __future__ import annotations

import logging

from following import session, written

from ahnn.assimilation import Reading
from ahnn.estimation import Gate


def test_consecutive_rejections_are_reported_five_times_and_single_ones_always(tmp_path, caplog):
    bad = {*range(10, 22), 30, 33, 36}
    lines = [Reading(0.5 * k, (1e3 if k in bad else 1.2 + 0.125 * k,), "ruler") for k in range(1, 45)]
    caplog.set_level(logging.INFO, "ahnn")
    stream = session(written(lines), tmp_path / "out.csv", gate=Gate(0.9999, patience=100))
    stream.run()
    assert stream.counts["rejected"] == len(bad)
    told = [text for text in caplog.messages if "rejected" in text]
    assert [int(text.split(":")[0].split()[1]) - 1 for text in told] == [10, 11, 12, 13, 14, 30, 33, 36]
    assert [text.endswith("further consecutive ones are counted") for text in told].index(True) == 4
