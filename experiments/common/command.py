"""How the studies' commands begin and end: help, threads, errors in one line, and the paths that were written."""

import argparse
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import yaml
from omegaconf.errors import OmegaConfBaseException

from regtorch.arguments import BAD_INPUT, Parser
from regtorch.errors import RegtorchError

CHECKOUT = """\
Studies run from a checkout of the repository, after pip install '.[studies]' there. The wheel holds neither conf/ nor
experiments/."""

_CONF = Path(__file__).parents[2] / "conf"
_OF_ALL = "# @package _global_"


@contextmanager
def told_in_one_line(command: str) -> Iterator[None]:
    """Turns a user's error into one line on stderr and exit code 2."""
    try:
        yield
    except RegtorchError as error:
        message = str(error)
    except OmegaConfBaseException as error:
        key = f"{error.full_key}: " if error.full_key else ""
        message = key + str(error).splitlines()[0]
    else:
        return
    print(f"{command}: error: {' '.join(message.split())}", file=sys.stderr)
    raise SystemExit(BAD_INPUT)


def use_threads(threads: int) -> None:
    """Sets the threads of torch and numba; raises ``RegtorchError`` where the machine has fewer."""
    import numba
    import torch

    most = numba.config.NUMBA_NUM_THREADS
    if not (isinstance(threads, int) and 1 <= threads <= most):
        raise RegtorchError(f"threads={threads}: expected a whole number from 1 to {most}")
    torch.set_num_threads(threads)
    numba.set_num_threads(threads)


def tell_written(paths: Iterable[Path]) -> None:
    for path in paths:
        print(f"wrote {path}")


def command_parser(command: str, doc: str) -> argparse.ArgumentParser:
    """A parser whose help is ``doc``."""
    return Parser(
        prog=f"python -m experiments.{command}",
        description=doc,
        epilog=CHECKOUT,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def folder_parser(command: str, doc: str, default: str | None = None) -> argparse.ArgumentParser:
    """The parser of a command that works on a study's folder."""
    parser = command_parser(command, doc)
    text = "folder of a study" + (f" (default: {default})" if default else "")
    optional = {"nargs": "?", "default": Path(default)} if default else {}
    parser.add_argument("folder", type=Path, metavar="FOLDER", help=text, **optional)
    return parser


def help_of_settings(doc: str, name: str) -> None:
    """On ``--help``, prints ``doc`` and the commented settings of ``conf/NAME.yaml``, and exits.

    Hydra's own help lists the values without the comments.
    """
    if not {"-h", "--help"} & set(sys.argv[1:]):
        return
    groups = _defaults(_CONF / f"{name}.yaml")
    chosen = [_CONF / group / f"{choice}.yaml" for group, choice in groups.items()]
    of_all = [path for path in chosen if path.read_text(encoding="utf-8").startswith(_OF_ALL)]
    for path in of_all:
        groups |= _defaults(path, "override /")
    files = [_CONF / f"{name}.yaml", *of_all]
    parts = [doc.strip()]
    for path in files:
        parts.append(f"Settings, given as NAME=VALUE ({path.relative_to(_CONF.parent)}):\n\n{_settings(path)}")
    lines = [f"  {group}: {', '.join(_choices(group, choice))}" for group, choice in groups.items()]
    if lines:
        parts.append("\n".join(["Groups, given as GROUP=NAME (conf/GROUP/NAME.yaml):\n", *lines]))
    parts.append("--cfg job prints the settings of a run, --hydra-help Hydra's own options; -m sweeps over A,B,C.")
    print("\n\n".join([*parts, CHECKOUT]))
    raise SystemExit(0)


def _settings(path: Path) -> str:
    """A file of settings as it is, less the settings of Hydra itself and the choice of groups."""
    lines, kept = path.read_text(encoding="utf-8").splitlines(), []
    skipped = False
    for line in lines:
        if line[:1].isalpha():
            skipped = line.partition(":")[0] in ("defaults", "hydra")
        if not (skipped or line.startswith("#")):
            kept.append(f"  {line}".rstrip())
    return "\n".join(kept).strip("\n")


def _defaults(path: Path, prefix: str = "") -> dict[str, str]:
    """The choice of each group in a file's defaults list, of the entries that begin with ``prefix``."""
    defaults = yaml.safe_load(path.read_text(encoding="utf-8"))["defaults"]
    named = [(key, choice) for entry in defaults if isinstance(entry, dict) for key, choice in entry.items()]
    groups = {key.removeprefix(prefix): choice for key, choice in named if key.startswith(prefix)}
    return {group: choice for group, choice in groups.items() if " " not in group}


def _choices(group: str, default: str) -> list[str]:
    names = sorted(path.stem for path in (_CONF / group).glob("*.yaml"))
    return [f"{name} (default)" if name == default else name for name in names]
