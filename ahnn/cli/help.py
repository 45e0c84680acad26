"""Help texts, commented YAML of options, and bash completion."""

from __future__ import annotations

import importlib.resources
import sys
import textwrap
from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path

from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra.types import RunMode
from omegaconf import OmegaConf

from ahnn.arguments import nearest
from ahnn.cli.commandline import config_loader, parse
from ahnn.errors import UserError

ABOUT = """\
Train a model of Hamiltonian dynamics and evaluate it.

usage: python -m ahnn.train [GROUP=OPTION ...] [KEY=VALUE ...]

  python -m ahnn.train                                    # AHNN on a spring
  python -m ahnn.train model=hnn system=molniya seed=201
  python -m ahnn.train experiment=molniya_mechanical budget=smoke
  python -m ahnn.train -m model=hnn,node seed=7,201       # four jobs, one table
  python -m ahnn.train model=hnn run=runs/mine ckpt=last  # resume

Groups and their options, defaults in [brackets]:

"""
MORE = """
recipe, model, system, sweep and experiment choose options of other groups as
well; the command line takes precedence.

  ckpt=last             resume a run: repeat its command with this added
  --help GROUP=OPTION   the keys of an option with their comments
  --cfg job             configuration; --resolve resolves references
  -m                    several jobs: all combinations of KEY=A,B, or a sweep=
  --config-dir DIR      your own options: DIR/system/mine.yaml
  -sc install=bash      completion: eval "$(ahnn-train -sc install=bash)"
  --hydra-help          further Hydra options
"""
COMPLETION = """\
_ahnn_train() {
    local line="$COMP_LINE"
    if [[ "$line" == *python*" -m "* ]]; then
        [[ "$line" == *" -m ahnn.train"* ]] || return
        line="ahnn-train${line#*-m ahnn.train}"
    fi
    local choices; choices=$(COMP_LINE="$line" PYTHON -m ahnn.train -sc query=bash 2>/dev/null)
    COMPREPLY=($(compgen -W "$choices" -- "${COMP_WORDS[COMP_CWORD]}"))
}
COMP_WORDBREAKS=${COMP_WORDBREAKS//=}
complete -o nospace -o default -F _ahnn_train ahnn-train python python3
"""


def show_help(args: Namespace) -> None:
    """Print the help, or the YAML of named options.

    Raises:
        UserError: unknown option.
    """
    loader = config_loader(args.config_dir)
    for override in map(parse, args.overrides):
        text = option_text(loader, override.key_or_group, str(override.value()))
        sys.stdout.write("\n".join(text) + "\n")
    if not args.overrides:
        sys.stdout.write(ABOUT + "\n".join(group_lines(loader)) + "\n" + MORE)


def group_lines(loader: ConfigLoaderImpl) -> Iterator[str]:
    """Yield each group with its options, with defaults in brackets."""
    chosen = loader.load_configuration("train", [], RunMode.RUN).hydra.runtime.choices
    defaults = {str(key).partition("@")[0]: name for key, name in chosen.items()}
    for group in loader.list_groups(""):
        if group == "hydra":
            continue
        options = loader.get_group_options(group)
        marked = [f"[{name}]" if name == defaults.get(group) else name for name in options]
        yield from textwrap.wrap(
            " ".join(marked), 79, initial_indent=f"  {group:12s} ", subsequent_indent=" " * 15
        )


def option_text(loader: ConfigLoaderImpl, group: str, option: str) -> Iterator[str]:
    """Yield the YAML of an option, preceded by the YAML of its base options.

    Raises:
        UserError: unknown option.
    """
    name = f"{group}/{option}.yaml"
    for source in loader.get_sources():
        if not source.is_config(name):
            continue
        package = source.scheme() == "pkg"
        place = importlib.resources.files(source.path.replace("/", ".")) if package else Path(source.path)
        text = place.joinpath(name).read_text(encoding="utf-8")
        for entry in OmegaConf.create(text).get("defaults", []):  # pyright: ignore
            if isinstance(entry, str) and entry != "_self_":
                yield from option_text(loader, group, entry)
        yield f"# {name} of {source.path}\n{text}"
        return
    options = loader.get_group_options(group)
    message = f"{group}: unknown option {option!r}{nearest(option, options or loader.list_groups(''))}"
    raise UserError(message)


def show_completion(args: Namespace) -> bool:
    """Print the bash completion function if requested; return whether it was."""
    if args.overrides != ["install=bash"]:
        return False
    sys.stdout.write(COMPLETION.replace("PYTHON", sys.executable))
    return True
