"""States at which something begins: from numbers and files, in the order and the units of a model."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from ahnn.data.estimate_table import OF_FILTER
from ahnn.data.files import Covariance, Ephemeris, Files, instant, write_oem
from ahnn.data.files.object_name import numbered
from ahnn.data.reference import Reference
from ahnn.data.starts import Starts, referred, starts
from ahnn.errors import UserError
from ahnn.types import Space, Units

PLANE = Space("plane", ("x", "y", "px", "py"), Units("s", "m", "m/s", "J"), inertia=2.0)
ORBIT = Space(
    "orbit", ("x", "y", "z", "px", "py", "pz"), Units("min", "m", "m/s", "J"), 3.0, "EME2000, EARTH"
)
NOON = instant("2024-03-01T12:00:00", utc=True)
STATES = np.array(
    [[7000.0, 1.0, 2.0, 0.5, 7.0, 0.25], [6990.0, 450.0, 3.0, 0.0, 7.0, 0.5], [6970.0, 9e2, 5, 0, 7, 1]]
)


def test_columns_of_a_file_are_put_in_the_order_and_the_units_of_a_model(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(
        "id,t [min],y [km],x [m],vy [km/s],vx [m/s]\nA,1,2,3,4,5\nA,2,6,7,8,9\nB,3,1,1,1,1\nB,4,2,3,5,8\n"
    )
    found = starts(str(path), PLANE)
    assert found.names == ("A", "B")
    assert found.times.tolist() == [60.0, 180.0]
    assert found.states.tolist() == [[3.0, 2000.0, 10.0, 8000.0], [1.0, 1000.0, 2.0, 2000.0]]
    late = starts(str(path), PLANE, last=True)
    assert late.times.tolist() == [120.0, 240.0]
    expected = torch.tensor([[7.0, 6000.0, 18.0, 16000.0], [3.0, 2000.0, 16.0, 10000.0]]).double()
    assert torch.allclose(late.states, expected, rtol=1e-14, atol=0)
    assert found.covariances is late.covariances is None


def test_velocities_are_no_momenta_of_a_space_that_is_not_mechanical(tmp_path):
    path, space = tmp_path / "a.csv", PLANE._replace(mechanical=False)
    path.write_text("t,x,y,vx,vy\n0,1,2,3,4\n1,1,2,3,4\n")
    with pytest.raises(UserError, match="start"):
        starts(str(path), space)
    path.write_text("t,x,y,px,py\n0,1,2,3,4\n1,1,2,3,4\n")
    assert starts(str(path), space).states.tolist() == [[1.0, 2.0, 3.0, 4.0]]


@pytest.mark.parametrize(
    ("head", "said"),
    [
        ("t,x,z,vx,vz", "expected positions x, y and their velocities or momenta; received x, z. Name the"),
        ("t,x,y", "received x, y only. The output of ahnn.assimilate"),
        (
            "t [s],x [rad],y [rad],vx [rad/s],vy [rad/s]",
            "expected values in m or in a compatible unit; rec",
        ),
    ],
)
def test_columns_that_are_no_states_of_a_model_are_refused(head, said, tmp_path):
    (tmp_path / "a.csv").write_text(
        "\n".join([head, *[",".join([str(k)] * (head.count(",") + 1)) for k in (1, 2)]])
    )
    with pytest.raises(UserError) as error:
        starts(str(tmp_path / "a.csv"), PLANE)
    assert said in str(error.value)


def message(path, times, seen=()):
    write_oem(path, [Ephemeris("A", "A", "EARTH", "EME2000", "UTC", NOON, np.array(times), STATES, seen)])
    return str(path)


@pytest.mark.parametrize(("at", "k"), [(0.0, 0), (60.0, 1), (150.0, 2)])
def test_the_covariance_of_a_message_is_that_of_its_state_in_the_units_of_a_model(tmp_path, at, k):
    matrix = np.diag([1.0, 4.0, 9.0, 1e-6, 4e-6, 9e-6])
    matrix[0, 4] = matrix[4, 0] = 1e-4
    path = message(tmp_path / "a.oem", [0.0, 60.0, 150.0], (Covariance(at, matrix),))
    scale = 1e3 * torch.tensor([1.0, 1.0, 1.0, 3.0, 3.0, 3.0], dtype=torch.float64)
    expected = torch.from_numpy(matrix) * torch.outer(scale, scale)
    states = torch.from_numpy(STATES) * scale
    first, last = starts(path, ORBIT), starts(path, ORBIT, last=True)
    assert torch.allclose(first.states[0], states[0], rtol=1e-14, atol=0)
    assert torch.allclose(last.states[0], states[2], rtol=1e-14, atol=0)
    assert (first.times.tolist(), last.times.tolist()) == ([0.0], [2.5])
    assert first.reference.epoch == last.reference.epoch == NOON
    assert torch.allclose(last.covariances[0], expected, rtol=1e-14, atol=0)
    if k == 0:
        assert torch.allclose(first.covariances[0], expected, rtol=1e-14, atol=0)
    else:
        assert first.covariances is None
    if k == 2:
        assert last.since is None
    else:
        assert last.since[0].tolist() == [at / 60]
        assert torch.allclose(last.since[1][0], states[k], rtol=1e-14, atol=0)
    replaced = starts(path, ORBIT, last=True, sd=[100.0, 0.5])
    assert replaced.since is None
    assert replaced.covariances[0].diagonal().sqrt().tolist() == [100.0] * 3 + [1.5] * 3


def test_the_latest_covariance_up_to_a_state_stands_for_it(tmp_path):
    seen = tuple(Covariance(at, size * np.eye(6)) for at, size in ((0.0, 1.0), (150.0, 3.0), (60.0, 2.0)))
    for given, at, size in ((seen[:2], None, 3.0), (seen[::2], 1.0, 2.0), (seen[:1], 0.0, 1.0)):
        found = starts(message(tmp_path / "a.oem", [0.0, 60.0, 150.0], given), ORBIT, last=True)
        assert found.covariances[0, 0, 0].item() == pytest.approx(1e6 * size, rel=1e-14)
        assert (None if found.since is None else found.since[0].item()) == at


def test_an_epoch_of_a_file_comes_before_that_of_a_model():
    ours = Reference("EME2000", "EARTH", "TAI", NOON)
    state = torch.zeros(1, 2)
    kept = referred(Starts(numbered(1), state, state[:, 0]), ours)
    assert kept.reference == ours
    own = Reference("", "EARTH", "UTC", NOON + 5)
    assert referred(Starts(numbered(1), state, state[:, 0], own), ours).reference == ours._replace(
        epoch=own.on("TAI").epoch
    )


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("mean: [1, 2, 3]\n", r"expected one or more states .x .m., y .m., px .m/s x 2., py .m/s x 2."),
        ("sd: [1, 1]\n", "received no mean"),
        ("mean: [1, 2, 3, 4]\nsd: [1, 1]\ncovariance: [[1]]\n", "received both"),
        ("mean: [1, 2, 3, 4]\nmore: 1\n", "received more"),
        ("[1, 2]\n", "received no keys"),
        (
            "mean: [1, 2, 3, 4]\ncovariance: [[1, 2], [3, 4]]\n",
            "covariance of 4 x 4 numbers; received a different shape",
        ),
        ("mean: [1, 2, 3, 4]\nepoch: noon\n", "received epoch noon"),
        ("mean: [1, 2, 3, .inf]\n", "finite"),
    ],
)
def test_a_file_that_is_no_start_is_refused(text, said, tmp_path):
    (tmp_path / "a.yaml").write_text(text)
    with pytest.raises(UserError, match=said):
        starts(str(tmp_path / "a.yaml"), PLANE)


def test_a_start_in_another_frame_is_refused_where_it_cannot_be_turned(tmp_path):
    (tmp_path / "a.yaml").write_text("mean: [1, 2, 3, 4]\nframe: GCRF\nepoch: 2024-03-01T12:00:00\n")
    path = str(tmp_path / "a.yaml")
    assert starts(path, PLANE, Reference("ICRF")).reference == Reference("GCRF", clock="UTC", epoch=NOON)
    with pytest.raises(UserError, match="expected three coordinates in a unit of length"):
        starts(path, PLANE, Reference("EME2000"))
    (tmp_path / "a.yaml").write_text("mean: [1, 2, 3, 4, 5, 6]\nframe: GCRF\n")
    with pytest.raises(
        UserError, match="expected an epoch, with which states in GCRF are transformed to EME"
    ):
        starts(path, ORBIT, Reference("EME2000"))


@pytest.mark.parametrize("frame", ["GCRF", "TEME", "ITRF2014"])
def test_a_state_is_turned_alike_from_every_file_and_its_covariance_with_it(tmp_path, frame):
    path, ours = tmp_path / "a.oem", Reference.of(ORBIT.frame)
    sd, names = np.array([1.0, 2.0, 3.0, 0.01, 0.02, 0.03]), ("x", "y", "z", "vx", "vy", "vz")
    scale = torch.tensor([1e3] * 3 + [3e3] * 3, dtype=torch.float64)

    def write(states, seen=()):
        about = "A", "A", "EARTH", frame, "UTC", NOON, np.arange(float(len(states)))
        write_oem(path, [Ephemeris(*about, states, seen)])

    (tmp_path / "b.yaml").write_text(
        f"mean: {(STATES[0] * scale.numpy()).tolist()}\nsd: {(sd * scale.numpy()).tolist()}\n"
        f'frame: "{frame}, EARTH, UTC"\nepoch: 2024-03-01T12:00:00\n'
    )
    head = [f"{name} [{'km/s' if 'v' in name else 'km'}]" for name in names]
    cells = ["2024-03-01T12:00:00", *STATES[0].tolist(), *sd.tolist()]
    table = [",".join(["t", *head, *(f"sd_{name}" for name in head)]), ",".join(map(str, cells))]
    (tmp_path / "c.csv").write_text("\n".join([*table, ""]).replace("t,", "t [UTC],", 1))
    (tmp_path / "c.yaml").write_text(f"frame: {frame}, EARTH, UTC\n")
    turned, images = [], []
    for state in np.concatenate((np.zeros((1, 6)), np.eye(6), STATES[:1])):  # linear, so this is its matrix
        write(np.stack((state, state)))
        turned.append(Files("images", str(path), frame="EME2000").read().states[0, 0])
    images = torch.stack(turned[1:7]).T
    expected = images @ torch.from_numpy(np.diag(sd**2)) @ images.T * scale.outer(scale)
    write(STATES[:1], (Covariance(0.0, np.diag(sd**2)),))
    for name in ("a.oem", "b.yaml", "c.csv"):
        found = starts(str(tmp_path / name), ORBIT, ours, last=True)
        assert found.reference == Reference("EME2000", "EARTH", "UTC", NOON)
        assert torch.allclose(found.states[0], turned[7] * scale, rtol=1e-12, atol=0)
        assert torch.allclose(found.covariances[0], expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("mass", [1.0, 3.0])
def test_positions_of_a_message_go_to_those_of_the_model_by_order_and_their_covariances_count(
    mass, tmp_path, caplog
):
    names = ("pos_x", "pos_y", "pos_z", "ppos_x", "ppos_y", "ppos_z")
    space = Space("sat", names, Units("s", "km", "km/s", "J"), mass, "EME2000, EARTH")
    path = message(tmp_path / "a.oem", [0.0, 60.0, 150.0], (Covariance(150.0, np.eye(6)),))
    with caplog.at_level("INFO", "ahnn"):
        found = starts(path, space, Reference.of(space.frame), last=True)
    assert found.states[0].tolist() == [*STATES[2, :3], *(mass * STATES[2, 3:])]
    assert found.covariances[0].diagonal().tolist() == [1.0] * 3 + [mass**2] * 3
    assert "training" not in caplog.text
    assert "not used" not in caplog.text


@pytest.mark.parametrize(("ours", "warned"), [("", True), ("EME2000, EARTH", False)])
def test_a_model_without_a_frame_is_taken_to_be_in_that_of_the_file(tmp_path, caplog, ours, warned):
    starts(message(tmp_path / "a.oem", [0.0, 60.0, 150.0]), ORBIT, Reference.of(ours))
    assert ("the frame is EME2000; the model states no frame" in caplog.text) is warned


def test_an_unknown_frame_is_named_beside_the_known_ones(tmp_path, caplog):
    for frame, warned in (("J3000, EARTH, UTC", True), ("TEME, EARTH, UTC", False)):
        (tmp_path / "start.yaml").write_text(f"mean: [1, 2, 3, 4]\nframe: {frame}\n")
        caplog.clear()
        starts(str(tmp_path / "start.yaml"), PLANE)
        assert ("J3000 is unknown; known frames: GCRF" in caplog.text) is warned


def test_estimates_of_a_filter_in_an_orbit_message_begin_with_the_last_one(tmp_path, caplog):
    times = np.array([0.0, 60.0, 120.0])
    one = Ephemeris("A", "A", "EARTH", "EME2000", "UTC", NOON, times, STATES)
    for k, comments in enumerate(([], [OF_FILTER])):
        for suffix in ("oem", "xml"):
            path = tmp_path / f"{k}.{suffix}"
            write_oem(path, [one], comments=comments)
            with caplog.at_level("INFO", "ahnn"):
                found = starts(str(path), ORBIT)
            row = STATES[2 if comments else 0]
            assert found.states[0, :3].tolist() == pytest.approx((1000 * row[:3]).tolist())
    assert "the last of 3 states" in caplog.text
