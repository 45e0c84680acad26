"""Figures say what the arrays say: energies, errors, bands, scores; what has no data is left out."""

from __future__ import annotations

import pytest
import torch
from safetensors.torch import load_file, save_file
from synthetic_runs import ORBITS, SPRING, arrays, results, run, write

from ahnn.errors import UserError
from ahnn.metrics import moving_average
from ahnn.systems import HenonHeiles, MolniyaGravity, Pendulum
from ahnn.systems.gravity import ggm05c
from ahnn.types import Space
from ahnn_plugins.report.collection import collect
from ahnn_plugins.report.drawing import Drawing, Series
from ahnn_plugins.report.figures import draw
from ahnn_plugins.report.figures.accelerations import reference_orbit, terms
from ahnn_plugins.report.figures.equations import system_of
from ahnn_plugins.report.figures.models import slots


@pytest.fixture(scope="module")
def orbits(tmp_path_factory):
    folder = tmp_path_factory.mktemp("orbits")
    run(folder, ORBITS, "HNN")
    run(folder, ORBITS, "AHNN5")
    return folder


def drawn(*folders) -> dict[str, Drawing]:
    return {drawing.name: drawing for drawing in draw(collect(folders))}


def labelled(drawing: Drawing, label: str, panel: int = 0) -> Series:
    (found,) = [series for series in drawing.panels[panel].series if series.label == label]
    return found


def test_springs_have_the_figures_of_the_paper(springs):
    names = [name.removeprefix("mass_spring_") for name in drawn(springs)]
    averages = [f"averages_{prefix}{start}" for prefix in ("", "ukf_") for start in ("true", "perturbed")]
    scores = ["rmse_true", "rmse_perturbed", "windows"]
    assert names == [*scores, "phase_portrait", "energy", *averages, "ukf_state", "ukf_error", "nees"]


def test_orbits_have_those_of_components_and_of_accelerations_too(orbits):
    figures = drawn(orbits)
    components = {"averages_true_components", "averages_ukf_perturbed_components", "orbits"}
    assert {f"molniya_{name}" for name in components} | {"perturbing_accelerations"} <= figures.keys()
    orbit = figures["molniya_orbits"]
    assert orbit.kind == "orbit"
    assert [s.label for s in orbit.panels[0].series] == ["HNN", "AHNN5", "truth"]
    assert orbit.panels[0].radius == ORBITS.r_eq
    assert (orbit.panels[0].x, orbit.panels[0].z) == ("x [km]", "z [km]")
    units = [panel.y for panel in figures["molniya_averages_true_components"].panels]
    assert units == [*(f"error of {n} [km]" for n in "xyz"), *(f"error of p{n} [km/s]" for n in "xyz")]


def test_hover_of_an_orbit_has_time_altitude_and_error(orbits):
    series = labelled(drawn(orbits)["molniya_orbits"], "HNN")
    kept = load_file(orbits / "HNN_7" / "predictions.safetensors")
    model, truth = kept["true_start"][0, :, :3], kept["truth"][0, :, :3]
    told = series.hover
    at = (told["time [h]"] * 60).round().long()  # a sample a minute
    assert len(at) == len(series.x) <= 720
    torch.testing.assert_close(told["altitude [km]"], model[at].norm(dim=-1) - ORBITS.r_eq)
    torch.testing.assert_close(told["error [km]"], (model - truth)[at].norm(dim=-1))
    distance = truth.norm(dim=-1)
    assert labelled(drawn(orbits)["molniya_orbits"], "truth").hover["altitude [km]"].min() == (
        distance.min() - ORBITS.r_eq
    )


def test_energies_are_those_of_the_system(springs):
    figure = drawn(springs)["mass_spring_energy"]
    kept = load_file(springs / "AHNN5_7" / "predictions.safetensors")
    energy = SPRING.energy(kept["true_start"][0])
    series = labelled(figure, "AHNN5")
    torch.testing.assert_close(series.y, energy, rtol=1e-15, atol=0)
    torch.testing.assert_close(series.x, SPRING.dt * torch.arange(61.0).double())
    off = (energy - SPRING.energy(kept["truth"][0])).abs()
    below = labelled(figure, "AHNN5", 1).y
    torch.testing.assert_close(below[1:], off[1:])
    assert bool(below[0].isnan())  # 0 has no place on a log axis
    assert [panel.y for panel in figure.panels] == ["energy [J]", "energy error [J]"]


