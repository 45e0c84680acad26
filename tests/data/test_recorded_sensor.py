"""Recorded measurements are what simulated ones are, once they are in a file: training sees the same."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import cases
import pytest
import torch
from helpers import MOLNIYA, SPRING, defaults

from ahnn.cli.parts import SENSOR, SIMULATION
from ahnn.data import Files, Simulated
from ahnn.data.datamodule import WindowDataModule
from ahnn.data.generate import generate
from ahnn.data.recorded_sensor import Recorded
from ahnn.data.sensor import Sensor
from ahnn.errors import UserError
from ahnn.evaluation import evaluate
from ahnn.evaluation.goodness_of_fit import cleaned, outlier_fraction
from ahnn.evaluation.make_case import make_case
from ahnn.evaluation.publish import make_results
from ahnn.evaluation.score_table import results_table
from ahnn.measurements import Segment
from ahnn.types import Trajectories

UNITS = {"mass_spring": "[m],[m/s]", "molniya": "[km],[km/s]"}


def module(source, sensor, **changes):
    options = {
        k: v for k, v in defaults("hnn")["data"].items() if k not in (*SIMULATION, *SENSOR, "_target_")
    }
    options |= {"split": [0.6, 0.2, 0.2], "window": 3, "batch_size": 32, "precision": 64} | changes
    return WindowDataModule(source, **options, sensor=sensor)


def written(path, space, measured):
    """A table of measurements, every number with all its digits, rows without any left out."""
    n, size = space.dof, measured.states.shape[-1]
    position, rate = UNITS[space.name].split(",")
    names = [f"q{i + 1} {position}" for i in range(n)] + [f"v{i + 1} {rate}" for i in range(n)]
    lines = [",".join(["id", "t [s]", *names[:size]])]
    for b, (states, times) in enumerate(zip(*(x.tolist() for x in measured[:2]), strict=True)):
        for state, time in zip(states, times, strict=True):
            if not any(x != x for x in state):
                lines.append(",".join(map(repr, [b, time, *state])))
    path.write_text("\n".join(lines) + "\n")
    return str(path)


@pytest.mark.parametrize("system", [SPRING, MOLNIYA], ids=lambda s: s.name)
@pytest.mark.parametrize("measured", ["state", "position"])
def test_training_sees_the_same_numbers(tmp_path, system, measured):
    system = dataclasses.replace(system, steps=40)
    simulated = Simulated(system, trajectories=10, seed=0, cache=str(tmp_path))
    about = {"measured": measured, "noise": 0.01}
    drawn = module(simulated, Sensor(simulated.space, **about))
    parts = [drawn.trajectories(split) for split in ("train", "val", "test")]
    whole = type(parts[0])(*(torch.cat(both) for both in zip(*(p[:2] for p in parts), strict=True)))
    source = Files("mine", written(tmp_path / "data.csv", simulated.space, whole))
    assert source.positions_only == (measured == "position")
    read = module(source, Recorded(source.space, **about))
    for split in ("train", "val", "test"):
        for got, expected in zip(read.trajectories(split)[:2], drawn.trajectories(split)[:2], strict=True):
            assert torch.equal(got, expected)
        one, other = read.whole(split), drawn.whole(split)
        assert torch.equal(one.values, other.values)
        assert one.instrument.longest == other.instrument.longest
        assert torch.equal(one.instrument.deviations, other.instrument.deviations)
    for got, expected in zip(read.statistics(), drawn.statistics(), strict=True):
        assert torch.equal(torch.as_tensor(got), torch.as_tensor(expected))


def test_missing_measurements_are_absent_in_both(tmp_path):
    system = dataclasses.replace(SPRING, steps=60)
    simulated = Simulated(system, trajectories=3, seed=0, cache=str(tmp_path))
    truth = simulated.read()
    seen = Trajectories(*Sensor(simulated.space, measured="state", noise=0.01, gaps=0.2).measure(truth, 0))
    source = Files("mine", written(tmp_path / "data.csv", simulated.space, seen))
    got = Recorded(source.space, measured="state", noise=0.01).measure(source.read(), 0)
    for b in range(3):
        there = seen.present[b].nonzero().flatten()
        part = slice(int(there[0]), int(there[-1]) + 1)
        kept = slice(0, part.stop - part.start)
        assert torch.equal(got.values[b, kept].nan_to_num(), seen.states[b, part].nan_to_num())
        assert torch.allclose(got.times[b, kept], seen.times[b, part], rtol=1e-14, atol=0)


def test_noise_is_remarked_upon_unless_the_training_takes_it_into_account(tmp_path):
    """A loss on windows takes measurements as exact; one in stages weighs them, and knows their noise."""
    system = dataclasses.replace(SPRING, steps=200)
    simulated = Simulated(system, trajectories=10, seed=0, cache=str(tmp_path))
    assert module(simulated, None).remark() is None
    drawn = module(simulated, Sensor(simulated.space, measured="state", noise=0.01))
    assert "this loss would learn the noise" in (drawn.remark() or "")
    drawn.follow(SimpleNamespace(), 1)
    assert drawn.remark() is None
    drawn.sensor.deviations = 3 * drawn.sensor.deviations  # as if somebody had stated that
    assert "data.noise differs" in (drawn.remark() or "")


@pytest.mark.parametrize(("per_epoch", "steps"), [(None, 1), (3, 1), (4, 1), (9, 2), (12, 3)])
def test_stages_are_handed_out_as_segments_that_grow(tmp_path, per_epoch, steps):
    """As many steps as windows would make, each of the segments of a stage or of the batch size."""
    system = dataclasses.replace(SPRING, steps=40)
    simulated = Simulated(system, trajectories=10, seed=0, cache=str(tmp_path))
    sensor = Sensor(simulated.space, measured="state", noise=0.01)
    data = module(simulated, sensor, batch_size=4, windows_per_epoch=per_epoch, val_windows=1)
    stages = SimpleNamespace(
        intervals=lambda epoch, epochs: 5 if epoch < epochs - 1 else None,
        segments_per_step=lambda epoch, _: 3 if epoch == 1 else None,
    )
    data.follow(stages, 3)
    loader, shapes = data.train_dataloader(), []
    for epoch in range(3):
        loader.set_epoch(epoch)
        shapes.append([tuple(batch.values.shape) for batch in loader])
    assert shapes == [[(4, 6, 2)] * steps, [(3, 6, 2)] * steps, [(4, 41, 2)] * steps]
    (judged,) = data.val_dataloader()
    assert torch.equal(judged.values, data.trajectories("val").states[:1])


def test_a_step_takes_no_more_segments_than_hold_all_that_was_measured(tmp_path):
    """Trajectories of 41 measurements, a tenth of them missing; a stage on whole ones at the end."""
    system = dataclasses.replace(SPRING, steps=40)
    simulated = Simulated(system, trajectories=10, seed=0, cache=str(tmp_path))
    sensor = Sensor(simulated.space, measured="state", noise=0.01, gaps=0.1)
    data = module(simulated, sensor, batch_size=500)
    stages = SimpleNamespace(
        intervals=lambda epoch, _: (5, 20, None)[epoch],
        segments_per_step=lambda epoch, _: 50 if epoch else None,
    )
    data.follow(stages, 3)
    measured, rows = int(data.trajectories("train").present.sum()), len(data.trajectories("train").times)
    assert 0.85 < measured / (41 * rows) < 0.95
    sizes = [(len(segments), size) for segments, size in map(data._stage, range(3))]
    assert [size for _, size in sizes] == [round(measured / 5), round(measured / 20), 50]
    assert sizes[0][0] > sizes[0][1]


def test_a_stage_longer_than_all_trajectories_fits_them_whole_and_says_so_once(tmp_path, caplog):
    simulated = Simulated(dataclasses.replace(SPRING, steps=40), trajectories=10, seed=0, cache=str(tmp_path))
    data = module(simulated, Sensor(simulated.space, measured="state", noise=0.01), batch_size=4)
    stages = SimpleNamespace(
        intervals=lambda epoch, _: (5, 64, 5, 64)[epoch], segments_per_step=lambda *_: None
    )
    data.follow(stages, 4)
    with caplog.at_level("INFO", logger="ahnn"):
        assert [data._stage(epoch)[0].intervals for epoch in range(4)] == [5, 40, 5, 40]
    noted = [
        message for message in caplog.messages if message.startswith("loss.stages: no trajectory has 64 int")
    ]
    assert len(noted) == 1


def test_noise_to_estimate_begins_at_what_differences_show(tmp_path):
    system = dataclasses.replace(SPRING, steps=200)
    simulated = Simulated(system, trajectories=10, seed=0, cache=str(tmp_path))
    drawn = module(simulated, Sensor(simulated.space, measured="position", noise=0.01))
    parts = [drawn.trajectories(split) for split in ("train", "val", "test")]
    whole = type(parts[0])(*(torch.cat(both) for both in zip(*(p[:2] for p in parts), strict=True)))
    source = Files("mine", written(tmp_path / "data.csv", simulated.space, whole))
    read = module(source, Recorded(source.space, measured="position", noise="estimate"))
    assert float(read.instrument.deviations) == pytest.approx(0.01, rel=0.1)
    assert read.remark() is None
    few = module(source, Recorded(source.space, measured="position", noise="estimate"))
    few.splits._measured["train"] = few.measured("train")._replace(
        values=few.measured("train").values[:, :8], times=few.measured("train").times[:, :8]
    )
    with pytest.raises(UserError, match=r"data\.noise: expected samples dense enough"):
        few.splits.instrument()


def test_noise_of_simulated_measurements_is_no_unknown():
    with pytest.raises(UserError, match=r"data\.noise: expected standard deviations of simulated noise"):
        Sensor(SPRING.space, measured="position", noise="estimate")


def test_a_simulated_bias_is_the_same_in_all_parts():
    system = dataclasses.replace(SPRING, steps=50)
    about = {"measured": "position", "noise": 1e-6, "seed": 4}
    biased, plain = Sensor(system.space, **about, bias_sd=0.5), Sensor(system.space, **about)
    truth = generate(system, 4, 0)
    off = [biased.measure(truth, part).values - plain.measure(truth, part).values for part in (0, 2)]
    assert float(off[0].std()) < 1e-12
    assert torch.allclose(off[0], off[1], atol=1e-12)
    assert 1e-3 < float(off[0].abs().mean()) < 2.5


def test_messages_name_the_columns_of_the_file():
    space = SPRING.space._replace(components=("height", "pheight"))
    for measured, names in (("position", ("height",)), ("state", ("height", "pheight"))):
        assert Recorded(space, measured=measured, noise=0.1).measurement.names == names


@pytest.mark.parametrize("robust", ["none", "student"])
def test_outliers_are_excluded_from_the_table_as_documented(tmp_path, robust):
    """The exact equations leave the noise of 0.01, unless every 40th value, off by 1, counts."""
    system = dataclasses.replace(cases.SPRING, steps=400)
    simulated = Simulated(system, trajectories=10, seed=0, cache=str(tmp_path))
    parts = simulated.read()
    noise = torch.randn(parts.states[..., :1].shape, generator=torch.Generator().manual_seed(0)).double()
    seen = parts.states[..., :1] + 0.01 * noise
    seen[:, 20::40] += 1.0
    space = simulated.space._replace(name="mass_spring")
    path = written(tmp_path / "data.csv", space, Trajectories(seen, parts.times))
    source = Files("mine", path, mass=system.mass)
    splits = module(source, Recorded(source.space, measured="position", noise=0.01)).splits
    exact = cases.Learned(system.stiffness)
    exact.assumes = "a spring"
    case = make_case(exact, splits, label="spring", seed=0, folder=tmp_path, robust=robust)
    findings = evaluate(case, {}, figures=False)
    excluded = robust == "student"
    assert case.outliers == pytest.approx(10 / 401 * excluded)
    assert findings.rows[0].scores.position == pytest.approx(0.01 if excluded else 0.158, rel=0.1)
    table = results_table(make_results(case, findings, {}, {}))
    assert ("2.5 % outliers excluded" in " ".join(table.split())) == excluded


def test_values_of_a_path_that_is_wrong_are_no_outliers():
    """Five of eleven values off are outliers; six are not, since they may be right and the path wrong."""
    system = cases.SPRING
    truth = cases.trajectories(system, 2, 0)
    truth = Trajectories(truth.states[:, :11], truth.times[:, :11])
    sensor = Sensor(system.space, measured="position", noise=0.01)
    values = truth.states[..., :1].clone()
    values[0, :5] += 1.0
    values[1, :6] += 1.0
    segment = Segment(values, truth.times, sensor.instrument(system.dt))
    steps = SimpleNamespace(ends=torch.arange(11))
    kept = cleaned(segment, SimpleNamespace(states=truth.states), steps, "huber")
    assert kept.measured.tolist() == [6, 11]
    assert outlier_fraction(segment, kept) == pytest.approx(5 / 22)
