"""Pieces of an HTML page that needs no other file: escaped text, tables, figures as part of the page."""

import base64
import re
from collections.abc import Sequence
from html import escape
from io import BytesIO

from matplotlib.figure import Figure

from experiments.common.style import DPI

_NUMBER = re.compile(r"(?:[-+\d.,e∞% ]|to)*")

_STYLE = """
:root { color-scheme: light dark; --ink: #1a1a1a; --paper: #fff; --faint: #767676; --line: #d0d0d0; --band: #f4f4f4 }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e4e4e4; --paper: #16181b; --faint: #9a9a9a; --line: #3a3d42; --band: #1f2226 }
}
body { margin: 2rem auto; padding: 0 1rem; max-width: 70rem; color: var(--ink); background: var(--paper);
  font: 1rem/1.5 system-ui, sans-serif }
h1 { margin-bottom: 0 } h2 { margin-top: 2.5rem; border-bottom: 1px solid var(--line) }
.scroll { overflow-x: auto }
table { margin: 1rem 0; border-collapse: collapse; font-size: 0.85rem; font-variant-numeric: tabular-nums }
th, td { padding: 0.25rem 0.6rem; border-bottom: 1px solid var(--line); text-align: left; vertical-align: top }
th { border-bottom: 2px solid var(--faint); vertical-align: bottom }
td:first-child { white-space: nowrap }
.number { text-align: right; white-space: nowrap }
tbody tr:nth-child(even) { background: var(--band) }
figure { margin: 1.5rem 0; break-inside: avoid }
figure img { max-width: 100%; background: #fff; border-radius: 4px }
td img { width: 14rem; max-width: 100%; display: block }
figcaption { color: var(--faint); font-size: 0.9rem }
@media print {
  :root { --ink: #000; --paper: #fff; --faint: #555; --line: #bbb; --band: #fff }
  body { max-width: none; margin: 0; font-size: 10pt } .scroll { overflow: visible }
  table { font-size: 7pt } th, td { padding: 0.1rem 0.25rem } tr { break-inside: avoid } h2 { break-after: avoid }
}
"""


def page(title: str, parts: Sequence[str]) -> str:
    """A whole page; ``parts`` are HTML."""
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{escape(title)}</title>'
    head = f"<head>{head}<style>{_STYLE}</style></head>"
    body = "\n".join(["<body>", f"<h1>{escape(title)}</h1>", *parts, "</body>"])
    return f'<!doctype html>\n<html lang="en">\n{head}\n{body}\n</html>\n'


def section(title: str, parts: Sequence[str]) -> str:
    """A heading and its parts; nothing without parts."""
    return "\n".join([f"<h2>{escape(title)}</h2>", *parts]) if parts else ""


def paragraph(text: str) -> str:
    return f"<p>{escape(text)}</p>"


def table(header: Sequence[str], lines: Sequence[Sequence[str]], pictures: Sequence[bytes | None] = ()) -> str:
    """A table of texts; ``pictures`` (PNG), one for each line, make a last column."""
    columns = zip(*lines, strict=True) if lines else [()] * len(header)
    kinds = [' class="number"' if all(map(_NUMBER.fullmatch, column)) else "" for column in columns]
    head = "".join(f"<th{kind}>{escape(name)}</th>" for kind, name in zip(kinds, header, strict=True))
    cells = [
        "".join(f"<td{kind}>{escape(text)}</td>" for kind, text in zip(kinds, line, strict=True)) for line in lines
    ]
    if any(pictures):
        head += "<th>picture</th>"
        cells = [
            f"{line}<td>{_image(picture, '') if picture else ''}</td>"
            for line, picture in zip(cells, pictures, strict=True)
        ]
    body = "\n".join(f"<tr>{line}</tr>" for line in cells)
    return f'<div class="scroll"><table>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody>\n</table></div>'


def figure(png: bytes, caption: str) -> str:
    return f"<figure>{_image(png, caption)}<figcaption>{escape(caption)}</figcaption></figure>"


def drawn(figure: Figure) -> bytes:
    """A figure as PNG."""
    file = BytesIO()
    figure.savefig(file, dpi=DPI, format="png")
    return file.getvalue()


def markdown(text: str) -> list[str]:
    """HTML of the tables, headings and paragraphs that a study's ``table.md`` holds."""
    return [_block(block.splitlines()) for block in re.split(r"\n\s*\n", text.strip()) if block]


def _block(lines: list[str]) -> str:
    cells = [[cell.strip() for cell in line.strip().strip("|").split("|")] for line in lines]
    if len(cells) > 2 and set(lines[1]) <= set("|-: ") and len(set(map(len, cells))) == 1:
        return table(cells[0], cells[2:])
    if lines[0].startswith("#"):
        return f"<h3>{escape(lines[0].lstrip('# '))}</h3>"
    return paragraph(" ".join(lines))


def _image(png: bytes, text: str) -> str:
    return f'<img alt="{escape(text)}" src="data:image/png;base64,{base64.b64encode(png).decode()}">'
