"""Pages say what the code does: built without warnings, commands and codes as they are."""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from regtorch.registration.trust.rules import RULES, WARNINGS

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]

_spec = importlib.util.spec_from_file_location("build_reference", DOCS / "build_reference.py")
reference = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(reference)


def _words(text: str) -> list[str]:
    """Python's versions break lines of a usage at other places."""
    return text.split()


def test_pages_are_built_without_warnings(tmp_path):
    for module, package in (("mkdocs", "mkdocs"), ("material", "mkdocs-material"), ("mkdocstrings", "mkdocstrings")):
        if importlib.util.find_spec(module) is None:
            pytest.skip(f"{package} is not installed: pip install 'regtorch[docs]'")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    fetched = re.compile(r"""<(?:script|img|iframe)[^>]*src=["']?https?:|<link[^>]*stylesheet[^>]*href=["']?https?:""")
    for page in (tmp_path / "site").rglob("*.html"):
        assert not fetched.search(page.read_text(encoding="utf-8")), f"{page.name} needs a network"


def test_the_page_of_the_command_line_is_every_help():
    page = (DOCS / "reference" / "command_line.md").read_text(encoding="utf-8")
    assert _words(page) == _words(reference.command_line()), "run python docs/build_reference.py"


def test_the_page_of_the_settings_is_that_of_the_code():
    page = (DOCS / "reference" / "settings.md").read_text(encoding="utf-8")
    assert page == reference.settings(), "run python docs/build_reference.py"


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_quoted_commands_exist(page):
    text = page.read_text(encoding="utf-8")
    known = {command.split()[-1] for command in reference.commands()}
    quoted = re.findall(r"python\s+-m\s+(experiments\.\w+)", text)
    for code in re.findall(r"```sh\n.*?```|`[^`\n]+`", text, re.DOTALL):
        quoted += re.findall(r"(?:^ *|`|bin/)regtorch ([a-z]+)\b", code, re.MULTILINE)
    assert set(quoted) <= known


def test_every_rule_has_its_entry():
    text = (DOCS / "explained" / "doubt.md").read_text(encoding="utf-8")
    entries = re.split(r"^## ", text, flags=re.MULTILINE)[1:]
    codes = [entry.partition("\n")[0] for entry in entries]
    assert codes == [rule.code for rule in (*RULES, *WARNINGS)]
    for rule, entry in zip((*RULES, *WARNINGS), entries, strict=True):
        assert all(f"**{part}**" in entry for part in ("Rule", "Meaning", "Next"))
        assert rule in WARNINGS or f"**Status** {rule.status}." in entry


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").split()) <= 500
