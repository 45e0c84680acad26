"""Benchmark tasks with published scores, regenerated from the descriptions in their papers."""

from ahnn.tasks import flow_maps, one_orbit, three_points
from ahnn.tasks.bodies import THREE, TWO
from ahnn.tasks.chains import chain
from ahnn.tasks.comparison import table
from ahnn.tasks.definition import Draw, FieldTask, Predict
from ahnn.tasks.noisy_oscillators import PENDULUM, SPRING

TASKS: dict[str, FieldTask] = {
    "two_bodies": TWO,
    "three_bodies": THREE,
    "noisy_spring": SPRING,
    "noisy_pendulum": PENDULUM,
    "chain_2": chain(2, 5.9e-5, NODE=6.5e-2, HNN=1.9e-3, CHNN=1.2e-4),
    "chain_3": chain(3, 1.1e-4, NODE=0.27, HNN=4.7e-2, CHNN=3.4e-4),
    "chain_5": chain(5, 1.5e-4, NODE=0.44, HNN=0.34, CHNN=1.1e-3),
    "one_orbit": one_orbit.TASK,
    **three_points.TASKS,
    **flow_maps.TASKS,
}

__all__ = ["TASKS", "Draw", "FieldTask", "Predict", "table"]