@pytest.mark.parametrize(("name", "key"), [("ukf_perturbed", "ukf/perturbed_start"), ("true", "true_start")])
def test_averages_are_means_over_seeds_of_the_last_240_samples(springs, name, key):
    figure = drawn(springs)[f"mass_spring_averages_{name}"]
    found = []
    for seed in (7, 201):
        kept = load_file(springs / f"AHNN5_{seed}" / "predictions.safetensors")
        velocity = (kept[key] - kept["truth"])[..., 1] / SPRING.mass
        found.append(moving_average(velocity.square().mean(0).sqrt(), 240))
    mean = torch.stack(found).mean(0)
    series = labelled(figure, "AHNN5 + UKF" if "ukf" in name else "AHNN5", 1)
    assert series.low is not None
    assert series.high is not None
    torch.testing.assert_close(series.y[1:], mean[1:])
    torch.testing.assert_close(series.low[1:], torch.stack(found).amin(0)[1:])
    torch.testing.assert_close(series.high[1:], torch.stack(found).amax(0)[1:])


def test_the_floor_of_a_filter_is_the_kept_average(springs):
    figure = drawn(springs)["mass_spring_averages_ukf_true"]
    assert labelled(figure, "floor + UKF").y.unique().tolist() == [1e-6]


def test_a_filter_stands_in_its_band_with_its_updates(springs):
    figure = drawn(springs)["mass_spring_ukf_error"]
    series, updates = figure.panels[0].series
    deviation = load_file(springs / "AHNN5_7" / "predictions.safetensors")["ukf/perturbed_sawtooth_deviation"]
    torch.testing.assert_close(series.high, 3 * deviation[:, 0])
    torch.testing.assert_close(series.low, -3 * deviation[:, 0])
    torch.testing.assert_close(updates.x, torch.tensor([0.2, 0.4, 0.6]).double())
    assert float(updates.y.abs().max()) == 0.0
    state = drawn(springs)["mass_spring_ukf_state"]
    assert [panel.y for panel in state.panels] == ["q [m]", "p / m [m/s]"]
    assert "Test trajectory 2 of AHNN5_7" in state.caption


def test_a_model_has_one_slot_in_every_figure(springs, orbits):
    collection = collect([springs, orbits])
    assert slots(collection) == {"MLP": 4, "HNN": 2, "AHNN3": 1, "AHNN5": 0}
    for drawing in draw(collection):
        for series in (series for panel in drawing.panels for series in panel.series):
            if series.role in ("model", "filter"):
                model = series.label.partition(" ")[0].partition(":")[0]
                assert series.slot == slots(collection)[model], drawing.name


# Magnitudes in km/s^2 at true anomalies of 0, 60, 120 and 180 degrees, to their printed digits.
REFERENCE = {
    "two-body": (8.3043e-3, 5.1267e-3, 1.0592e-3, 1.6948e-4),
    "J2": (1.8419e-5, 3.8962e-6, 1.6632e-7, 7.6716e-9),
    "J3": (4.41e-8, 8.79e-9, 1.71e-10, 2.63e-12),
    "J4": (2.65e-8, 4.29e-9, 3.78e-11, 2.25e-13),
    "J5": (3.44e-9, 4.61e-10, 1.85e-12, 4.2e-15),
    "J6": (7.99e-9, 9.21e-10, 1.68e-12, 1.4e-15),
    "J7": (5.35e-9, 4.38e-10, 3.6e-13, 1.3e-16),
    "J8": (3.22e-9, 1.96e-10, 7.4e-14, 1.1e-17),
    "tesserals": (7.85e-8, 1.67e-8, 1.70e-9, 1.66e-11),
}


def test_accelerations_along_the_reference_orbit():
    field = ggm05c()
    q = reference_orbit(torch.tensor([0.0, 60.0, 120.0, 180.0]).double(), field.radius)
    parts = terms(field)
    assert parts.keys() == REFERENCE.keys()
    for name, expected in REFERENCE.items():
        for value, known in zip(parts[name].attraction(q).norm(dim=-1).tolist(), expected, strict=True):
            digits = len(f"{known:e}".partition("e")[0].rstrip("0").replace(".", ""))
            assert value == pytest.approx(known, rel=0.51 * 10.0 ** (1 - digits)), name
    whole = torch.stack([part.attraction(q) for part in parts.values()]).sum(0)
    torch.testing.assert_close(whole, field.attraction(q), rtol=1e-13, atol=0)


