"""Commands and links that README and docs quote."""

import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = (
    ROOT / "README.md",
    ROOT / "ARCHITECTURE.md",
    ROOT / "results" / "README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
)
COPIED = ("docs/reference/command_line.md",)
"""Made of ``--help``: a test compares the whole text."""


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def code(text: str) -> Iterator[str]:
    """Fenced blocks of a shell, with continued lines joined, line by line; and inline code."""
    fenced = re.compile(r"^ *```(\w*)[^\n]*\n(.*?)^ *```", re.MULTILINE | re.DOTALL)
    for language, block in fenced.findall(text):
        if language == "sh":
            yield from block.replace("\\\n", " ").splitlines()
    yield from (" ".join(inline.split()) for inline in re.findall(r"`([^`]+)`", fenced.sub("", text)))


def commands(page: Path) -> list[list[str]]:
    """Words of every command of this project that a page quotes, from ``regtorch`` or ``experiments.NAME`` on."""
    found = []
    for line in code(page.read_text(encoding="utf-8")):
        for part in re.split(r"&&|;|\|", line.partition(" #")[0]):
            words = part.replace("'", " ").replace('"', " ").split()
            for place, word in enumerate(words):
                study = re.fullmatch(r"experiments\.(\w+)", word) and words[place - 1] == "-m"
                if study or word.removeprefix(".venv/bin/") == "regtorch":
                    found.append([word.removeprefix(".venv/bin/"), *words[place + 1 :]])
                    break
    return found


def links(page: Path) -> list[str]:
    """Targets of links and pictures inside the repository."""
    text = re.sub(r"^ *```.*?^ *```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    targets = re.findall(r"\]\(([^)\s]+)\)", re.sub(r"`[^`]+`", "", text))
    return [target for target in targets if not target.startswith(("http", "#", "mailto"))]


def prose(page: Path) -> str:
    """Without code, tables, headings, links' targets and captions of code."""
    text = re.sub(r"^ *```.*?^ *```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)
    text = re.sub(r"`[^`]*`", "code", text).replace("*", "")
    kept = [line for line in text.splitlines() if not re.match(r" *(\||#|:::|!!!)|    ", line)]
    return re.sub(r"\n *(\d+\.|-) ", "\n\n", "\n".join(kept))
