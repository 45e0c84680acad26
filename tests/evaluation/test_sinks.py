"""Files are written fresh and follow no link; TensorBoard gets names that all runs share."""

from __future__ import annotations

import dataclasses
import io
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from cases import KEPLER, MODEL, ORBITS, SPRING, make_case, make_results, scores
from helpers import close, generator
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure
from matplotlib.image import imread
from safetensors.torch import load_file

from ahnn.evaluation import Findings, Row, evaluate, style
from ahnn.evaluation.open_loop import open_loop
from ahnn.evaluation.publish import write_predictions
from ahnn.evaluation.sinks.figure_files import write_figures
from ahnn.evaluation.sinks.tensorboard import log_scores
from ahnn.evaluation.trajectory_figures import Curve, energy, error, in_time, open_loop_figures
from ahnn.files import write_atomically

RESULTS = make_results(Row(MODEL, scores()))


def findings(*names):
    return Findings(figures={name: Figure(figsize=(1, 1)) for name in names}, arrays={"a": torch.arange(3.0)})


def names(folder):
    return {path.name for path in folder.iterdir()}


def test_pictures_are_written_fresh_in_two_formats(tmp_path):
    write_figures(tmp_path, findings("error", "orbit").figures)
    (tmp_path / "figures" / "notes.txt").write_text("mine")
    write_figures(tmp_path, findings("error", "ukf/state").figures)
    expected = {"error.png", "error.svg", "ukf_state.png", "ukf_state.svg", "notes.txt", ".ahnn-files"}
    assert names(tmp_path / "figures") == expected
    write_figures(tmp_path, findings().figures)
    assert names(tmp_path / "figures") == {"notes.txt"}


def test_the_same_figure_is_the_same_file(tmp_path):
    for name in ("a", "b"):
        write_figures(tmp_path / name, evaluate(make_case(tmp_path), {}).figures)
    for path in (tmp_path / "a" / "figures").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / "figures" / path.name).read_bytes()


def test_links_are_neither_followed_nor_removed(tmp_path):
    kept = tmp_path / "kept.png"
    kept.write_text("mine")
    folder = tmp_path / "run" / "figures"
    folder.mkdir(parents=True)
    (folder / "old.png").symlink_to(kept)
    write_figures(tmp_path / "run", findings("error").figures)
    assert kept.read_text() == "mine"
    assert names(folder) == {"error.png", "error.svg", "old.png", ".ahnn-files"}


def test_files_have_the_usual_permissions_and_leave_nothing_behind(tmp_path):
    (tmp_path / "usual").write_text("")
    write_atomically(tmp_path / "ours", b"x")
    assert (tmp_path / "ours").stat().st_mode == (tmp_path / "usual").stat().st_mode
    assert names(tmp_path) == {"usual", "ours", ".ahnn-files"}


def test_predictions_are_kept_or_removed(tmp_path):
    write_predictions(tmp_path, RESULTS, findings().arrays, keep=True)
    assert torch.equal(load_file(tmp_path / "predictions.safetensors")["a"], torch.arange(3.0))
    write_predictions(tmp_path, RESULTS, findings().arrays, keep=False)
    assert not names(tmp_path)


def test_tensorboard_gets_one_name_for_all_models():
    calls = []
    logger = SimpleNamespace(
        log_hyperparams=lambda params, metrics: calls.append((params, metrics)),
        experiment=SimpleNamespace(file_writer=SimpleNamespace(add_summary=lambda it, _: calls.append(it))),
        finalize=calls.append,
    )
    rows = [Row(MODEL, scores(1.0, None)), Row(MODEL._replace(floor=True), scores(2.0))]
    rows.append(Row(MODEL._replace(start="perturbed", estimator="ukf"), scores(3.0, 4.0)))
    results = make_results(*rows, training={"val_loss": 0.5}, numbers={"ukf": {"alpha": 1.0}})
    settings = {"optimizer": {"lr": 0.1}, "model": "hidden"}
    log_scores(logger, settings, results, findings("error").figures)
    (params, metrics), summary, end = calls
    assert params == {"system": "spring", "model": "model of mine", "assumes": "nothing", "optimizer.lr": 0.1}
    assert metrics == {
        "score/val_loss": 0.5,
        "score/position": 1.0,
        "score/velocity": 1.0,
        "score/position/ukf/perturbed": 3.0,
        "score/velocity/ukf/perturbed": 3.0,
        "score/energy/ukf/perturbed": 4.0,
    }
    (shown,) = summary.value
    pixels = imread(io.BytesIO(shown.image.encoded_image_string))
    assert (shown.tag, end) == ("error", "success")
    assert pixels.shape == (shown.image.height, shown.image.width, shown.image.colorspace)


