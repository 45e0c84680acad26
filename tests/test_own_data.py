"""Training on files from the command line: exact states, recorded measurements, and what is refused."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import pytest
import torch
from entry import call

import ahnn
from ahnn.data import Files
from ahnn.evaluation import Who

SD = 0.01
SMALL = [
    "system=files",
    "trainer.accelerator=cpu",
    "logger=none",
    "evaluation=scores",
    "data.batch_size=60",
    "data.windows_per_epoch=120",
    "data.val_windows=null",
]


def swings(path: Path, columns: int, noise: float = 0.0, *, whole: bool = True) -> Path:
    """Oscillations of unit mass and omega = 2, with their velocities where four columns are asked for.

    Where they are not whole, times are irregular, samples are missing, and every other one ends sooner.
    """
    draw = torch.Generator().manual_seed(0)
    lines = [",".join(["id", "t [s]", "q [m]", "v [m/s]"][:columns])]
    for b in range(20):
        a, phase = (0.5 + torch.rand(1, generator=draw).item(), 6 * torch.rand(1, generator=draw).item())
        for k in range(61):
            t = 0.05 * k if whole else 0.05 * k + 0.02 * math.sin(5.0 * k)
            angle = 2.0 * t + phase
            q, v = a * math.cos(angle), -2 * a * math.sin(angle)
            off = noise * torch.randn(2, generator=draw).double()
            cells = [
                str(b),
                f"{t:.2f}" if whole else repr(t),
                repr(q + float(off[0])),
                repr(v + float(off[1])),
            ]
            if whole or (k * (3 + b) % 7 < 4 and k < 61 - 20 * (b % 2)):
                lines.append(",".join(cells[:columns]))
    path.write_text("\n".join(lines) + "\n")
    return path


def test_states_of_a_file_train_resume_and_are_known_again(tmp_path, capfd):
    data = swings(tmp_path / "swings.csv", 4)
    run = f"run={tmp_path / 'run'}"
    given = [*SMALL, f"system.path={data}", "model=hnn", "model.network.width=8", run]
    assert call("ahnn.train", *given, "trainer.max_epochs=1") == 0
    found = ahnn.load(tmp_path / "run")
    assert found.space.units == ahnn.Units("s", "m", "m/s", "m²/s²")
    assert found.results.rows[0].who == Who("model", "true")
    assert found.about["data"]["recipe"] == Files("files", str(data)).recipe()
    assert call("ahnn.train", *given, "trainer.max_epochs=1", "ckpt=last") == 0
    assert call("ahnn.evaluate", run, "name=same") == 0
    assert call("ahnn.evaluate", run, "name=cut", "system.cut=30") == 2
    assert "system: expected the training files with their settings" in capfd.readouterr().err
    swings(tmp_path / "swings.csv", 4, noise=1e-3)
    assert call("ahnn.train", *given, "trainer.max_epochs=2", "ckpt=last") == 2
    assert "data.recipe.files: the content of the files has changed" in capfd.readouterr().err
    data.write_text(data.read_text().replace("0,0.05,", "0,0.051,", 1))
    assert call("ahnn.train", *given, "trainer.max_epochs=1", "ckpt=last") == 2
    assert "files" in capfd.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("whole", [True, False])
def test_recorded_positions_are_measurements_and_chi_square_is_the_verdict(tmp_path, whole):
    data = swings(tmp_path / "swings.csv", 3, SD, whole=whole)
    given = ["model=ahnn", "hamiltonian=mechanical", "sensor=recorded", f"data.noise={SD}"]
    given += ["loss.stages=[[16, 1.0]]", "trainer.max_epochs=6", "evaluation.figures=true"]
    folder = tmp_path / "run"
    assert call("ahnn.train", *SMALL, f"system.path={data}", *given, f"run={folder}") == 0
    run = ahnn.load(folder)
    assert (run.config["model"]["integrator"]["name"], run.config["data"]["stride"]) == ("dopri8", 4)
    results = run.results
    assert [row.who for row in results.rows] == [Who("model", "fitted")]
    assert math.isnan(results.rows[0].scores.velocity)
    assert results.rows[0].scores.energy is None
    explained = results.numbers["measurements"]
    # One test trajectory: its residuals are those that chi-square sums up.
    pooled, ids = (
        results.rows[0].scores.position_pooled,
        [line.split(",")[0] for line in data.read_text().splitlines()],
    )
    counts = {ids.count(str(b)) for b in range(20)}
    assert (counts == {61}) == whole
    expected = [n * (pooled / SD) ** 2 / (n - 2) for n in counts]
    assert any(explained["chi_square"] == pytest.approx(chi_square, rel=1e-6) for chi_square in expected)
    assert {"inflation", "chi_square", "held_out"} <= results.numbers["uncertainty"].keys()
    assert (folder / "figures" / "error.png").exists()


@pytest.mark.slow
def test_wrong_standard_deviations_are_named_before_a_training_and_below_its_table(tmp_path, capfd):
    data = swings(tmp_path / "swings.csv", 3, SD, whole=False)
    given = ["model=ahnn", "hamiltonian=mechanical", "recipe=measurements", f"data.noise={10 * SD}"]
    given += ["loss.stages=[[16, 1.0]]", "trainer.max_epochs=6", f"run={tmp_path / 'run'}"]
    assert call("ahnn.train", *SMALL, f"system.path={data}", *given) == 0
    assert "noise of q 0.0099 m (standard deviations), unless" in (told := capfd.readouterr().err)
    assert "data.noise differs" in told
    (row,) = ahnn.load(tmp_path / "run").results.rows
    about, _, rest = row.note.partition(" times too large for q ")
    assert 4 < float(about.rsplit("data.noise is about ", 1)[1]) < 14
    assert rest.startswith("(data.noise=estimate finds it)")


@pytest.mark.slow
def test_a_model_of_recorded_positions_filters_as_well_as_its_covariance_says(tmp_path, capfd, caplog):
    data = swings(tmp_path / "swings.csv", 3, SD, whole=False)
    given = ["model=ahnn", "hamiltonian=mechanical", "recipe=measurements", f"data.noise={SD}"]
    given += ["loss.stages=[[16, 1.0]]", "trainer.max_epochs=6", "plugins=none"]
    run = f"run={tmp_path / 'run'}"
    assert call("ahnn.train", *SMALL, f"system.path={data}", *given, run) == 0
    draw = torch.Generator().manual_seed(1)
    lines = ["t [s],q [m]"]
    for k in range(1, 60):
        noise = SD * torch.randn(1, generator=draw).item()
        lines.append(f"{0.05 * k:.2f},{0.8 * math.cos(0.1 * k) + noise!r}")
    fixes = tmp_path / "fixes.csv"
    fixes.write_text("\n".join(lines) + "\n")
    stream = [f"measurements={fixes}", f"measurement.sd={SD}", "start=[0.8,0.0]", "start_sd=[0.1,0.1]"]
    assert call("ahnn.assimilate", run, *stream, "plugins=ukf", f"output={tmp_path / 'none.csv'}") == 2
    told = capfd.readouterr().err
    assert (
        "received fitted. Use plugins=ukf_parameter_error or process_noise=[POSITION,VELOCITY] of the plugin"
        in told
    )
    off = [text.replace(f"sd={SD}", f"sd={SD / 3}") for text in stream]
    assert call("ahnn.assimilate", run, *off, "plugins=ukf_parameter_error", "output=-") == 0
    mean = float(caplog.messages[-1].split()[5].strip(";"))
    assert 6.0 < mean < 12.0  # measurements with three times the noise
    said = "this one is overconfident, since process noise or measurement noise is too small"
    assert said in caplog.messages[-1]
    silent = [text for text in stream if not text.startswith("measurement.sd")]
    lost = tmp_path / "lost.csv"
    assert call("ahnn.assimilate", run, *silent, "plugins=ukf_parameter_error", f"output={lost}") == 2
    assert "expected a column sd_q, or measurement.sd=NUMBER" in capfd.readouterr().err
    assert not lost.exists()
    data.unlink()  # a filter takes nothing from the training but its folder
    means, covariances = [], []
    given = "plugins.ukf.process_noise=[1e-9,1e-9]"
    for chosen in ([], ["plugins=ukf", given], [given]):
        output = tmp_path / f"{len(means)}.csv"
        assert call("ahnn.assimilate", run, *stream, *chosen, f"output={output}") == 0
        assert "a consistent filter has" in caplog.messages[-1]
        last = list(csv.DictReader(output.read_text().splitlines()))[-1]
        a, b, c = (float(last[name]) for name in ("cov_q_q", "cov_pq_q", "cov_pq_pq"))
        means.append(torch.tensor([float(last["q"]), float(last["pq"])], dtype=torch.float64))
        covariances.append(torch.tensor([[a, b], [b, c]], dtype=torch.float64))
    assert (tmp_path / "1.csv").read_text() == (tmp_path / "2.csv").read_text()
    assert bool((covariances[0].diagonal() > 1.05 * covariances[1].diagonal()).all())
    off = means[0] - torch.tensor([0.8 * math.cos(5.9), -1.6 * math.sin(5.9)], dtype=torch.float64)
    assert float(off @ torch.linalg.solve(covariances[0], off)) < 13.8  # 0.999 of chi-square, two degrees


HUBER = ("loss.robust=huber", "recipe=measurements", "hamiltonian=mechanical")


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        ([], "data.noise: expected the standard deviations of the measurements"),
        (["data.noise=0.01"], "Use hamiltonian=mechanical or central_body"),
        (["data.noise=0.01", "recipe=measurements"], "Use hamiltonian=mechanical or central_body"),
        (["data.noise=0.01", "data.measured=state", "recipe=measurements"], "received only positions"),
        (
            ["data.noise=0.01", "data.every=3", "recipe=measurements"],
            "nothing is added to recorded measurements; received data.every=3",
        ),
        (["data.noise=0.01", "sensor=tracking"], "received data.every=5"),
        (
            ["data.noise=[1,2]", "recipe=measurements"],
            "data.noise: expected a standard deviation > 0 for each of q [m]",
        ),
        (
            ["data.noise=0.01", "data.correlation=estimate", *HUBER],
            "data.correlation: expected loss.robust=none; received loss.robust=huber",
        ),
        (
            ["data.noise=0.01", "data.bias_sd=-1", "recipe=measurements", "hamiltonian=mechanical"],
            "data.bias_sd: expected standard deviations of biases",
        ),
        (["data.noise=estimates"], "data.noise: expected"),
        (["system.cut=1"], "system.cut: expected int >= 2 or None; received 1"),
        (["system.path=null"], "system.path: expected the path of your data; received none. Set system."),
        (["system.path=none.csv"], "system.path: expected a file; received none.csv: No such file"),
    ],
)
def test_what_does_not_fit_is_one_message(tmp_path, capfd, overrides, expected):
    data = swings(tmp_path / "swings.csv", 3)
    run = f"run={tmp_path / 'run'}"
    assert call("ahnn.train", *SMALL, f"system.path={data}", "model=ahnn", run, *overrides) == 2
    err = capfd.readouterr().err
    lines = [line for line in err.splitlines() if not line.startswith("files: ")]  # what was read
    assert len(lines) == 1
    assert lines[0].startswith("ahnn: ")
    assert expected in lines[0]
    assert not (tmp_path / "run").exists()


def test_a_loss_that_cannot_take_a_step_on_the_data_leaves_nothing_behind(tmp_path, capfd):
    data = swings(tmp_path / "swings.csv", 4, whole=False)
    given = [*SMALL, f"system.path={data}", "model=ahnn", "recipe=second_order", f"run={tmp_path / 'run'}"]
    assert call("ahnn.train", *given) == 2
    told = capfd.readouterr().err
    assert "Set loss.derivative=0, or data.noise if they are measurements" in told
    assert "training" not in told
    assert not (tmp_path / "run").exists()


def test_a_run_finds_its_files_from_any_working_directory(tmp_path, monkeypatch, capfd):
    for name in ("home", "elsewhere"):
        (tmp_path / name).mkdir()
    swings(tmp_path / "home" / "swings.csv", 4)
    monkeypatch.chdir(tmp_path / "home")
    small = ["model=hnn", "model.network.width=8", "trainer.max_epochs=1"]
    assert call("ahnn.train", *SMALL, "system.path=swings.csv", *small, "run=mine") == 0
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert call("ahnn.evaluate", "run=../home/mine") == 0
    (tmp_path / "home" / "swings.csv").rename(tmp_path / "home" / "moved.csv")
    assert call("ahnn.evaluate", "run=../home/mine") == 2
    assert "system.path: expected a file; received swings.csv" in capfd.readouterr().err


def test_one_trajectory_makes_splits_only_when_it_is_cut(tmp_path, capfd):
    data = swings(tmp_path / "swings.csv", 4)
    data.write_text("".join(data.read_text().splitlines(keepends=True)[:62]))
    given = [*SMALL, f"system.path={data}", "model=hnn", f"run={tmp_path / 'run'}", "trainer.max_epochs=1"]
    assert call("ahnn.train", *given) == 2
    told = capfd.readouterr().err
    assert "or cut trajectories of files with system.cut, for example system.cut=" in told
    assert call("ahnn.train", *given, told.split()[-1], "data.split=[0.6,0.2,0.2]") == 0


def test_general_momenta_are_said_to_be_such_and_velocities_are_no_momenta_of_a_mass_matrix(tmp_path, capfd):
    data = swings(tmp_path / "swings.csv", 4)
    wanted = [
        *SMALL,
        "model=ahnn",
        "hamiltonian=mass_matrix",
        "trainer.max_epochs=1",
        "model.network.width=4",
    ]
    assert call("ahnn.train", *wanted, f"system.path={data}", f"run={tmp_path / 'refused'}") == 2
    assert "expected momenta p = M(q) v in the files" in capfd.readouterr().err
    general = tmp_path / "general.csv"
    general.write_text(data.read_text().replace("v [m/s]", "p [kg m/s]"))
    assert call("ahnn.train", *wanted, f"system.path={general}", f"run={tmp_path / 'refused'}") == 2
    assert "or system.mass=canonical if they are not mass times velocity" in capfd.readouterr().err
    canonical = ["system.mass=canonical", f"run={tmp_path / 'run'}"]
    assert call("ahnn.train", *wanted, f"system.path={data}", *canonical) == 2
    assert "expected a number without momenta" in capfd.readouterr().err
    assert call("ahnn.train", *wanted, f"system.path={general}", *canonical) == 0
    told = capfd.readouterr()
    assert "momentum [kg m/s]" in " ".join(told.out.split())
    assert "over the mass" not in told.err
    assert not ahnn.load(tmp_path / "run").space.mechanical
    made = [f"run={tmp_path / 'run'}", "start=[0.3,0]", "duration=3", f"output={tmp_path / 'ahead.csv'}"]
    assert call("ahnn.predict", *made) == 0
    assert "mass: canonical" in (tmp_path / "ahead.yaml").read_text()
    assert call("ahnn.data.__main__", "check", str(tmp_path / "ahead.csv")) == 0
    assert not Files("ahead", str(tmp_path / "ahead.csv")).space.mechanical
