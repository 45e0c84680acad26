"""Modes as YAML has them: a known system beside the model, from a run of somebody else too."""

from __future__ import annotations

import pytest
from evaluating import composed

from ahnn.cli.build import build_all
from ahnn.cli.trust import require_trusted
from ahnn.errors import UserError
from ahnn.systems import MassSpring

SYSTEM = {"_target_": "ahnn.systems.MassSpring", "name": "known", "dt": 0.04, "steps": 40}


def group(modes):
    cfg = composed("imm", "position").copy()
    cfg.plugins.imm.estimator.modes = modes
    return cfg.plugins


def test_a_mode_takes_a_system_that_is_known():
    (plugin,) = build_all(group([{"factor": 2.0}, {"beside": SYSTEM}]), "plugins").values()
    quiet, known = plugin.estimator.modes
    assert quiet.factor == 2.0
    assert isinstance(known.beside, MassSpring)
    assert plugin.estimator.about["modes"][1]["beside"]["name"] == "known"


def test_a_wrong_mode_is_named(tmp_path):
    with pytest.raises(UserError, match=r"modes\.1: unknown key 'facto'"):
        build_all(group([{}, {"facto": 2.0}]), "plugins")
    content = {"plugins": {"imm": {"estimator": {"modes": [{}, {"beside": SYSTEM}]}}}}
    require_trusted(tmp_path, content, ("plugins",))
    content["plugins"]["imm"]["estimator"]["modes"][1]["beside"] = {"_target_": "os.system"}
    with pytest.raises(UserError, match=r"modes\.beside\._target_: os\.system"):
        require_trusted(tmp_path, content, ("plugins",))
