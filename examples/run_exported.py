"""An exported model without ahnn: `python examples/run_exported.py FOLDER` needs onnxruntime and numpy."""

import json
import sys
from pathlib import Path

import numpy as np
import onnxruntime

folder = Path(sys.argv[1])
about = json.loads((folder / "model.json").read_text())
options = onnxruntime.SessionOptions()  # further optimisations would round some factors to single precision
options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_ENABLE_BASIC
flow = onnxruntime.InferenceSession(folder / "flow.onnx", options, providers=["CPUExecutionProvider"])
states = np.array([[0.0, -3145.0, -6173.0, 10.0, 0.0, 0.0]])  # in the units of about["space"]
for _ in range(60):
    (states,) = flow.run(None, {"states": states})
names = about["space"]["components"]
print(60 * about["dt"], about["space"]["units"]["time"], dict(zip(names, states[0].tolist(), strict=True)))
