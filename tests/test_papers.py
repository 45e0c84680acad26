"""Citations: every option has papers or is known to have none, and a run names those of its methods."""

from __future__ import annotations

import re
import unicodedata
from pathlib import Path

import pytest
from entry import untouched
from hydra import compose, initialize_config_dir

import ahnn
from ahnn.cli.build import plain_config
from ahnn.integrators import INTEGRATORS
from ahnn.papers import PAPERS, cited, entries, methods
from ahnn.paths import conf_dir

OPTIONS = {
    group: sorted(path.stem for path in (conf_dir() / group).glob("*.yaml"))
    for group in ("model", "integrator", "plugins", "optimizer")
}
KINDS = {"AHNN": "hamiltonian", "LNN": "lagrangian", "MLP": "map", "NODE": "node"}


def used(*overrides):
    """Methods of a training with some options."""
    with untouched(), initialize_config_dir(str(conf_dir()), version_base="1.3"):
        config = plain_config(compose("train", ["folder=.", "plugins=none", *overrides]))
    model = config["model"]
    kind = KINDS.get(model["_target_"].rpartition(".")[2]) or model["kind"]
    return methods({**model, "kind": kind}, config)


def test_each_integrator_is_in_the_table():
    assert {*OPTIONS["integrator"]} == {*INTEGRATORS} <= PAPERS.keys()


@pytest.mark.sampled(8)
@pytest.mark.parametrize(
    "option", [f"{group}={one}" for group in ("model", "optimizer", "plugins") for one in OPTIONS[group]]
)
def test_each_option_of_a_group_is_in_the_table(option):
    found = used(option)
    assert {*found} <= PAPERS.keys()
    named = {"ukf", "ckf", "Chaos", "Attraction", "Horizon"} | {
        one for one in PAPERS if one.endswith(("Filter", "Models"))
    }
    assert bool(named & {*found}) == (option.startswith("plugins") and option != "plugins=none")


def test_the_table_and_the_entries_name_the_same_papers():
    assert {key for keys in PAPERS.values() for key in keys} == entries().keys()
    for key, paper in entries().items():
        assert {"author", "title", "year"} <= paper.fields.keys(), key
        assert paper.fields["year"] == re.sub(r"\D", "", key)
        assert paper.bibtex.count("{") == paper.bibtex.count("}")
        first = unicodedata.normalize("NFD", paper.fields["author"].split(",")[0]).lower()
        assert re.sub("[^a-z]", "", first).startswith(key.rstrip("0123456789")), key
        assert not set("{}\\") & set(str(paper))


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("overrides", "keys"),
    [
        (["model=sympnet"], {"jin2020"}),
        (["model=srnn"], {"chen2020", "hairer2006"}),
        (["model=lnn", "integrator=dopri8"], {"cranmer2020", "prince1981"}),
        (["model=gp_hamiltonian"], {"rahimi2007", "tanaka2022", "ross2023"}),
        (["recipe=dense_states"], {"bortz2023", "messenger2021", "transtrum2012"}),
        (["recipe=measurements"], {"golub1973"}),
        (["recipe=first_order"], {"loshchilov2019", "kim2024"}),
        (["forces=friction"], {"vanderschaft2014"}),
        (["plugins=enkf"], {"evensen1994", "whitaker2002"}),
        (["plugins=ukf_iterated"], {"wan2000", "vandermerwe2001", "sarkka2008", "garcia2017"}),
        (["plugins=particle", "plugins.particle.estimator.proposal=ukf"], {"gordon1993", "vandermerwe2000"}),
    ],
)
def test_options_bring_their_papers(overrides, keys):
    assert keys <= cited(used(*overrides)).methods.keys()


def test_a_pruner_and_means_of_steps_are_methods_where_they_act():
    pruner = {"_target_": "ahnn_plugins.pfl.PFLCallback"}
    callbacks = {"pfl": pruner, "mean": {"_target_": "ahnn.EpochMean", "fraction": 0.5}, "last": None}
    assert {"PFLCallback", "mean of steps"} <= {*methods({"kind": "node"}, {"callbacks": callbacks})}
    off = {"pfl": None, "mean": {"_target_": "ahnn.EpochMean", "fraction": 0.0}}
    assert methods({"kind": "node"}, {"callbacks": off}) == ["ahnn", "node"]


def test_a_map_cites_no_integrator_and_no_hamiltonian():
    found = cited(used("model=mlp"))
    assert not {"greydanus2019", "kutta1901"} & found.methods.keys()


def test_a_shipped_model_cites_its_method_as_text_and_bibtex():
    found = ahnn.citations("molniya_mechanical")
    keys = ["greydanus2019", "kim2025", "kutta1901", "marquardt1963"]
    assert [paper.key for paper in found.papers] == keys == re.findall(r"@\w+\{(\w+)", found.bibtex)
    assert "[rk4] Kutta, Wilhelm (1901)." in str(found)


def test_dynamics_of_ones_own_loop_cite_what_they_are(tmp_path):
    space = ahnn.Space("oscillator", ("q", "p"))
    model = ahnn.Hamiltonian(dof=1, hidden=4, integrator="gl4")
    run = ahnn.save(model, space, dt=0.1, folder=tmp_path / "run")
    assert [paper.key for paper in ahnn.citations(run).papers] == ["greydanus2019", "hairer2006", "kim2025"]


def test_the_paper_cites_entries_that_exist_and_agree_with_those_of_the_package():
    folder = Path(__file__).parents[1] / "paper"
    bib = re.findall(r"^@.*?^}", (folder / "paper.bib").read_text(), re.MULTILINE | re.DOTALL)
    found = {entry[entry.index("{") + 1 : entry.index(",")]: entry for entry in bib}
    assert {*re.findall(r"@(\w+)", (folder / "paper.md").read_text())} == found.keys()
    assert all(entries()[key].bibtex == entry for key, entry in found.items() if key in entries())
