"""An angle is an angle in every residual: turned by whole turns, nothing changes."""

from __future__ import annotations

import math

import pytest
import torch

from ahnn.data.recorded_sensor import Recorded
from ahnn.estimation import Gate, initial_belief
from ahnn.measurements import (
    GroundStation,
    Instrument,
    Position,
    Segment,
    Several,
    State,
    continuous,
    nearest,
    periods,
    reading,
    residual,
    wrap,
)
from ahnn.systems import CartPole
from ahnn.types import Space, Trajectories, Units
from ahnn_plugins.ukf import (
    SQUARE_ROOT,
    STANDARD,
    UnscentedKalmanFilter,
    batch_least_squares,
    iterated_smoother,
    members,
    unscented_filter,
    unscented_smoother,
)

F64 = torch.float64
TURN = 2 * math.pi


class Encoder:
    """The angle of the shaft and the double of it, in units of its own; nothing says what a residual is."""

    names = ("angle", "double")

    def __init__(self, units=("rad", "deg")):
        self.units = units

    def __call__(self, x, t):
        scale = torch.tensor([1.0, 2.0], dtype=x.dtype)
        degrees = torch.tensor([math.degrees(1) if unit == "deg" else 1.0 for unit in self.units]).to(x)
        return x[..., :1] * scale * degrees


class Counter(Encoder):
    """It counts turns, so that an angle of 7 rad is none of 7 rad less a turn."""

    periods = (math.inf, math.inf)


def coasting(x, dt):
    return torch.cat((x[:, :1] + dt * x[:, 1:], x[:, 1:]), dim=1)


def test_units_say_what_is_an_angle_and_a_model_may_say_otherwise():
    assert periods(Position(2, "rad")) == (TURN, TURN)
    assert periods(Position(1, "deg")) == periods(Position(1, "°")) == (360.0,)
    assert periods(State(1, ("rad", "rad/s"))) == (TURN, math.inf)
    assert periods(GroundStation(0, 0, range_rate=True)) == (math.inf, TURN, TURN, math.inf)
    assert periods(Several([Position(1, "km"), Encoder(), Counter()])) == (
        *(math.inf, TURN, 360.0),
        *(math.inf, math.inf),
    )
    wrong = Counter()
    for declared in ((1.0,), (0.0, math.inf), (math.inf, -1.0), (math.nan, 1.0)):
        wrong.periods = declared
        with pytest.raises(ValueError, match=r"periods: expected a number > 0, or inf, for each of angle, d"):
            periods(wrong)


@pytest.mark.parametrize("turn", [2 * math.pi, 360.0, 0.1])
def test_an_angle_within_half_a_turn_keeps_its_bits(turn):
    inside = (
        turn * (torch.rand(1000, generator=torch.Generator().manual_seed(0), dtype=F64) - 0.5) * (1 - 1e-15)
    )
    assert torch.equal(wrap(inside, turn), inside)
    assert wrap(torch.tensor([-0.5, 0.5], dtype=F64) * turn, turn).tolist() == [0.5 * turn] * 2


def test_a_residual_is_that_of_the_nearest_turn_and_of_plain_numbers_as_before():
    y = torch.tensor([[3.1, 359.0], [0.2, -1.0]], dtype=F64)
    turned = y + torch.tensor([TURN, -720.0], dtype=F64)
    expected = torch.tensor([[6.2 - TURN, -2.0], [0.4, -2.0]], dtype=F64)
    for seen in (y, turned):
        assert torch.allclose(residual(Encoder(), seen, -y), expected, atol=1e-12)
    assert torch.equal(residual(Counter(), turned, y), turned - y)
    plain = Position(2, "km")
    assert torch.equal(residual(plain, turned, y), turned - y)
    assert nearest(plain, turned, y) is turned
    assert torch.equal(nearest(Encoder(), y, y + 0.5), y)
    assert torch.allclose(nearest(Encoder(), turned, y), y, atol=1e-12)


def test_a_model_with_differences_of_its_own_is_asked_and_then_wrapped():
    class Own(Encoder):
        def residual(self, y, y_pred):
            return 2.0 * (y - y_pred)

    y = torch.tensor([[3.0, 10.0]], dtype=F64)
    assert torch.allclose(residual(Own(), y, -y * 0), torch.tensor([[6.0 - TURN, 20.0]], dtype=F64))


def filters():
    """Rows of a shaft that turns, as an encoder reads them within a turn and as they would go on."""
    draw = torch.Generator().manual_seed(0)
    times = 0.1 * torch.arange(1, 80, dtype=F64)
    through = (3.0 + times)[None, :, None] + 0.01 * torch.randn(1, 79, 1, generator=draw, dtype=F64)
    return torch.remainder(through + math.pi, TURN) - math.pi, through


