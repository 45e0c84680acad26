"""The filter that steps: equal to the batch loop, to joint updates, and to itself restored from a file."""

from __future__ import annotations

import math

import pytest
import torch

from ahnn.estimation import Belief, Gate, Status, initial_belief, load_state, save_state
from ahnn.measurements import Position
from ahnn_plugins.ukf import SQUARE_ROOT, STANDARD, UnscentedKalmanFilter, unscented_filter

FORMS = [SQUARE_ROOT, STANDARD]
F64 = torch.float64
EYE = torch.eye(2, dtype=F64)


def pendulum(x, dt):
    p = x[:, 1] - dt * torch.sin(x[:, 0])
    return torch.stack((x[:, 0] + dt * p, p), dim=-1)


def pendulum_rows(batch, steps, seed=0):
    generator = torch.Generator().manual_seed(seed)
    rows = torch.sin(0.05 * torch.arange(1, steps + 1, dtype=F64))[None, :, None]
    return rows + 0.05 * torch.randn(batch, steps, 1, generator=generator, dtype=F64)


def same(a, b):
    """Return whether two states are equal bit for bit."""
    flat = [[*state.belief, *state[1:]] for state in (a, b)]
    return all(torch.equal(x, y) for x, y in zip(*flat, strict=True))


def walk(ukf, state, flow, rows, model, q, r, dt, each=lambda state: state):
    """Step through all rows; `each` is called between any two calls of the filter."""
    told = []
    for k in range(rows.shape[1]):
        state = each(ukf.predict(state, flow, dt, q))
        state, innovation = ukf.update(state, rows[:, k], model, r)
        state = each(state)
        told.append(innovation)
    return state, told


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
def test_steps_are_the_batch_loop_bit_for_bit(make_linear, form):
    problem, model = make_linear(6, 3, steps=40, batch=5, seed=3)
    rows = problem.measurements.clone()
    rows[:, ::4] = torch.nan
    rows[2, 7, 1] = torch.nan
    rows[1, 20:] += 1e3
    rows[3, 11] += 1e3
    gate = Gate(0.999, 4)
    calls = 0

    def flow(x, dt):
        nonlocal calls
        calls += 1
        out = problem.flow(x, dt)
        if calls % 40 > 25 or calls % 40 == 0:
            out[:13] = torch.nan
        return out

    belief = initial_belief(problem.mean, problem.p0)
    whole = unscented_filter(
        flow, belief, rows, model, problem.q, problem.r, 0.5, form=form, gate=gate, start_time=2.0
    )
    ukf = UnscentedKalmanFilter(form=form, gate=gate)
    state, told = walk(ukf, ukf.start(belief, time=2.0), flow, rows, model, problem.q, problem.r, 0.5)
    assert same(state, whole.state)
    assert whole.status.tolist() == [Status.NOT_FINITE, Status.DIVERGED, 0, 0, 0]
    assert float(state.time) == 22.0
    alive = whole.status == Status.OK
    assert torch.equal(state.belief.mean[alive], whole.means[alive, -1])
    residuals, nis = (torch.stack([getattr(i, name) for i in told], 1) for name in ("residual", "nis"))
    assert torch.equal(residuals[alive].nan_to_num(7.0), whole.innovations[alive].nan_to_num(7.0))
    assert torch.equal(nis[alive].nan_to_num(7.0), whole.nis[alive].nan_to_num(7.0))
    assert torch.equal(torch.stack([i.rejected for i in told], 1), whole.rejected)
    assert torch.equal(torch.stack([i.measured for i in told], 1), whole.measured)
    total = torch.stack([i.log_likelihood for i in told], 1).sum(1)
    assert torch.allclose(total, whole.log_likelihood, rtol=1e-12, atol=0.0)


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
def test_two_sensors_at_one_time_equal_one_joint_update(make_linear, close, form):
    problem, model = make_linear(5, 4, steps=1, batch=3, seed=8)
    r = problem.r.clone()
    r[:2, 2:] = r[2:, :2] = 0.0
    y = problem.measurements[:, 0]
    ukf = UnscentedKalmanFilter(form=form)
    start = ukf.start(initial_belief(problem.mean, problem.p0))
    joint, _ = ukf.update(start, y, model, r)
    one = start
    for part in (slice(2, 4), slice(0, 2)):
        one, _ = ukf.update(one, y[:, part], type(model)(problem.h[part]), r[part, part])
    assert close(one.belief.mean, joint.belief.mean, 1e-12)
    assert close(one.belief.covariance, joint.belief.covariance, 1e-12, trailing=2)
    assert torch.allclose(one.log_likelihood, joint.log_likelihood, rtol=1e-12, atol=0.0)


