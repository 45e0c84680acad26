"""Orbit parameter messages: a state with its covariance where predictions begin."""

from __future__ import annotations

import re

import numpy as np
import pytest
from entry import call
from made_orbits import OPM

from ahnn.data.files import instant, read_oem, read_opm, write_oem
from ahnn.data.files.oem_xml import TRIANGLE
from ahnn.data.files.opm import opm_blocks
from ahnn.errors import UserError

STATE = [6503.514, 1239.647, -717.49, -0.87316, 8.74042, -4.191076]


def xml_of(text):
    """The same message in XML."""
    pairs = re.findall(r"^(\w+) = (.*?)(?: \[(.*)\])?$", text, re.MULTILINE)
    tags = [f"<{k}{f' units={u!r}' if u else ''}>{v}</{k}>" for k, v, u in pairs[3:]]
    meta, state, matrix = tags[:5], tags[5:12], tags[13:35]
    parts = [("stateVector", state), ("spacecraftParameters", tags[12:13]), ("covarianceMatrix", matrix)]
    inner = "".join(f"<{name}>{''.join(part)}</{name}>\n" for name, part in parts)
    burn = f"<maneuverParameters>{''.join(tags[35:])}</maneuverParameters>"
    body = f"<body><segment><metadata>{''.join(meta)}</metadata><data>{inner}{burn}</data></segment></body>"
    return f'<opm id="CCSDS_OPM_VERS" version="2.0"><header/>{body}</opm>'


@pytest.mark.parametrize("text", [OPM, xml_of(OPM)], ids=["kvn", "xml"])
def test_state_and_covariance(tmp_path, text, caplog):
    (tmp_path / "a.txt").write_text(text)
    (found,) = read_opm(tmp_path / "a.txt")
    assert (found.object_id, found.center, found.frame, found.time_system) == (
        *("2024-001A", "EARTH", "EME2000", "UTC"),
    )
    assert found.start == instant("2024-03-01T12:00:00", utc=True)
    assert found.states.tolist() == [STATE]
    (covariance,) = found.covariances
    assert (covariance.time, covariance.frame) == (0.0, "RTN")
    values = dict(re.findall(r"^(C\w+) = (\S+)", OPM, re.MULTILINE))
    lower = [float(values[key]) for key in TRIANGLE]
    assert covariance.matrix[np.tril_indices(6)].tolist() == lower
    assert np.array_equal(covariance.matrix, covariance.matrix.T)
    said = [record.getMessage() for record in caplog.records]
    assert any("manoeuvres not used: MAN_EPOCH_IGNITION, MAN_DURATION" in one for one in said)


def test_a_prediction_from_it_is_that_from_an_ephemeris(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.opm").write_text(OPM)
    write_oem("a.oem", read_opm("a.opm"))
    for name in ("opm", "oem"):
        arguments = [f"start=a.{name}", "duration=2min", "step=1min", f"output={name}.oem"]
        assert call("ahnn.predict", "pretrained=molniya_mechanical", *arguments) == 0
    (one,), (other,) = read_oem("opm.oem"), read_oem("oem.oem")
    assert np.array_equal(one.states, other.states)
    assert one.start == instant("2024-03-01T12:00:00", utc=True)
    assert len(one.covariances) == len(other.covariances) > 0
    assert np.array_equal(one.covariances[-1].matrix, other.covariances[-1].matrix)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "CCSDS_OPM_VERS = 2.0",
            "CCSDS_OPM_VERS = 5.0",
            "row 1: expected an orbit parameter message (OPM), version 1.0, 2.0 or 3.0",
        ),
        ("6503.514000 [km]", "6503514.0 [m]", "row 11, column X: expected units km; received 'm'"),
        ("6503.514000", "65o3.514", "column X: expected a number; received '65o3.514'"),
        ("Y = 1239.647000 [km]\n", "", "column Y: expected a value in an orbit parameter message (OPM)"),
        ("Y = 1239.647000", "X = 1239.647000", "row 12, column X: expected each keyword once"),
        ("REF_FRAME = EME2000\n", "", "column REF_FRAME: expected a value"),
        ("T12:00:00.000", "T25:00:00.000", "column EPOCH: expected a time of day"),
        ("CZ_DOT_Z = 3.5e-08\n", "", "column CZ_DOT_Z: expected a value"),
        ("MASS = 3000.0 [kg]", "MASS: 3000.0 [kg]", "expected KEYWORD = value in an orbit parameter message"),
    ],
)
def test_what_is_wrong_is_refused_by_its_line(old, new, said, tmp_path):
    assert old in OPM
    (tmp_path / "a.opm").write_text(OPM.replace(old, new, 1))
    with pytest.raises(UserError) as caught:
        read_opm(tmp_path / "a.opm")
    assert str(caught.value).startswith(str(tmp_path / "a.opm"))
    assert said in str(caught.value)


def test_unknown_keywords_are_said_and_other_messages_refused(tmp_path):
    notes = []
    opm_blocks(OPM.replace("MASS =", "MAS ="), "a.opm", notes.append)
    assert any("MAS; did you mean 'MASS'?" in one.what for one in notes)
    (tmp_path / "a.oem").write_text(OPM)
    with pytest.raises(
        UserError, match=r"expected an orbit ephemeris message \(OEM\); received an orbit para"
    ):
        read_oem(tmp_path / "a.oem")
    (tmp_path / "a.csv").write_text("t,x\n0,1\n")
    with pytest.raises(UserError, match=r"expected an orbit parameter message \(OPM\); received a table"):
        read_opm(tmp_path / "a.csv")