@pytest.mark.parametrize("form", [SQUARE_ROOT, STANDARD], ids=lambda form: form.name)
@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("model", [Position(1, "rad"), Several([Position(1, "rad")])], ids=["read", "points"])
@pytest.mark.parametrize("gate", [None, Gate()])
@pytest.mark.sampled(3)
def test_filters_and_smoothers_follow_an_angle_through_its_turns(form, compiled, model, gate, monkeypatch):
    if not compiled:
        monkeypatch.setattr(members, "library", lambda: None)
    start, q, r = initial_belief([[3.0, 1.0]], 0.01 * torch.eye(2)), 1e-8 * torch.eye(2), 1e-4 * torch.eye(1)
    given = {"form": form, "gate": gate}
    wound, through = (unscented_filter(coasting, start, y, model, q, r, 0.1, **given) for y in filters())
    assert wound.status.tolist() == [0]
    assert float(wound.nis.max()) < 16.0
    assert torch.allclose(wound.means, through.means, atol=1e-9)
    if gate is None and compiled:
        rows = filters()
        kept = [unscented_filter(coasting, start, y, model, q, r, 0.1, smoothing=True, **given) for y in rows]
        smoothed = [unscented_smoother(one).means for one in kept]
        assert torch.allclose(*smoothed, atol=1e-9)
        again = [
            iterated_smoother(one, coasting, y, model, q, r, 0.1).smoothed.means
            for one, y in zip(kept, rows, strict=True)
        ]
        assert torch.allclose(*again, atol=1e-9)


def test_batches_and_recursion_follow_an_angle_through_its_turns():
    rows = filters()
    start, r, model = (
        initial_belief([[3.0, 1.0]], 0.01 * torch.eye(2)),
        1e-4 * torch.eye(1),
        Position(1, "rad"),
    )
    fits = [batch_least_squares(coasting, start, y, model, r, 0.1) for y in rows]
    assert torch.allclose(fits[0].means, fits[1].means, atol=1e-9)
    assert float(fits[0].cost) < 120.0
    ukf = UnscentedKalmanFilter()
    state = ukf.start(start, 0.0)
    for y in rows[0][0]:
        state, told = ukf.update(ukf.predict(state, coasting, 0.1, 1e-8 * torch.eye(2)), y[None], model, r)
        assert float(told.nis) < 16.0


def test_the_objective_of_a_training_does_not_see_turns():
    states = torch.tensor([[[3.0, 1.0], [3.1, 1.0], [3.2, 1.0]]], dtype=F64)
    for model in (Position(1, "rad"), Several([Position(1, "rad"), Position(1, "rad")])):
        width = len(model.names)
        values = states[..., :1].expand(-1, -1, width) + 0.01
        instrument = Instrument(model, torch.full((width,), 0.1, dtype=F64), 0.1, 1, 1.0)
        times = torch.tensor([[0.0, 0.1, 0.2]], dtype=F64)
        turned = values - TURN * torch.tensor([0.0, 1.0, 3.0], dtype=F64)[None, :, None]
        segments = [Segment(seen, times, instrument) for seen in (values, turned)]
        assert torch.allclose(*(segment.residuals(states) for segment in segments), atol=1e-12)
        assert torch.allclose(segments[1].residuals(states), -torch.full_like(values, 0.1), atol=1e-12)


def test_recorded_angles_go_on_over_turns_and_those_that_come_rarely_stay():
    through = 3.0 + torch.linspace(0, 20, 60, dtype=F64)[None, :, None].repeat(2, 1, 1)
    through[1] *= -1
    wound = torch.remainder(through + math.pi, TURN) - math.pi
    wound[:, 7], through[:, 7] = torch.nan, torch.nan
    found = continuous(wound, (TURN,))
    there = through.isfinite()
    turns = (found - through)[there] / TURN
    assert torch.allclose(turns, turns.round(), atol=1e-12)  # from the first turn on
    assert float((found.diff(dim=1) - through.diff(dim=1)).nan_to_num().abs().max()) < 1e-12
    assert torch.equal(found.isnan(), wound.isnan())
    rare = 2.0 * torch.sin(torch.arange(0, 40, 2.0, dtype=F64))[None, :, None]
    for values, turn in ((rare, TURN), (wound, math.inf)):
        assert torch.equal(continuous(values, (turn,)).nan_to_num(), values.nan_to_num())


def test_a_recorded_sensor_gives_angles_that_go_on():
    space = Space("shaft", ("q", "p"), Units("s", "rad", "rad/s", "J"))
    sensor = Recorded(space, measured="position", noise=0.01)
    q = 3.0 + torch.linspace(0, 8, 50, dtype=F64)
    states = torch.stack((torch.remainder(q + math.pi, TURN) - math.pi, torch.full_like(q, torch.nan)), -1)
    seen = sensor.measure(Trajectories(states[None], torch.linspace(0, 8, 50, dtype=F64)[None]), 0)
    assert torch.allclose(seen.values[0, :, 0], q, atol=1e-12)


def test_an_angle_beside_lengths_is_an_angle_where_it_is_read():
    space = CartPole(name="cart", dt=0.02, steps=1).space
    assert reading("position", space).units == ("m", "rad")
    assert reading("state", space).units == ("m", "rad", "kg m/s", "kg m²/s")
    assert reading("position", space).names == space.components[:2]
    assert reading("state", space).names == space.components
    turned = torch.tensor([1.0, 2.0 * math.pi + 0.1], dtype=torch.float64)
    assert residual(reading("position", space), turned, torch.zeros_like(turned)).tolist() == pytest.approx(
        [1, 0.1]
    )