def test_data_without_equations_have_neither_energy_nor_floor(tmp_path):
    space = Space("mine", SPRING.components, SPRING.units, SPRING.inertia)
    kept = {
        key: value for key, value in arrays(SPRING, "HNN", 7).items() if "/" not in key and "floor" not in key
    }
    write(tmp_path / "a", results(space, "HNN", 7, truth=False), kept, {"_target_": "ahnn.data.files.Files"})
    figures = drawn(tmp_path)
    assert not {"mine_energy", "mine_nees", "mine_ukf_state", "perturbing_accelerations"} & figures.keys()
    assert [s.label for s in figures["mine_phase_portrait"].panels[0].series] == ["HNN", "test data"]
    assert "mine_error_true" in figures  # of a single run, sample by sample


def test_measured_trajectories_are_called_measurements(tmp_path):
    states = arrays(SPRING, "HNN", 7)
    measured = states["truth"].clone()
    measured[:, 1::2] = torch.nan
    kept = {"measurements": measured, "times": states["times"], "fitted_start": states["true_start"]}
    write(tmp_path / "a", results(SPRING.space, "HNN", 7, truth=False), kept, None)
    figures = drawn(tmp_path)
    assert "mass_spring_averages_fitted" in figures
    assert figures["mass_spring_phase_portrait"].panels[0].series[-1].label == "measurements"


def test_other_test_trajectories_are_left_out_and_named(tmp_path):
    for model in ("MLP", "AHNN3", "AHNN5"):
        run(tmp_path, SPRING, model)
    path = tmp_path / "MLP_7" / "predictions.safetensors"
    save_file(
        {key: value * 2 if value.is_floating_point() else value for key, value in load_file(path).items()},
        path,
    )
    figure = drawn(tmp_path)["mass_spring_energy"]
    assert [s.label for s in figure.panels[0].series] == ["AHNN3", "AHNN5", "floor", "truth"]
    assert "Omitted, since their test trajectories differ: MLP_7." in figure.caption


@pytest.mark.parametrize(
    "config",
    [
        "system: {_target_: os.system, command: 'touch here'}",
        "system: {_target_: ahnn.systems.MassSpring, name: mass_spring, dt: 0.01, steps: 60}",  # other mass
        "system: {_target_: ahnn.systems.MassSpring, name: mass_spring, dt: -1, steps: 60, mass: 2.0}",
        "system: {_target_: ahnn.systems.MassSpring, unknown: 3}",
        "system: {_target_: ahnn.systems.MolniyaGravity, name: g, dt: 60.0, steps: 9, gravity: /etc/passwd}",
        "system: {_target_: ahnn.systems.MassSpring, name: mass_spring, q0: [[[1]]]}",
        "system: !!python/object/apply:os.getcwd []",
        "just a text",
        "a: [",
    ],
)
def test_a_configuration_from_elsewhere_builds_nothing_else(tmp_path, config):
    folder = run(tmp_path, SPRING, "AHNN5")
    (folder / "config.yaml").write_text(config)
    (entry,) = collect([tmp_path]).entries
    assert system_of(entry) is None


@pytest.mark.parametrize(
    "system",
    [
        Pendulum(name="pendulum", dt=0.01, steps=60, gravity=3.7),
        HenonHeiles(name="henon_heiles", dt=0.05, steps=60),
        MolniyaGravity(name="molniya_gravity", dt=60.0, steps=60, degree=4),
    ],
)
def test_the_systems_of_this_library_are_known(tmp_path, system):
    run(tmp_path, system, "HNN")
    (entry,) = collect([tmp_path]).entries
    found, states = system_of(entry), arrays(system, "HNN", 7)["truth"]
    assert found is not None
    assert torch.equal(found.energy(states), system.energy(states))
    assert f"{system.name}_energy" in drawn(tmp_path)


def test_damaged_arrays_are_refused_by_name(tmp_path):
    path = run(tmp_path, SPRING, "AHNN5") / "predictions.safetensors"
    content = load_file(path)
    save_file(content | {"true_start": torch.zeros(3, 5, 2)}, path)
    with pytest.raises(UserError, match=r"true_start: expected shape \(3, 61, 2\); received \(3, 5, 2\)"):
        drawn(tmp_path)
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(UserError, match=r"predictions.safetensors: expected the arrays of an evaluation"):
        drawn(tmp_path)


def test_a_lost_prediction_is_cut_and_hides_nothing(tmp_path):
    path = run(tmp_path, ORBITS, "HNN") / "predictions.safetensors"
    content = load_file(path)
    content["true_start"][0, 100:] *= 1e6
    content["true_start"][0, 200:] = torch.inf
    save_file(content, path)
    series = labelled(drawn(tmp_path)["molniya_orbits"], "HNN")
    assert float(series.x.nan_to_num().abs().max()) < 1e5
    assert bool(series.x.isnan().any())