def test_a_measurement_at_the_start_is_the_textbook_update():
    ukf = UnscentedKalmanFilter()
    state = ukf.start(initial_belief([[1.0, 0.0]], 4.0 * EYE), time=5.0)
    seen = []

    class Clocked(Position):
        def __call__(self, x, t):
            seen.append(t)
            return super().__call__(x, t)

    state, innovation = ukf.update(state, [[3.0]], Clocked(1), [[4.0]])
    # Prior variance 4 and noise 4: half way, half the variance.
    assert state.belief.mean.tolist() == [[pytest.approx(2.0), 0.0]]
    assert state.belief.covariance[0].diagonal().tolist() == pytest.approx([2.0, 4.0])
    assert innovation.residual.tolist() == [[pytest.approx(2.0)]]
    assert innovation.nis.tolist() == pytest.approx([0.5])
    assert seen == [5.0] * len(seen)
    assert innovation.log_likelihood.tolist() == pytest.approx([-0.25 - 0.5 * math.log(2 * math.pi * 8.0)])
    assert torch.equal(state.log_likelihood, innovation.log_likelihood)


def test_a_noise_may_differ_from_row_to_row(make_linear, close):
    problem, model = make_linear(3, 2, steps=6, seed=4)
    belief = initial_belief(problem.mean, problem.p0)
    ukf = UnscentedKalmanFilter()
    state, mean, cov = ukf.start(belief), problem.mean[0], problem.p0
    for k in range(6):
        r = (1.0 + k) * problem.r
        state = ukf.predict(state, problem.flow, 1.0, problem.q)
        state, _ = ukf.update(state, problem.measurements[:, k], model, r)
        mean, cov = problem.a @ mean, problem.a @ cov @ problem.a.mT + problem.q
        gain = cov @ problem.h.mT @ torch.linalg.inv(problem.h @ cov @ problem.h.mT + r)
        mean = mean + gain @ (problem.measurements[0, k] - problem.h @ mean)
        cov = cov - gain @ problem.h @ cov
    assert close(state.belief.mean[0], mean, 1e-11)
    assert close(state.belief.covariance[0], cov, 1e-11, trailing=2)


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
def test_twenty_outliers_end_a_member_in_one_call_in_twenty_and_in_steps(form):
    def still(x, dt):
        return x + 0.0 * dt

    rows = 0.05 * torch.randn(3, 40, 1, generator=torch.Generator().manual_seed(0), dtype=F64)
    rows[1, 10:30] += 5.0
    gate, noise = Gate(patience=20), (1e-5 * EYE, 0.0025 * EYE[:1, :1])
    belief = initial_belief(torch.zeros(3, 2), 0.01 * EYE)

    def run(belief, rows):
        return unscented_filter(still, belief, rows, Position(1), *noise, 0.0625, form=form, gate=gate)

    whole = run(belief, rows)
    assert whole.status.tolist() == [0, Status.DIVERGED, 0]
    assert whole.failed_step.tolist() == [-1, 29, -1]
    state = belief
    for k in range(40):
        single = run(state, rows[:, k : k + 1])
        state = single.state
        dead = bool(torch.isnan(single.means[1, 0, 0]))
        assert dead == (k >= 29)
    assert same(state, whole.state)
    ukf = UnscentedKalmanFilter(form=form, gate=gate)
    steps, _ = walk(ukf, ukf.start(belief), still, rows, Position(1), *noise, 0.0625)
    assert same(steps, whole.state)
    # Nineteen are not enough.
    rows[1, 29] -= 5.0
    assert run(belief, rows).status.tolist() == [0, 0, 0]


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
@pytest.mark.parametrize(("size", "batch"), [(2, 1), (9, 1), (9, 4)])
def test_a_state_saved_and_restored_after_every_step_ends_with_the_same_bits(
    make_linear, tmp_path, form, size, batch
):
    problem, model = make_linear(size, 2, steps=30, batch=batch, seed=size)
    rows = problem.measurements.clone()
    rows[0, 10:] += 1e3
    rows[:, ::7] = torch.nan
    arguments = (problem.flow, rows, model, problem.q, problem.r, 0.3)
    ukf = UnscentedKalmanFilter(form=form, gate=Gate(0.99, 6))
    start = ukf.start(initial_belief(problem.mean, problem.p0), time=0.1)

    def restored(state):
        save_state(state, tmp_path / "state")
        read = load_state(tmp_path / "state")
        assert same(read, state)
        return read

    through, _ = walk(ukf, start, *arguments)
    again, _ = walk(ukf, restored(start), *arguments, each=restored)
    assert same(again, through)
    assert through.status[0] == Status.DIVERGED
    assert [path.name for path in tmp_path.iterdir()] == ["state"]


