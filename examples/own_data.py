"""Train on trajectories of one's own and judge the result: `python own_data.py`."""

import tempfile

import torch

import ahnn

t = 0.05 * torch.arange(121, dtype=torch.float64)  # s
a, phase = 0.5 + torch.rand(40, 1), 6.0 * torch.rand(40, 1)
q, p = a * torch.cos(2.0 * t + phase), -2.0 * a * torch.sin(2.0 * t + phase)
data = ahnn.Trajectories(torch.stack((q, p), dim=-1), t)  # (40, 121, 2), positions before momenta
space = ahnn.Space("cart", ("q", "p"), ahnn.Units("s", "m", "m/s", "J"))
options = ["model=hnn", "data.batch_size=500", "trainer.max_epochs=10"]  # as on the command line
run = ahnn.fit(data, space, options, folder=tempfile.mkdtemp() + "/cart")
print(run.results.rows[0].scores.position, "m over unseen trajectories")
print(run.rollout([1.0, 0.0], steps=100)[0, -1])  # the state 5 s later
