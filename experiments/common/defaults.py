"""The YAML of the default search, made of ``regtorch.registration.Settings``: each setting with its sentence."""

import ast
import inspect
import textwrap
from dataclasses import fields
from pathlib import Path
from typing import Any

from regtorch.registration import Settings, Stage

PATH = Path(__file__).parents[2] / "conf" / "registration" / "hybrid.yaml"
_WIDTH = 116


def settings_yaml() -> str:
    """The component that Hydra instantiates: ``hybrid`` with every setting at its default."""
    lines = [
        "# Made of regtorch.registration.Settings by python -m experiments.settings: change that, not this.",
        "_target_: regtorch.registration.hybrid",
        "_partial_: true",
        "settings:",
        "  _target_: regtorch.registration.Settings",
    ]
    told = _sentences()
    for field in fields(Settings):
        lines += textwrap.wrap(told[field.name], _WIDTH, initial_indent="  # ", subsequent_indent="  # ")
        lines += _entry(field.name, field.default)
    return "\n".join(lines) + "\n"


def _entry(name: str, value: Any) -> list[str]:
    if not (isinstance(value, tuple) and isinstance(value[0], Stage)):
        return [f"  {name}: {_scalar(value)}"]
    stages = [
        f"{{_target_: regtorch.registration.Stage, pixels: {s.pixels}, candidates: {s.candidates}, steps: {s.steps}}}"
        for s in value
    ]
    return [f"  {name}:", *(f"    - {stage}" for stage in stages)]


def _scalar(value: Any) -> str:
    """YAML needs a point in numbers with an exponent."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return f"[{', '.join(map(_scalar, value))}]"
    text = repr(value)
    return text.replace("e", ".0e") if isinstance(value, float) and "e" in text and "." not in text else text


def _sentences() -> dict[str, str]:
    """The string below each field of the class."""
    (body,) = ast.parse(textwrap.dedent(inspect.getsource(Settings))).body
    told = {}
    for field, below in zip(body.body, body.body[1:], strict=False):
        if isinstance(field, ast.AnnAssign) and isinstance(below, ast.Expr):
            told[field.target.id] = " ".join(below.value.value.split())
    return told