def test_a_failed_member_keeps_its_last_sound_belief_and_touches_no_other():
    rows = pendulum_rows(2, 12)
    ukf, noise = UnscentedKalmanFilter(), (1e-5 * EYE, 0.0025 * EYE[:1, :1])
    clean = ukf.start(initial_belief(torch.zeros(2, 2), 0.01 * EYE))
    spoiled = clean
    for k in range(12):

        def flow(x, dt, k=k):
            out = pendulum(x, dt)
            return torch.cat((out[:5] * (torch.nan if k == 7 else 1.0), out[5:]))

        before = spoiled
        clean = ukf.predict(clean, pendulum, 0.05, noise[0])
        clean, _ = ukf.update(clean, rows[:, k], Position(1), noise[1])
        spoiled = ukf.predict(spoiled, flow, 0.05, noise[0])
        spoiled, told = ukf.update(spoiled, rows[:, k], Position(1), noise[1])
        if k >= 7:
            assert torch.equal(spoiled.belief.mean[0], before.belief.mean[0])
            assert bool(told.nis[0].isnan())
            assert bool(told.nis[1].isfinite())
    assert spoiled.status.tolist() == [Status.NOT_FINITE, 0]
    assert spoiled.failed_step.tolist() == [7, -1]
    assert torch.equal(spoiled.belief.mean[1], clean.belief.mean[1])
    assert torch.equal(spoiled.log_likelihood[1], clean.log_likelihood[1])


def test_a_row_of_nan_changes_nothing_and_calls_no_model():
    class Untouchable(Position):
        def __call__(self, x, t):
            raise AssertionError(x, t)

    ukf = UnscentedKalmanFilter(gate=Gate())
    state = ukf.start(initial_belief(torch.zeros(2, 2), EYE))
    after, told = ukf.update(state, torch.full((2, 1), torch.nan), Untouchable(1), EYE[:1, :1])
    assert after is state
    assert told.measured.tolist() == [0, 0]
    assert bool(told.nis.isnan().all())


START = UnscentedKalmanFilter().start(initial_belief([[0.0, 0.0]], EYE))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda ukf: ukf.start(torch.zeros(2)), "belief: expected a Belief; received Tensor"),
        (lambda ukf: ukf.start(START.belief, time=math.nan), "time: expected a finite number; received nan"),
        (lambda ukf: ukf.predict(START.belief, pendulum, 1.0, EYE), "state: expected a FilterState"),
        (lambda ukf: ukf.predict(START, pendulum, 0.0, EYE), "dt: expected finite steps > 0; received 0.0"),
        (lambda ukf: ukf.predict(START, pendulum, [1.0, 1.0], EYE), "dt: expected one number; received list"),
        (lambda ukf: ukf.predict(START, lambda x, _: x + 1j, 1.0, EYE), "real tensor .* torch.complex128"),
        (
            lambda ukf: ukf.update(START, [[0.0, 0.0]], Position(1), EYE[:1, :1]),
            r"y: expected shape \(1, 1\); received \(1, 2\)",
        ),
        (
            lambda ukf: ukf.update(START, [[math.inf]], Position(1), EYE[:1, :1]),
            r"y: .* infinite one at \[0, 0\]",
        ),
        (lambda ukf: ukf.update(START, [[1j]], Position(1), EYE[:1, :1]), "y: expected real numbers"),
    ],
)
def test_mistakes_are_named(call, message):
    with pytest.raises(ValueError, match=message):
        call(UnscentedKalmanFilter())


@pytest.mark.parametrize("gate", [Gate(0.9, math.nan), Gate(0.9, 2.5), Gate(math.nan, 5), Gate(0.9, 0), 0.9])
def test_a_gate_that_is_none_is_refused_with_one_message(gate):
    message = r"gate: expected a Gate\(probability in \(0, 1\), patience a whole number >= 1\); received"
    with pytest.raises(ValueError, match=message):
        UnscentedKalmanFilter(gate=gate)
    with pytest.raises(ValueError, match=message):
        unscented_filter(pendulum, START.belief, [[[0.0]]], Position(1), EYE, EYE[:1, :1], 1.0, gate=gate)


def test_a_start_time_beside_a_state_is_refused():
    with pytest.raises(ValueError, match=r"start_time: expected none with a state.*; received 3.0"):
        unscented_filter(pendulum, START, [[[0.0]]], Position(1), EYE, EYE[:1, :1], 1.0, start_time=3.0)


def test_what_is_no_stored_state_is_refused(tmp_path):
    path = tmp_path / "state"
    path.write_bytes(b"nothing of the kind")
    with pytest.raises(ValueError, match="path: expected a file written by save_state, of this"):
        load_state(path)
    with pytest.raises(FileNotFoundError):
        load_state(tmp_path / "missing")
    from safetensors.torch import save_file

    save_file({"mean": torch.zeros(1, 2)}, path)
    with pytest.raises(ValueError, match="path: expected a file written by save_state, of this"):
        load_state(path)
    save_state(START._replace(belief=Belief(*START.belief)), path)
    assert same(load_state(str(path)), START)
