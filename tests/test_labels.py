"""Momenta are called velocities only where they are mass times velocity: in tables, files and pictures."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import final

import numpy as np
import pytest
import torch
from cases import MODEL, SPACE, SPRING, make_results, scores

from ahnn import labels
from ahnn.assimilation.stream_figures import deviations
from ahnn.data.files.object_name import numbered
from ahnn.data.files.source import Files
from ahnn.data.reference import Reference
from ahnn.data.starts import Starts, starts
from ahnn.deviations import state_deviations
from ahnn.errors import UserError
from ahnn.evaluation import Row, style
from ahnn.evaluation.results import decoded, encoded
from ahnn.evaluation.score_table import results_table
from ahnn.evaluation.seed_summary import seeds_table
from ahnn.measurements import reading
from ahnn.prediction.ephemeris_message import ephemerides, require_orbit
from ahnn.prediction.figure import prediction_figure
from ahnn.prediction.prediction_table import columns
from ahnn.prediction.propagation import Prediction
from ahnn.prediction.summary import summary
from ahnn.systems import CartPole, MassSpring, MolniyaGravity
from ahnn.types import Space, Units

ARMS = Space("arms", ("a", "b", "pa", "pb"), Units("s", "rad", "rad/s", "J"), 3.0, mechanical=False)
UNIT = "kg m²/s"


@final
@dataclass(frozen=True, kw_only=True)
class Fast(MassSpring):
    """A spring whose kinetic energy is no p^2 / 2m."""

    def velocity(self, p):
        return p / (1 + p * p).sqrt()


def test_a_system_knows_whether_its_momenta_are_mass_times_velocity():
    orbit = {"name": "o", "dt": 60.0, "steps": 10}
    assert SPRING.space.mechanical
    assert MolniyaGravity(**orbit).space.mechanical
    assert not MolniyaGravity(**orbit, order=2, rotation=7.29e-5).space.mechanical
    assert not Fast(name="fast", dt=0.1, steps=2).space.mechanical


@pytest.mark.parametrize(
    ("units", "inertia", "expected"),
    [
        (("s", "rad", "rad/s", "J"), 1.0, "kg m²/s"),
        (("s", "m", "m/s", "J"), 1.0, "kg m/s"),
        (("s", "km", "km/s", "km²/s²"), 1.0, "km/s"),
        (("s", "km", "km/s", "km²/s²"), 2.0, "km/s · mass"),
        (("1", "1", "1", "1"), 2.0, "1"),
        (("d", "m", "m/d", "kJ"), 1.0, "kJ d/m"),
    ],
)
def test_a_momentum_has_a_unit_of_its_own(units, inertia, expected):
    space = Space("s", ("q", "p"), Units(*units), inertia, mechanical=False)
    assert labels.quantity(space, "velocity") == ("momentum", expected)
    assert labels.quantity(space._replace(mechanical=True), "velocity") == ("velocity", units[2])
    assert labels.components(space) == [f"q [{units[1]}]", f"p [{expected}]"]


def texts(figure):
    """All that is written in a figure."""
    import matplotlib.text

    return " ".join(text.get_text() for text in figure.findobj(matplotlib.text.Text))


def test_no_door_calls_them_velocities_nor_divides_them():
    results = make_results(Row(MODEL, scores(1.0, 2.0)), space=ARMS)
    case = SimpleNamespace(space=ARMS)
    states = torch.arange(24, dtype=torch.float64).reshape(1, 6, 4)
    prediction, begin = (
        Prediction(torch.arange(6.0), states),
        Starts(numbered(1), states[:, 0], torch.zeros(1)),
    )
    table = columns(prediction, begin, ARMS)
    record = SimpleNamespace(time=np.arange(3.0), covariance=np.tile(np.eye(4), (3, 1, 1)))
    panels = [SimpleNamespace(set_ylabel=lambda text: said.append(text)) for _ in range(2)]
    said: list[str] = []
    style.label_errors(case, panels)  # pyright: ignore[reportArgumentType] - its space is all that it reads
    written = {
        "table": results_table(results, detail=True),
        "seeds": "\n".join(seeds_table([results])),
        "columns": " ".join(table),
        "summary": summary(prediction, begin, ARMS, "arms"),
        "picture": texts(prediction_figure(prediction, ARMS, "arms")),
        "errors": " ".join(said),
        "states": " ".join(style.state_labels(case)),  # pyright: ignore[reportArgumentType]
        "beliefs": texts(deviations(record, ARMS)),  # pyright: ignore[reportArgumentType]
        "state": " ".join(reading("state", ARMS).units),
    }
    for door, text in written.items():
        assert UNIT in " ".join(text.split()), door
        assert not {"velocity", "rad/s", "/ m", "/m"} & {*text.replace("[", " ").split()}, door
        assert "velocit" not in text, door
    assert table[f"pa [{UNIT}]"].tolist() == states[0, :, 2].tolist()
    assert state_deviations([1.0, 2.0], ARMS, "sd").tolist() == [1.0, 1.0, 2.0, 2.0]
    # Of a mechanical space they are velocities, as before.
    assert "velocity" in results_table(make_results(Row(MODEL, scores(1.0, 2.0)), space=SPACE))
    assert state_deviations([1.0, 2.0], ARMS._replace(mechanical=True), "sd")[2:].tolist() == [6.0, 6.0]


def test_results_keep_what_they_are_and_those_of_earlier_versions_are_mechanical():
    content = encoded(make_results(Row(MODEL, scores(1.0, 2.0)), space=ARMS))
    assert decoded(content).space == ARMS
    del content["mechanical"]
    assert decoded(content).space == ARMS._replace(mechanical=True)


def test_velocities_are_neither_read_nor_written_in_their_place(tmp_path):
    (tmp_path / "a.csv").write_text("t,q,v\n0,1,2\n1,2,3\n")
    (tmp_path / "b.csv").write_text("t,q,p\n0,1,2\n1,2,3\n")
    space = Space("fast", ("q", "p"), mechanical=False)
    with pytest.raises(UserError, match="expected momenta equal to mass times velocity; received fast"):
        starts(str(tmp_path / "a.csv"), space)
    assert starts(str(tmp_path / "b.csv"), space).states.tolist() == [[1.0, 2.0]]
    orbit = Space("o", tuple("xyzabc"), Units("s", "km", "km/s", "km²/s²"), mechanical=False)
    with pytest.raises(UserError, match="oem: expected momenta equal to mass times velocity"):
        require_orbit(orbit, Reference(), "oem")
    with pytest.raises(UserError, match="output: expected momenta equal to mass times velocity"):
        ephemerides(Prediction(torch.zeros(1), torch.zeros(1, 1, 6)), starts([0.0] * 6, orbit), orbit)
    assert Files("f", str(tmp_path / "a.csv")).space.mechanical


def test_angles_beside_lengths_have_a_unit_of_their_own():
    space = CartPole(name="c", dt=0.1, steps=2).space
    expected = ["x [m]", "theta [rad]", "px [kg m/s]", "ptheta [kg m²/s]"]
    assert labels.components(space) == expected
    assert labels.headed(space, "position") == "position [m, rad]"
    assert labels.headed(space, "velocity") == "momentum [kg m/s, kg m²/s]"
    joint = Space("joint", ("x", "a", "px", "pa"), Units("s", "m", "m/s", "J"), angles=("a",))
    assert labels.components(joint)[1::2] == ["a [rad]", "pa [rad/s]"]
    assert labels.physical_components(joint) == ["x [m]", "a [rad]", "vx [m/s]", "va [rad/s]"]


def test_momenta_of_different_masses_are_divided_each_by_its_own():
    space = Space("pair", ("x", "y", "px", "py"), Units("s", "m", "m/s", "J"), inertia=(1.0, 10.0))
    assert labels.components(space) == ["x [m]", "y [m]", "px [m/s]", "py / m [m/s]"]
    assert [float(one) for one in space.scales] == [1.0, 1.0, 1.0, 10.0]
