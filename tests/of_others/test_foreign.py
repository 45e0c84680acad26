"""A run folder of somebody else: each of its fields is of its kind, or one message says which is not."""

from __future__ import annotations

import time
import zipfile

import pytest
import torch
from entry import call
from foreign import change, configured, doors, refused

import ahnn
from ahnn.checkpoints import Weights, read_weights, write_weights
from ahnn.errors import UserError

INF, NAN = float("inf"), float("nan")
ABOUT = [
    *(("dt", value) for value in (NAN, INF, 0.0, -0.01, "0.01", None, True, [0.01], ...)),
    *(("space", value) for value in ([], "q", None, ...)),
    *(
        ("space.units", value)
        for value in ([1, 2, 3, 4], "smve", ["s"], None, ["s\x1b[2J", "m", "m/s", "J"], ...)
    ),
    *(("space.inertia", value) for value in (0, -1.0, NAN, INF, "1", 2.0, ...)),
    *(("space.components", value) for value in (["q"], ["q", "q"], [1, 2], "qp", [], ["q", "p", "r", "s"])),
    *(("space.name", value) for value in (5, None, "x" * 1000)),
    ("space.frame", 5),
    *(("dynamics", value) for value in ("hamiltonian", [], None, {}, ...)),
    *(("dynamics.kind", value) for value in (5, [], "posix", "os.system", ...)),
    *(("dynamics.dof", value) for value in (0, -1, 1.5, "1", 10**9, 10**30, None, True)),
    *(("dynamics.inertia", value) for value in (0.0, NAN, "1", -1)),
    *(("dynamics.network", value) for value in (5, [], {}, {"width": 8})),
    *(("dynamics.network.width", value) for value in (10**6, 10**9, 10**40, 0, 8.5, 4)),
    *(("dynamics.network.depth", value) for value in (10**6, 10**30, 0, "2", 1)),
    *(("dynamics.network.activation", value) for value in ("os.system", 5)),
    *(
        ("dynamics.integrator", value)
        for value in ("rk4", {}, {"name": 5}, {"name": "gl4", "max_iterations": 10**9})
    ),
    *(("dynamics.scaling", value) for value in (5, "x")),
    ("dynamics.falloff", NAN),
    ("dynamics.more", 1),
    *(
        ("domain", value)
        for value in (5, [], {}, {"unit": 1.0, "states": []}, {"unit": NAN, "states": [[0.0, 1.0]]})
    ),
    *(("domain.states", value) for value in ([[1.0]], [["a", "b"]], [[NAN, 1.0]], [5])),
    *(("val_loss", value) for value in ("small", [1.0])),
    *(("data", value) for value in ("text", 5, {}, {"recipe": "x", "split": [0.8, 0.1, 0.1]})),
    *(("data.split", value) for value in (5, [0.5, 0.5], ["a", "b", "c"])),
    ("settings", 5),
]


@pytest.mark.parametrize(("path", "value"), ABOUT, ids=lambda value: str(value)[:30])
def test_a_field_beside_weights_is_of_its_kind(run, path, value):
    weights = read_weights(run / "weights.safetensors")
    write_weights(run / "weights.safetensors", weights._replace(about=change(weights.about, path, value)))
    began = time.monotonic()
    with pytest.raises(UserError) as told:
        ahnn.load(run)
    assert time.monotonic() - began < 1.0
    assert len(str(told.value)) < 1500
    assert str(told.value).isprintable()


@pytest.mark.parametrize(
    ("path", "value"), [("dt", NAN), ("space.units", [1, 2, 3, 4]), ("dynamics.dof", 10**9)]
)
def test_every_command_reads_them_so(run, tmp_path, capfd, path, value):
    weights = read_weights(run / "weights.safetensors")
    write_weights(run / "weights.safetensors", weights._replace(about=change(weights.about, path, value)))
    for command in doors(run, tmp_path).values():
        refused(command, capfd, f"run {run}: ")
    assert not {"exported", "out.csv"} & {path.name for path in tmp_path.iterdir()}
    assert not (run / "evaluations").exists()


def test_what_may_be_missing_may_be_missing(run, tmp_path):
    weights = read_weights(run / "weights.safetensors")
    about = {key: weights.about[key] for key in ("format", "dynamics", "space", "dt")}
    write_weights(run / "weights.safetensors", weights._replace(about=about))
    for name in ("predict", "evaluate"):
        assert call(*doors(run, tmp_path)[name]) == 0


TENSORS = {
    "complex": lambda state: {**state, "field.unit": torch.ones((), dtype=torch.complex128)},
    "text": lambda state: {**state, "field.unit": "1"},
    "sparse": lambda state: {**state, "field.unit": torch.ones(1).to_sparse()},
    "infinite": lambda state: {**state, "field.unit": torch.tensor(INF)},
    "one number for all": lambda state: {
        name: torch.ones(()).expand(10**9 if "weight" in name else 1) for name in state
    },
    "none": lambda _: {},
    "a name that is none": lambda state: {**state, 5: torch.ones(())},
}


