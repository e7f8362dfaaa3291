"""README and docs quote commands, options, settings and links that exist, in plain sentences."""

import argparse
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from regtorch.arguments import parser
from tests.docs.quoted import COPIED, PAGES, ROOT, commands, links, name_of, prose
from tests.test_words import MOST_WORDS, sentences

MOST_WORDS_OF_README = 500

QUOTING = [page for page in PAGES if name_of(page) not in COPIED]
"""The page of results tells commands of older versions of the code as well; their settings are not compared."""


def _subcommands() -> dict[str, argparse.ArgumentParser]:
    (action,) = (action for action in parser()._actions if isinstance(action, argparse._SubParsersAction))
    return action.choices


def _options(some: argparse.ArgumentParser) -> set[str]:
    return {option for action in some._actions for option in action.option_strings}


@pytest.mark.parametrize("page", QUOTING, ids=name_of)
def test_quoted_commands_exist(page):
    known = _subcommands()
    for command, *words in commands(page):
        if command != "regtorch":
            assert _is_study(command.partition(".")[2]), f"python -m {command}"
        elif words and words[0].isalpha():
            assert words[0] in known, f"regtorch {words[0]}"
            given = {word.partition("=")[0] for word in words if word.startswith("--")}
            assert given <= _options(known[words[0]]) | {"--help"}, f"regtorch {' '.join(words)}"


def _is_study(name: str) -> bool:
    """A name in capitals stands for any."""
    folder = ROOT / "experiments"
    return name.isupper() or (folder / f"{name}.py").exists() or (folder / name / "__main__.py").exists()


@pytest.mark.parametrize("page", [page for page in QUOTING if name_of(page) != "results/README.md"], ids=name_of)
def test_quoted_settings_exist(page):
    for command, *words in commands(page):
        path = ROOT / "conf" / f"{command.removeprefix('experiments.')}.yaml"
        if not path.exists():
            continue
        known = _settings(path)
        for word in words:
            name, equals, _ = word.partition("=")
            if equals and name.isidentifier():
                assert name in known, f"{command}: no setting {name}"


def _settings(path: Path) -> set[str]:
    """Names at the top of a study's YAML, of its groups, and of the groups that change the top."""
    content = OmegaConf.load(path)
    groups = {key for entry in content.get("defaults", []) if isinstance(entry, str) is False for key in entry}
    names = {*content, *groups}
    for group in groups & {"study"}:
        for file in (ROOT / "conf" / group).glob("*.yaml"):
            names |= {*OmegaConf.load(file)}
    return {str(name) for name in names}


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_somewhere(page):
    missing = [target for target in links(page) if not (page.parent / target.partition("#")[0]).exists()]
    assert missing == []


@pytest.mark.parametrize("page", [page for page in QUOTING if page.parent.name != "results"], ids=name_of)
def test_sentences_are_short(page):
    assert [text for text in sentences(prose(page)) if len(text.split()) > MOST_WORDS] == []


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").split()) <= MOST_WORDS_OF_README
