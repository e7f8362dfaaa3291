"""The report of a study's folder: accuracy, figures, the worst cases, settings."""

from pathlib import Path

import matplotlib as mpl
import pandas as pd

from experiments.common.machine import MACHINE
from experiments.common.registrations import keys_of, read_rows, shown, tables_of
from experiments.common.report import html
from experiments.common.report.figures import before_and_after_figure, share_figure
from experiments.common.settings import read_settings
from experiments.common.style import use_style
from experiments.common.summary import distance, headline, worst
from regtorch.errors import RegtorchError

_WORST = 10
_BACKGROUND = "background_"
_PICTURES = "Pictures: edges of the bones, in blue where they are, in orange where they were found."
_NOTE = "PDE in the detector plane, mm. Medians, where nothing else is said; '95 %' is the 95th percentile."


def report(folder: Path) -> str:
    """One HTML page, with all pictures in it, of any study's folder.

    Raises ``RegtorchError`` where there is nothing to report, and for a file that cannot be read.
    """
    if not folder.is_dir():
        raise RegtorchError(f"{folder}: no such folder, expected one of a study")
    title = folder.resolve().name
    pictures = [path for path in sorted(folder.glob("*.png")) if not path.name.startswith(_BACKGROUND)]
    text = folder / "table.md"
    rows = read_rows(folder) if tables_of(folder) else None
    if rows is None and not pictures and not text.is_file():
        raise RegtorchError(f"{folder}: no tables of registrations, *.png or table.md, expected a study's folder")
    parts = [] if rows is None else _of_rows(folder, rows)
    figures = [html.figure(path.read_bytes(), path.name) for path in pictures]
    parts.append(html.section("Figures of the folder", figures))
    if text.is_file():
        parts.append(html.section("Tables of the folder", html.markdown(text.read_text("utf-8", "replace"))))
    parts.append(html.section("Settings", _settings(folder)))
    return html.page(title, parts)


def _of_rows(folder: Path, rows: pd.DataFrame) -> list[str]:
    keys = keys_of(rows)
    parts = [
        html.paragraph(_made_by(rows)),
        html.section("Accuracy", [html.table(*headline(rows, keys)), html.paragraph(_NOTE)]),
    ]
    some = rows[rows.pde_mm.notna()]
    if len(some):
        with mpl.rc_context():
            use_style()
            shares = html.drawn(share_figure(some, keys))
            before_and_after = html.drawn(before_and_after_figure(some, keys))
        figures = [
            html.figure(shares, "Share of the registrations up to each PDE; dashed: 5 mm."),
            html.figure(before_and_after, "PDE after against before; dashed: no better than before."),
        ]
        parts += [html.section("PDE", figures), html.section(f"The worst {_WORST}", [_worst_cases(folder, some, keys)])]
    return parts


def _made_by(rows: pd.DataFrame) -> str:
    """The number of registrations, and their versions, devices and threads where the table has them."""
    told = [
        f"{name} {', '.join(map(shown, rows[name].unique()))}"
        for name in ("version", "device", "threads", *MACHINE)
        if name in rows
    ]
    return f"{len(rows):,} registrations; " + "; ".join(told)


def _worst_cases(folder: Path, rows: pd.DataFrame, keys: list[str]) -> str:
    texts = [*keys, "seed", "status", *(["message"] if "message" in rows else [])]
    some = worst(rows, _WORST)
    lines = [
        [shown(row[key]) for key in texts] + [distance(row.initial_pde_mm), distance(row.pde_mm)]
        for _, row in some.iterrows()
    ]
    pictures = [_picture_of(folder, row, "arm" in keys) for _, row in some.iterrows()]
    table = html.table([*texts, "PDE before", "PDE"], lines, pictures)
    return table + html.paragraph(_PICTURES) if any(pictures) else table


def _picture_of(folder: Path, row: pd.Series, arms: bool) -> bytes | None:
    """The picture CT_VIEW_KIND_SEED of a row, as far as the row has these columns, in ``failures/``.

    With several arms it lies in the arm's folder. With one arm it lies in that folder or in ``folder`` itself.
    """
    words = [row[key] for key in ("ct", "view", "kind") if isinstance(row.get(key), str)]
    if "ct" in row:
        words[0] = words[0].partition(".")[0]
    name = "_".join([*words, f"{row.seed:.0f}.png"])
    places = [] if arms else [folder / "failures"]
    if "arm" in row:
        places.append(folder / str(row.arm) / "failures")
    found = (place / name for place in places if (place / name).is_file())
    return next((path.read_bytes() for path in found), None)


def _settings(folder: Path) -> list[str]:
    """Tables of the settings: one of those that differ between arms, one of the shared."""
    arms = read_settings(folder)
    names = list(dict.fromkeys(name for settings in arms.values() for name in settings))
    values = {name: [settings.get(name, "") for settings in arms.values()] for name in names}
    shared = [[name, found[0]] for name, found in values.items() if len(set(found)) == 1]
    own = [[name, *found] for name, found in values.items() if len(set(found)) > 1]
    tables = [html.table(["setting", *arms], own)] if own else []
    return [*tables, html.table(["setting", "value"], shared)] if shared else tables
