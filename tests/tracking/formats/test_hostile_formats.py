"""A hundred damages of each format: each is read as sensible numbers, or refused by file, line or keyword."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest
from made_formats import FILES

from ahnn.data.files.content import Content
from ahnn.data.files.kinds import TRACKING, kind_of
from ahnn.data.files.reading import FileReading, bytes_of, parsed
from ahnn.errors import UserError
from ahnn.tracking.formats.bulletin_b import read_bulletins
from ahnn.tracking.formats.gathered import BOUNDS
from ahnn.tracking.formats.sinex import read_sinex
from ahnn.tracking.formats.tracking_files import READABLE, read_tracking
from ahnn.tracking.tracking_data import KINDS

COUNT = 100
WORDS = ("UT1", "furlong", "nan", "inf", "-1e999", "1e30", "\x00", "é", "=", "[]", "99999999999999999999", "")


def damaged(text, draw):
    """A text with one to three damages, each of a kind that transfers, editors and bad programs make."""
    for _ in range(draw.choice((1, 1, 2, 3))):
        lines = text.split("\n")
        k = draw.randrange(max(1, len(lines) - 1))
        fields = lines[k].split(" ")
        kind = draw.randrange(10)
        if kind == 0:
            del lines[k]
        elif kind == 1:
            lines.insert(k, lines[k])
        elif kind == 2:
            other = draw.randrange(len(lines))
            lines[k], lines[other] = lines[other], lines[k]
        elif kind == 3 and len(fields) > 1:
            a, b = draw.sample(range(len(fields)), 2)
            fields[a], fields[b] = fields[b], fields[a]
            lines[k] = " ".join(fields)
        elif kind == 4:
            fields[draw.randrange(len(fields))] = draw.choice(WORDS)
            lines[k] = " ".join(fields)
        elif kind == 5 and lines[k]:
            at = draw.randrange(len(lines[k]))
            lines[k] = lines[k][:at] + draw.choice("xO. -9%<") + lines[k][at + 1 :]
        elif kind == 6 and lines[k]:
            at = draw.randrange(len(lines[k]))
            lines[k] = lines[k][:at] + "00000000" + lines[k][at:]
        elif kind == 7:
            lines[k] = lines[k][: draw.randrange(len(lines[k]) + 1)]
        elif kind == 8:
            lines = lines[: k + 1]
        else:
            digits = [j for j, sign in enumerate(lines[k]) if sign.isdigit()]
            if digits:
                at = draw.choice(digits)
                lines[k] = lines[k][:at] + draw.choice("0123456789") + lines[k][at + 1 :]
        text = "\n".join(lines)
    return text


def sensible(path, note):
    """Read a file as its kind, and hold its numbers to what they can be."""
    kind = kind_of(path.read_bytes(), str(path))
    if kind in READABLE:
        for data in read_tracking(path, note=note):
            assert len(data.times) == len(data.values) == len(data.station) == len(data.weather) > 0
            assert np.isfinite(data.times).all()
            assert (np.diff(data.times) >= 0).all()
            assert np.isfinite(data.values).any(1).all()
            for column, name in zip(data.values.T, KINDS, strict=True):
                known = column[np.isfinite(column)]
                low, high = BOUNDS[name]
                assert ((known >= low * 1.1 - 1e-6) & (known <= high * 1.1)).all(), name
            assert not np.isinf(data.weather).any()
            assert all(data.stations)
    elif kind == "sinex":
        found = read_sinex(path)
        for code, solutions in found.solutions.items():
            assert code
            for one in solutions:
                assert 6300 < np.linalg.norm(one.position) < 6450
                assert np.linalg.norm(one.velocity) < 0.02
    elif kind == "bulletin_b":
        found = read_bulletins(path)
        table = np.column_stack((found.x, found.y, found.ut1_utc, found.pole))
        assert (np.abs(table) < 1.1).all()
        assert (np.diff(found.mjd) == 1).all()
    else:
        assert kind not in TRACKING
        reading = FileReading(step=60.0, duration=600.0)
        more = {} if note is None else {"note": note}
        content = parsed(path, *bytes_of(path), reading, **more)
        assert isinstance(content, Content)
        for track in content.tracks:
            assert (np.diff(track.times) > 0).all()
            assert np.isfinite(track.values).all() or kind in ("table", "parquet")


@pytest.mark.parametrize("name", FILES)
def test_a_damaged_file_is_read_sensibly_orraise_faultsd_by_name(name, tmp_path):
    pytest.importorskip("sgp4")
    path = Path(tmp_path / name)
    draw = random.Random(name)
    refused = 0
    for k in range(COUNT):
        path.write_text(damaged(FILES[name], draw))
        try:
            sensible(path, **({"note": raise_faults} if k % 2 else {"note": [].append}))
        except UserError as error:
            refused += 1
            message = str(error)
            assert name in message or "system.step" in message, message
            assert "expected" in message
            assert "received" in message
    assert 5 < refused < COUNT


def raise_faults(said):
    """Raise a fault; a remark is passed over."""
    if isinstance(said, UserError):
        raise said


@pytest.mark.parametrize("name", FILES)
def test_whole_files_are_read_and_pass_the_same_test(name, tmp_path):
    pytest.importorskip("sgp4")
    (tmp_path / name).write_text(FILES[name])
    said = []
    sensible(tmp_path / name, said.append)
    assert not [one for one in said if isinstance(one, UserError)]