def test_a_figure_is_drawn_once_for_all_sinks(tmp_path, monkeypatch):
    formats, found = [], findings("error")
    save = Figure.savefig

    def counted(figure, file, **options):
        formats.append(options["format"])
        save(figure, file, **options)

    monkeypatch.setattr(Figure, "savefig", counted)
    write_figures(tmp_path, found.figures)
    write_figures(tmp_path / "again", found.figures)
    assert formats == ["png", "svg"]
    assert names(tmp_path / "figures") == names(tmp_path / "again" / "figures")


CASES = {
    "spring": {},
    "plane": {"system": KEPLER, "wrong": dataclasses.replace(KEPLER, mass=1.01)},
    "space": {"system": ORBITS, "wrong": dataclasses.replace(ORBITS, j2=2e-3)},
    "no truth": {"truth": None, "perturbation": None},
    "neither energy": {"truth": None, "perturbation": None, "energy": None},
    "exact": {"wrong": None},
    "lost": {"flow": lambda x, dt: x * 1e40 * dt},
    "map": {"integrator": None, "energy": None},
}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.sampled(3)
def test_every_case_draws_what_it_can(tmp_path, name):
    case = make_case(tmp_path, **CASES[name])
    figures = open_loop_figures(case, open_loop(case).arrays)
    assert next(iter(figures)) == "error"
    assert ("energy" in figures) == (name != "neither energy")
    write_figures(tmp_path, figures)


@pytest.mark.parametrize("name", ["spring", "plane", "space"])
def test_of_measured_positions_no_velocity_and_no_energy_is_drawn(tmp_path, name):
    case = make_case(tmp_path, **CASES[name], truth=None, perturbation=None)
    fitted, states = case.test.states[:, 0], case.test.states.clone()
    states[..., case.space.dof :] = states[0, 5] = torch.nan
    case = dataclasses.replace(case, fitted=fitted, test=case.test._replace(states=states))
    figures = open_loop_figures(case, open_loop(case).arrays)
    assert figures.keys() == {"error"} | {"plane": {"path"}, "space": {"orbit"}}.get(name, set())
    (panel,) = figures["error"].axes
    assert panel.get_ylabel().startswith("position error")
    assert panel.get_title().endswith("fitted start")
    write_figures(tmp_path, figures)


def test_the_error_is_drawn_over_the_times_of_the_data(tmp_path):
    case = make_case(tmp_path)
    later = dataclasses.replace(case, test=case.test._replace(times=case.test.times + 4e5))
    axis = style.time_axis(later)
    assert axis.unit == "s"
    assert torch.allclose(axis.time, SPRING.dt * torch.arange(SPRING.steps + 1.0).double(), atol=1e-9)
    panels = open_loop_figures(case, open_loop(case).arrays)["error"].axes
    labels = {line.get_label() for line in panels[0].get_lines()}
    assert labels == {"model of mine", "floor: exact field, rk4"}
    assert [axes.get_ylabel() for axes in panels] == ["position error [m]", "velocity error [m/s]"]


def test_errors_of_trajectories_with_times_of_their_own_are_pooled_in_time(tmp_path):
    """Trajectories that last longer and longer, each sample off by its time, and so are means."""
    case = make_case(tmp_path)
    count, samples = case.test.times.shape
    times = case.test.times * (1 + torch.arange(count).double()).unsqueeze(1)
    off = torch.zeros_like(case.test.states)
    off[..., 0] = times
    uneven = dataclasses.replace(case, test=case.test._replace(times=times), dt=times.diff(dim=1))
    (panel, _) = error(uneven, [Curve(case.test.states + off, "off", style.MODEL)]).axes
    ((drawn_times, drawn),) = (line.get_data() for line in panel.get_lines())
    assert len(drawn) == samples - 1
    assert float(drawn_times[-1]) == pytest.approx(float(times[-1, -1]), rel=0.05)
    assert drawn == pytest.approx(np.asarray(drawn_times), rel=0.05, abs=0.1)
    own = energy(uneven, [Curve(case.test.states, "exact", style.MODEL)]).axes[0].get_lines()[0].get_xdata()
    assert own == pytest.approx(times[0].numpy())


@given(st.integers(1, 6), st.integers(2, 9), st.integers(0, 99))
def test_at_equal_times_neighbours_are_the_samples_of_one_time(count, samples, seed):
    values = torch.rand(count, samples, generator=generator(seed), dtype=torch.float64)
    clock = torch.arange(samples, dtype=torch.float64)
    time, mean = in_time(clock.expand(count, -1), values)
    close(time, clock, 1e-15)
    close(mean, values.mean(0), 1e-14)
    nothing, lost = in_time(clock.expand(count, -1), torch.full_like(values, torch.nan))
    assert len(nothing) == len(lost) == 0
