"""Docstrings are plain: no sentence is longer than 25 words."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "regtorch"
MOST_WORDS = 25


def _docstrings(path: Path) -> Iterator[tuple[int, str]]:
    """Line and text of every string that stands alone: of modules, classes, functions, constants and fields."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.lineno, node.value.value


def sentences(text: str) -> Iterator[str]:
    """Sentences of prose. Code, formulas in brackets, tables and doctests are no prose; items of lists stand alone."""
    text = re.sub(r"``[^`]*``", "code", text)
    text = re.sub(r"\([^()]*\)|\[[^\[\]]*\]", "", text)
    for block in re.split(r"\n\s*\n|\n\s*[-*] |\n\s+\w+: ", text):
        if not block.lstrip().startswith((">>>", "|")):
            yield from re.split(r"(?<=[.:;?!])\s+", " ".join(block.split()))


@pytest.mark.parametrize("folder", sorted(path for path in PACKAGE.iterdir() if path.is_dir()), ids=lambda p: p.name)
def test_sentences_are_short(folder):
    assert _long(sorted(folder.rglob("*.py"))) == []


def test_sentences_of_single_modules_are_short():
    assert _long(sorted(PACKAGE.glob("*.py"))) == []


def _long(files: list[Path]) -> list[str]:
    return [
        f"{file.relative_to(PACKAGE)}:{line}: {sentence}"
        for file in files
        for line, text in _docstrings(file)
        for sentence in sentences(text)
        if len(sentence.split()) > MOST_WORDS
    ]
