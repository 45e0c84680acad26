"""Predict a day of a Molniya orbit with a model that comes with the package: `python load_and_predict.py`."""

import ahnn

run = ahnn.load("molniya_central_body")  # or a run folder, "runs/mine"
start = [[0.0, -3145.0, -6173.0, 10.0, 0.0, 0.0]]  # at periapsis: x, y, z in km, momenta of 1 kg in km/s
orbit = run.rollout(start, steps=1440)  # (1, 1441, 6) float64, a step each minute
energy = run.energy(orbit)
print(run.space.components, run.dt, run.space.units.time)
print("farthest from the Earth's centre [km]:", round(float(orbit[0, :, :3].norm(dim=1).max())))
print("drift of the learned energy:", f"{float((energy - energy[:, :1]).abs().max()):.0e}")
print("position error on unseen orbits [km]:", run.results.rows[0].scores.position)
