"""What the demonstrations learn from: planets of DE421 and satellites of SGP4, against others' numbers."""

from __future__ import annotations

import sys
from importlib.resources import files

import numpy as np
import pytest
import torch
from helpers import close
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from ahnn.errors import UserError
from ahnn_plugins.demonstrations import Planets, Satellites
from ahnn_plugins.demonstrations.satellites import element_sets
from ahnn_plugins.demonstrations.segmented_series import segmented
from ahnn_plugins.demonstrations.two_body import kepler

INNER = ["mercury", "venus", "earthmoon", "mars"]
MOLNIYA = [8195, 9880, 21897, 22674]


def planets(**changes) -> Planets:
    pytest.importorskip("de421", reason="the extra `ephemeris` is needed")
    options = {"planets": INNER, "begin": 2451545.0, "step": 2.0, "samples": 50, "segments": 3}
    return Planets(name="planets", **(options | changes))


def satellites(**changes) -> Satellites:
    pytest.importorskip("sgp4", reason="the extra `orbit` is needed")
    options = {"satellites": MOLNIYA, "step": 7200.0, "samples": 12, "segments": 2}
    return Satellites(name="satellites", **(options | changes))


def test_segments_stand_in_the_order_of_time():
    """The value of a sample is body + time / 100, so that each shows where it comes from."""
    times = np.arange(6.0)
    states = np.arange(2.0)[:, None, None] + times[None, :, None] / 100
    cut = segmented(states, times, 3)
    assert cut.times.tolist() == [[0, 1, 2], [0, 1, 2], [3, 4, 5], [3, 4, 5]]
    assert cut.states[:, 0, 0].tolist() == [0.0, 1.0, 0.03, 1.03]


def test_planets_are_where_another_theory_has_them():
    """Simon et al. (1994), as ERFA has it: within 6 arcseconds of Mercury, Venus, Earth; 40 of Mars."""
    erfa = pytest.importorskip("erfa", reason="the oracle")
    read = planets().read()
    for k, number in enumerate((1, 2, 3, 4)):
        for row in (k, k + 8):
            expected = erfa.plan94(2451545.0, read.times[row].numpy(), number)
            close(read.states[row, :, :3], torch.from_numpy(expected["p"].copy()), 3e-4)
            close(read.states[row, :, 3:], torch.from_numpy(expected["v"].copy()), 3e-4)


def test_satellites_are_where_the_published_verification_has_them():
    read = satellites(samples=25, segments=1).read()
    text = files("sgp4").joinpath("tcppver.out").read_text()
    for k, number in enumerate(MOLNIYA):
        lines = text.split(f"{number} xx\n")[1].splitlines()[:25]
        published = torch.tensor([[float(word) for word in line.split()[:7]] for line in lines]).double()
        close(read.times[k] - read.times[k, 0], 60 * published[:, 0], 1e-9)
        line = element_sets()[number][0]
        assert float(read.times[k, 0]) == pytest.approx(86400 * (float(line[20:32]) - 176), abs=1e-4)
        close(read.states[k, :, :3], published[:, 1:4], 1e-7)
        close(read.states[k, :, 3:], published[:, 4:], 1e-3)


def test_reported_velocities_are_not_the_derivatives_of_the_positions_by_up_to_two_metres_per_second():
    read = satellites(step=60.0, samples=1440, segments=1).read()
    api = pytest.importorskip("sgp4.api")
    minutes = np.arange(1440.0)
    for k, number in enumerate(MOLNIYA):
        one = api.Satrec.twoline2rv(*element_sets()[number])
        found = one.sgp4_array(np.full(1440, one.jdsatepoch), one.jdsatepochF + minutes / 1440)[2]
        assert 1.0 < 1000 * float((read.states[k, :, 3:] - torch.from_numpy(found)).abs().max()) < 2.5


def test_the_velocities_of_satellites_are_derivatives_of_their_positions():
    """Simpson's rule over ten steps of 2 s against the positions at both ends."""
    read = satellites(step=2.0, samples=11, segments=1).read()
    weights = torch.tensor([1, 4, 2, 4, 2, 4, 2, 4, 2, 4, 1]).double() * 2.0 / 3
    moved = torch.einsum("t,btd->bd", weights, read.states[..., 3:])
    close(moved, read.states[:, -1, :3] - read.states[:, 0, :3], 1e-9)


@pytest.mark.parametrize(
    ("source", "changes", "message"),
    [
        (planets, {"planets": ["pluto", "ceres"]}, "planets: expected one or more of .*received .*ceres"),
        (planets, {"planets": []}, "received none"),
        (planets, {"begin": 2414000.0}, "expected Julian dates from 2414992.5 to"),
        (planets, {"segments": 10_000}, "expected Julian dates"),
        (satellites, {"satellites": [8195, 1]}, r"satellites: expected one or more of .*received \[1\]"),
        (satellites, {"satellites": []}, "received none"),
    ],
)
def test_what_there_is_not_is_refused(source, changes, message):
    with pytest.raises(UserError, match=message):
        source(**changes)


def test_an_orbit_that_ends_is_refused_when_it_is_read():
    with pytest.raises(UserError, match="satellite 22312; received day"):
        satellites(satellites=[22312], samples=30).read()


def test_a_missing_library_is_one_message_that_names_the_extra(monkeypatch):
    for name in ("sgp4", "sgp4.api"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(UserError, match=r"package sgp4; .*pip install 'ahnn\[orbit\]'"):
        satellites()


def test_recipes_tell_what_determines_the_trajectories():
    assert planets().recipe() != planets(step=3.0).recipe()
    assert satellites().recipe() == satellites().recipe() != satellites(satellites=[8195]).recipe()
    assert satellites().steps() == 11


@given(
    e=st.floats(0, 0.85),
    inclination=st.floats(0, 3.1),
    phase=st.floats(0, 6.28),
    t=st.floats(-10, 10),
    mu=st.floats(0.2, 5),
)
def test_two_body_motion_is_that_of_its_differential_equation(e, inclination, phase, t, mu):
    p = torch.tensor([1 - e, 0, 0, 0, np.cos(inclination), np.sin(inclination)], dtype=torch.float64)
    p[3:] *= (mu * (1 + e) / (1 - e)) ** 0.5
    start = kepler(p, torch.tensor(phase, dtype=torch.float64), mu)

    def field(_, x):
        return np.concatenate((x[3:], -mu * x[:3] / np.linalg.norm(x[:3]) ** 3))

    expected = solve_ivp(field, (0, t), start.numpy(), method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    close(kepler(start, torch.tensor(t, dtype=torch.float64), mu), torch.from_numpy(expected), 1e-8)


def test_two_body_motion_comes_back_after_a_period_and_takes_a_mu_for_each():
    start = torch.tensor([[1.0, 0, 0, 0, 1.1, 0.2]], dtype=torch.float64).expand(3, 6)
    mu = torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64)
    a = 1 / (2 - 1.25 / mu)
    close(kepler(start, 2 * torch.pi * (a**3 / mu).sqrt(), mu), start, 1e-12)
