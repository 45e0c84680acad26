"""What is said of tracking data before an orbit is determined: passes, gaps, outliers; and the command."""

from __future__ import annotations

import numpy as np
import pytest
from entry import call
from made_formats import BULLETIN, CRD, REAL, SINEX, TABLE, kvn

from ahnn.jobs.tracking_figures import picture
from ahnn.tracking.formats.gathered import TrackingReading, gathered
from ahnn.tracking.formats.tracking_files import read_tracking
from ahnn.tracking.survey import survey

NOISE = 1e-3  # km


def passes(seed=0, gap=6000.0):
    """Two passes of ranges of 40 and 30 a minute apart, their noise 1 m, over a parabola."""
    rng = np.random.default_rng(seed)
    times = np.concatenate((60.0 * np.arange(40), 60.0 * 39 + gap + 60.0 * np.arange(30)))
    values = 1000 + 1e-4 * (times - 2000) ** 2 / 100 + NOISE * rng.standard_normal(70)
    return times, values


def data(times, values, kind="range"):
    return gathered(
        "A",
        [
            TrackingReading(round(1e12 * t), "S", {kind: v}, k)
            for k, (t, v) in enumerate(zip(times, values, strict=True))
        ],
        "receive",
    )


def test_passes_and_gaps():
    (found,) = survey(data(*passes()))
    assert (found.station, found.kind, len(found.times), found.passes, found.gap) == (
        "S",
        "range",
        70,
        2,
        6000.0,
    )
    assert found.outliers.tolist() == found.impossible.tolist() == []
    (whole,) = survey(data(*passes(gap=300.0)))
    assert whole.passes == 1


@pytest.mark.parametrize("seed", range(4))
def test_far_measurements_stand_out_and_no_others(seed):
    times, values = passes(seed)
    marks = [7, 20, 55]
    values[marks] += 0.1 * np.array([1, -1, 1])
    (found,) = survey(data(times, values))
    assert found.outliers.tolist() == marks
    assert found.impossible.tolist() == []


def test_angles_are_unwrapped_and_impossible_ranges_are_told():
    times, values = passes()
    (found,) = survey(data(times, np.mod(1e-3 * (values - 1000) + 6.2, 2 * np.pi), "azimuth"))
    assert found.outliers.tolist() == []
    values[30:] += 5000
    (found,) = survey(data(times[:40], values[:40]))
    assert found.impossible.tolist() == [30]


def test_a_noisy_pass_and_a_short_one_have_no_outliers():
    times, values = passes()
    rng = np.random.default_rng(0)
    wild = values + np.where(rng.random(70) < 0.4, 5.0, 0.0)
    (found,) = survey(data(times, wild))
    assert len(found.outliers) < 14
    (few,) = survey(data(times[:6], wild[:6]))
    assert few.outliers.tolist() == []
    (twice,) = survey(data([*times[:9], times[8]], values[:10]))
    assert twice.passes == 1


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        (
            "a.npt",
            CRD,
            ["7 measurements of satellite lageos2, with times of transmission in UTC", "7825", "15.3 min"],
        ),
        ("b.aer", TABLE, ["an unnamed satellite", "right ascension", "no sidecar"]),
        (
            "c.txt",
            kvn(),
            ["4 measurements of satellite 2024-001A, with times of", "range rate", "RECEIVE_FREQ_1"],
        ),
        (
            "d.snx",
            SINEX,
            [
                "d.snx: station positions: 1, eccentricities: 1",
                "RBIAS of",
                "(SINEX): 0 faults",
            ],
        ),
        ("e.txt", BULLETIN, ["for 4 days, MJD 55471 to 55474", "final until 55472", "after the first"]),
    ],
)
def test_the_command_says_what_is_in_a_file(tmp_path, capsys, name, text, said):
    (tmp_path / name).write_text(text)
    assert call("ahnn.data.__main__", "check", str(tmp_path / name)) == 0
    out = " ".join(capsys.readouterr().out.split())
    for one in said:
        assert one in out


def test_the_command_lists_faults_and_ends_with_2(tmp_path, capsys):
    (tmp_path / "a.aer").write_text(TABLE.replace("43.4099", "143.4099").replace("38014.9488", "x"))
    (tmp_path / "b.csv").write_text("t [s],x [m]\n0,1\n1,y\n2,3\n")
    assert call("ahnn.data.__main__", "check", str(tmp_path / "a.aer")) == 2
    out, err = capsys.readouterr()
    assert out.count("fault") == 3
    assert "received 2 faults that would spoil an orbit determination" in err
    assert call("ahnn.data.__main__", "check", str(tmp_path / "a.aer"), str(tmp_path / "b.csv")) == 2
    out, err = capsys.readouterr()
    assert "faults that would spoil the training" in err
    assert "b.csv" in out


