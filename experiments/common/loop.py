"""The loop of every study of registrations: rows are made one by one, kept at once, and never made twice."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from omegaconf import DictConfig
from tqdm import tqdm

from experiments.common.command import use_threads
from experiments.common.settings import keep, refuse_to_mix
from experiments.common.table import append, done, locked, refuse_other_columns, table_name, written

Case = tuple[Any, ...]
Row = dict[str, Any]
Tell = Callable[[str], None]


def silent(text: str) -> None:
    """Shows no progress."""


class Study(Protocol):
    """Everything that a study reads once."""

    def row(self, case: Case, tell: Tell = silent) -> Row:
        """Registers one case; ``tell`` shows the progress."""


@dataclass(frozen=True)
class Plan:
    """The share of a study that one process does.

    Args:
        config: the study's settings, with ``threads``; with ``shard`` where several processes share the work.
        folder: holds the tables and ``settings.yaml``.
        key: the columns that name a case.
        columns: all columns of the table.
        cases: the values of ``key`` for each registration.
        unshared: settings in which rows of one folder may differ.
        parts: settings that may get further entries.
    """

    config: DictConfig
    folder: Path
    key: Sequence[str]
    columns: Sequence[str]
    cases: Sequence[Case]
    unshared: Sequence[str]
    parts: Sequence[str] = ()

    @property
    def table(self) -> Path:
        return self.folder / table_name(self.config.get("shard"))

    def missing(self) -> list[Case]:
        made = done(self.folder, self.key)
        return [case for case in self.cases if tuple(map(written, case)) not in made]


def register_missing(plan: Plan, study: Callable[[DictConfig], Study]) -> None:
    """Registers the cases that no table of the folder has, and says how many rows are there.

    Raises ``RegtorchError`` where the folder was made with other settings or columns, and where another process writes
    the same table. ``study`` is made only if a case is missing.
    """
    use_threads(plan.config.threads)
    refuse_to_mix(plan.config, plan.folder, plan.unshared, plan.parts)
    count = len(plan.cases)
    if not plan.missing():
        print(f"{count} of {count} registrations are in {plan.folder} already; out=FOLDER begins anew")
        return
    refuse_other_columns(plan.folder, plan.columns)
    ready = study(plan.config)
    with locked(plan.table):
        missing = plan.missing()
        shown = {"total": count, "initial": count - len(missing), "unit": "registration", "mininterval": 1}
        with tqdm(missing, str(plan.table.relative_to(plan.folder.parent)), **shown) as bar:
            for case in bar:
                row = dict.fromkeys(plan.columns) | dict(zip(plan.key, case, strict=True))
                row |= ready.row(case, lambda text: bar.set_postfix_str(text, refresh=False))
                keep(plan.config, plan.folder, plan.unshared, plan.parts)
                append(plan.table, row)
    print(f"wrote {len(missing)} of {count} registrations to {plan.table}")


def telling(tell: Tell) -> Callable[[float, str], None]:
    """A ``progress`` for ``register``."""
    return lambda share, step: tell(f"{100 * share:.0f} % {step}")
