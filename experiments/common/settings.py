"""The settings that made a study: ``settings.yaml`` in its folder or in its arms' folders. Rows of others never mix."""

import os
import socket
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import yaml
from omegaconf import DictConfig, OmegaConf

from experiments.common.registrations import natural
from regtorch.errors import RegtorchError

SETTINGS = "settings.yaml"


def refuse_to_mix(config: DictConfig, folder: Path, unshared: Iterable[str], parts: Iterable[str] = ()) -> dict:
    """The settings that all rows of the folder share: all but ``unshared``.

    A setting in ``parts`` may get further entries. Functions are compared by name, because modules move between
    versions. Raises ``RegtorchError`` where a setting differs from the folder's.
    """
    own = {key: value for key, value in OmegaConf.to_container(config).items() if key not in unshared}
    kept = folder / SETTINGS
    if not kept.exists():
        return own
    before = OmegaConf.to_container(OmegaConf.load(kept))
    changed = _changed({**own, **dict.fromkeys(parts)}, {**before, **dict.fromkeys(parts)})
    if changed:  # perhaps in spelling alone, as ``arm: ${dof}-DOF`` and ``arm: 9-DOF``
        now, then = (OmegaConf.to_container(each, resolve=True) for each in (config, OmegaConf.load(kept)))
        changed = [key for key in changed if key in _changed(now, then)]
    for key in parts:
        whole = before.get(key, {}) | own[key]
        changed += [f"{key}.{name}" for name in _changed(whole, own[key] | before.get(key, {}))]
        own[key] = whole
    if changed:
        other = "arm= or out=" if "arm" in own else "out="
        raise RegtorchError(f"{folder}: made with another {changed[0]!r}, expected that of {kept} or another {other}")
    return own


def keep(config: DictConfig, folder: Path, unshared: Iterable[str], parts: Iterable[str] = ()) -> None:
    """Writes ``settings.yaml`` at one stroke, because other processes may read and write it at the same time.

    Raises ``RegtorchError`` where ``refuse_to_mix`` does, also if another process has just written other settings.
    """
    folder.mkdir(parents=True, exist_ok=True)
    whole = folder / f".{socket.gethostname()}-{os.getpid()}.yaml"
    try:
        whole.write_text(OmegaConf.to_yaml(OmegaConf.create(refuse_to_mix(config, folder, unshared, parts))))
        os.link(whole, folder / SETTINGS)
    except OSError:  # another process was first, or the file system has no links
        whole.write_text(OmegaConf.to_yaml(OmegaConf.create(refuse_to_mix(config, folder, unshared, parts))))
        os.replace(whole, folder / SETTINGS)
    finally:
        whole.unlink(missing_ok=True)


def read_settings(folder: Path) -> dict[str, dict[str, str]]:
    """Value by dotted name, for each arm by its name; '' names the settings of ``folder`` itself.

    Raises ``RegtorchError`` where a file is no YAML.
    """
    paths = sorted([*folder.glob(SETTINGS), *folder.glob(f"*/{SETTINGS}")], key=lambda path: natural(str(path)))
    return {"" if path.parent == folder else path.parent.name: dict(_flat(_load(path))) for path in paths}


def _changed(now: dict[str, Any], before: dict[str, Any]) -> list[str]:
    """The settings that differ, or that one of the two lacks."""
    pairs = {key: (_without_modules(now.get(key, ...)), _without_modules(before.get(key, ...))) for key in now | before}
    return [key for key, (own, old) in pairs.items() if own != old]


def _without_modules(value: Any, key: str = "") -> Any:
    if isinstance(value, dict):
        return {name: _without_modules(each, name) for name, each in value.items()}
    if isinstance(value, list):
        return [_without_modules(each) for each in value]
    return str(value).rpartition(".")[2] if key == "_target_" else value


def _load(path: Path) -> dict[str, Any]:
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise RegtorchError(f"{path}: cannot be read ({error}), expected a study's settings") from None
    if not isinstance(content, dict):
        raise RegtorchError(f"{path}: a {type(content).__name__} at the top, expected a study's settings")
    return content


def _flat(content: Any, name: str = "") -> Iterator[tuple[str, str]]:
    if isinstance(content, dict):
        for key, value in content.items():
            yield from _flat(value, f"{name}.{key}" if name else str(key))
    elif isinstance(content, list) and any(isinstance(value, dict | list) for value in content):
        yield from _flat(dict(enumerate(content)), name)
    elif isinstance(content, list):
        yield name, ", ".join(map(str, content))
    else:
        yield name, str(content)