def test_outliers_have_the_row_of_the_file_and_the_whole_name_of_their_kind(tmp_path, capsys):
    times, values = passes()
    values[20] += 0.1
    rows = [
        f"2026-03-01T{int(t) // 3600:02d}:{int(t) // 60 % 60:02d}:00,S,{v / 100 - 5},45"
        for t, v in zip(times, values, strict=True)
    ]
    (tmp_path / "a.csv").write_text("\n".join(["time,station,elevation_deg,azimuth_deg", *rows[::-1]]))
    folder = tmp_path / "pictures"
    assert call("ahnn.data.__main__", "check", str(tmp_path / "a.csv"), f"figures={folder}") == 0
    assert "warning a.csv            51 elevation S at" in capsys.readouterr().out
    assert {one.name for one in folder.iterdir()} >= {"a.csv.png", "a.csv.svg"}
    (found,) = read_tracking(tmp_path / "a.csv")
    figure = picture(found, survey(found), "a.csv")
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels == ["azimuth [deg]", "elevation [deg]"]
    dots, ring = figure.axes[1].lines
    np.testing.assert_allclose(np.sort(np.asarray(dots.get_ydata())), np.sort(values / 100 - 5), rtol=1e-12)
    assert ring.get_ydata() == pytest.approx([values[20] / 100 - 5], rel=1e-12)
    (folder / "a.csv.svg").write_text("mine")
    assert call("ahnn.data.__main__", "check", str(tmp_path / "a.csv"), f"figures={folder}") == 2
    assert (folder / "a.csv.svg").read_text() == "mine"


def test_training_on_tracking_data_is_refused_by_name(tmp_path, capsys):
    (tmp_path / "a.npt").write_text(CRD)
    assert (
        call("ahnn.train", "system=files", f"system.path={tmp_path / 'a.npt'}", f"run={tmp_path / 'r'}") == 2
    )
    err = capsys.readouterr().err
    assert "received laser ranging data (CRD). It contains no trajectories: system=sightings" in err


@pytest.mark.skipif(not REAL.is_dir(), reason="no real files beside the checkout")
def test_real_data_have_few_outliers(capsys):
    paths = [str(REAL / "w3b" / "W3B.aer"), str(REAL / "lageos2" / "lageos2_20160214.npt")]
    assert call("ahnn.data.__main__", "check", *paths) == 0
    out = capsys.readouterr().out
    assert "W3B.aer: 521 measurements" in out
    assert out.count("far from") <= 1


def test_a_fast_motion_with_few_samples_is_no_outlier():
    times = 60.0 * np.arange(14)
    values = np.arctan2(7.5 * (times - 390), 400.0)  # an azimuth as a satellite passes near the zenith
    for seed in range(8):
        noise = np.radians(0.01) * np.random.default_rng(seed).standard_normal(14)
        (found,) = survey(data(times, np.mod(values + noise, 2 * np.pi), "azimuth"))
        assert found.outliers.tolist() == []


def test_azimuths_near_the_zenith_are_no_outliers_and_one_of_the_other_side_is():
    """A pass whose azimuth turns by 118 degrees within a minute at an elevation of 80 degrees."""
    times = 60.0 * np.arange(16)
    east, north, up = 7.0 * (times - 440), 0.15 * (times - 200) + 80, 700 - 2e-4 * (times - 440) ** 2
    azimuth, elevation = np.arctan2(east, north), np.arctan2(up, np.hypot(east, north))
    assert np.diff(azimuth).max() > np.radians(115)
    for seed in range(4):
        noise = np.radians(0.01) * np.random.default_rng(seed).standard_normal((2, 16))
        pairs = np.stack((azimuth, elevation)) + noise
        pairs[0, 3] += np.pi * (seed > 1)
        readings = [
            TrackingReading(round(1e12 * t), "S", {"azimuth": a % (2 * np.pi), "elevation": e}, k)
            for k, (t, a, e) in enumerate(zip(times, *pairs, strict=True))
        ]
        found = {one.kind: one.outliers.tolist() for one in survey(gathered("A", readings, "receive"))}
        assert found == {"azimuth": [3] if seed > 1 else [], "elevation": []}