@pytest.mark.parametrize("wrong", TENSORS)
def test_weights_are_real_numbers(run, wrong):
    weights = read_weights(run / "weights.safetensors")
    (run / "checkpoints").mkdir()
    state = {
        f"dynamics.{k}" if isinstance(k, str) else k: v for k, v in TENSORS[wrong](weights.state).items()
    }
    torch.save({"state_dict": state, "ahnn": weights.about}, run / "checkpoints" / "best.ckpt")
    with pytest.raises(UserError):
        ahnn.load(run)


def test_a_checkpoint_that_is_larger_inside_is_not_unpacked(run):
    (run / "checkpoints").mkdir()
    path = run / "checkpoints" / "best.ckpt"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a/data.pkl", bytes(50_000_000))
    with pytest.raises(UserError, match="records larger than the file"):
        ahnn.load(run)


def test_numbers_of_odd_types_are_no_traceback(run):
    weights = read_weights(run / "weights.safetensors")
    odd = {name: value.to(torch.bfloat16) for name, value in weights.state.items()}
    write_weights(run / "weights.safetensors", Weights(odd, weights.about))
    assert ahnn.load(run).dynamics.state_dict()["field.unit"].dtype == torch.float64


CONFIGURATIONS = {
    "empty": b"",
    "a list": b"- 1\n- 2\n",
    "a text": b"hello",
    "binary": bytes(range(256)),
    "UTF-16": "seed: 7".encode("utf-16"),
    "nested": b"x: " + b"[" * 5000 + b"]" * 5000,
    "nested less": b"system: " + b"{a: " * 150 + b"1" + b"}" * 150,
    "keys that are numbers": b"1: 2\nsystem: {}\n",
    "an alias": b"a: &a [1]\nb: *a\n",
    "an object": b"a: !!python/object/apply:os.system [exit]\n",
    "a date": b"system: 2024-01-01\n",
    "too large": b"# " + b"x" * 3_000_000,
}
NODES = [
    *(("data", value) for value in ("text", [], None, 5, ...)),
    *(("data.split", value) for value in (5, "a", ["a", "b", "c"], [0.5], None, [NAN, 0.1, 0.1], ...)),
    *(("data.seed", value) for value in (-1, "a", None, 1.5, [1])),
    *(("data.trajectories", value) for value in (0, "many", None, 10**15)),
    *(("data.noise", value) for value in ("loud", {}, -1.0, NAN)),
    *(("system", value) for value in ("text", [], None, {})),
    *(("system.dt", value) for value in (0, NAN, "a", None, [1])),
    *(("system.steps", value) for value in (-1, "a", 10**18)),
    *(("system.name", value) for value in (5, None, "a\x1b]0;owned\x07b")),
    *(("evaluation", value) for value in ("text", [], {}, None)),
    *(("evaluation.seed", value) for value in ("a", -1)),
    *(("plugins", value) for value in ([], "ukf", None, {"ukf": 5}, {"ukf": []})),
    *(("measurement", value) for value in ([], "position", None)),
    *(("label", value) for value in (5, None, ["a"], "a\x1b[2Jb")),
    *(("threads", value) for value in (0, "a", None, 10**9)),
]


@pytest.mark.parametrize("wrong", CONFIGURATIONS)
@pytest.mark.sampled(2)
def test_a_configuration_that_is_none_is_one_message(run, tmp_path, capfd, wrong):
    (run / "config.yaml").write_bytes(CONFIGURATIONS[wrong])
    for name in ("evaluate", "assimilate"):
        refused(doors(run, tmp_path)[name], capfd, str(run / "config.yaml"))
    if wrong != "keys that are numbers" and wrong != "nested less":
        with pytest.raises(UserError, match=r"config\.yaml"):
            _ = ahnn.load(run).config


@pytest.mark.parametrize(("path", "value"), NODES, ids=lambda value: str(value)[:30])
def test_a_field_of_a_configuration_is_of_its_kind(run, tmp_path, capfd, path, value):
    configured(run, path, value)
    refused(doors(run, tmp_path)["evaluate"], capfd, path.split(".")[path.endswith("split")])
    assert not (run / "evaluations").exists()


@pytest.mark.parametrize("path", ["data", "evaluation", "measurement", "label"])
def test_a_stream_reads_it_so_too(run, tmp_path, capfd, path):
    configured(run, path, ["a"])
    refused(doors(run, tmp_path)["assimilate"], capfd)
    assert not (tmp_path / "out.csv").exists()


def test_a_mark_of_the_byte_order_is_no_matter(run, tmp_path):
    path = run / "config.yaml"
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert call(*doors(run, tmp_path)["evaluate"]) == 0


@pytest.mark.parametrize(
    "text",
    ["", "[]", "5", "{", "[" * 99999, '{"schema": 2}', '{"schema": 2, "rows": 5, "units": []}', "\xff"],
)
def test_results_of_wrong_kinds_are_one_message(run, tmp_path, capfd, text):
    (run / "metrics.json").write_text(text, encoding="latin-1")
    refused(doors(run, tmp_path)["evaluate"], capfd, str(run / "metrics.json"))
    refused(("ahnn.report", str(run), f"output={tmp_path / 'report'}"), capfd, str(run / "metrics.json"))
    with pytest.raises(UserError, match=r"metrics\.json"):
        _ = ahnn.load(run).results
