"""The settings that made a study, as the ``settings.yaml`` of its folder or of its arms' folders keep them."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from regtorch.errors import RegtorchError
from regtorch.report.rows import natural

_FILE = "settings.yaml"


def read_settings(folder: Path) -> dict[str, dict[str, str]]:
    """Value by dotted name, for each arm by its name; '' is the name of the folder's own.

    Raises ``RegtorchError`` where a file is no YAML.
    """
    paths = sorted([*folder.glob(_FILE), *folder.glob(f"*/{_FILE}")], key=lambda path: natural(str(path)))
    return {"" if path.parent == folder else path.parent.name: dict(_flat(_load(path))) for path in paths}


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
