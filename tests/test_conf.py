"""Every component's YAML lists every option of its target, with the target's own default, and instantiates."""

import inspect
from dataclasses import fields, is_dataclass
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from hydra.utils import get_method, instantiate
from omegaconf import OmegaConf

from experiments.common.defaults import PATH, settings_yaml
from regtorch.registration import Settings

_CONF = Path(__file__).parent.parent / "conf"
_COMPONENTS = sorted(p for p in _CONF.glob("*/*.yaml") if "_target_" in OmegaConf.load(p))
_CALLERS = {"radiograph": {"detector", "targets", "seed"}, "similarity": {"weight"}}
"""Arguments that those who call a component give it."""


@pytest.mark.parametrize("path", _COMPONENTS, ids=lambda p: f"{p.parent.name}/{p.stem}")
def test_component_lists_all_options_with_their_defaults(path: Path) -> None:
    config = OmegaConf.load(path)
    options = {
        name: p.default
        for name, p in inspect.signature(get_method(config._target_)).parameters.items()
        if p.kind is p.KEYWORD_ONLY and name not in _CALLERS.get(path.parent.name, ())
    }
    assert {key for key in config if not key.startswith("_")} == set(options)
    needed = {name for name, default in options.items() if default is inspect.Parameter.empty}
    assert needed == OmegaConf.missing_keys(config)
    made = instantiate(OmegaConf.masked_copy(config, [key for key in config if key not in needed]), _convert_="all")
    for name, default in options.items():
        if name in needed:
            continue
        value = made.keywords[name]
        if callable(default):
            assert getattr(value, "func", value) is default
        else:
            assert _plain(value) == _plain(default)


@pytest.mark.parametrize("name", sorted(p.stem for p in (_CONF / "registration").glob("*.yaml")))
def test_every_method_can_be_chosen_for_a_study(name: str) -> None:
    with initialize_config_dir(str(_CONF), version_base="1.3"):
        config = compose("search", overrides=[f"registration={name}", "cts=[]"])
    made = instantiate(config.registration, _convert_="all")
    options = inspect.signature(made.func).parameters
    assert set(made.keywords) <= set(options)


def _plain(value):
    """Sequences as lists and settings as dictionaries, because Hydra turns all sequences into lists."""
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    return [_plain(each) for each in value] if isinstance(value, list | tuple) else value


def test_the_default_searchs_yaml_is_made_of_its_settings() -> None:
    assert PATH.read_text(encoding="utf-8") == settings_yaml()
    for field in fields(Settings):
        sentence = settings_yaml().split(f"  {field.name}:")[0].splitlines()[-1]
        assert sentence.startswith("  # ")
        assert sentence.endswith(".")


def test_there_are_components() -> None:
    assert _COMPONENTS
