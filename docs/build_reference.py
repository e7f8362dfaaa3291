"""Makes the reference pages that repeat the code: the command line, the settings of the search, tables of files.

python docs/build_reference.py
"""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs" / "reference"
REGTORCH = ("", "demo", "simulate", "register", "evaluate")


SCHEMAS = FOLDER / "schemas"
TABLES = {
    "result.json": ("result", None),
    "parameters": ("result", "parameters"),
    "detector": ("result", "detector"),
    "reasons": ("result", "reason"),
    "evidence": ("result", "evidence"),
    "trace": ("result", "step"),
    "truth.json": ("truth", None),
    "The JSON of evaluate": ("evaluation", None),
    "targets": ("evaluation", "target"),
    "The header of a PNG or TIFF": ("radiograph", None),
    "Points of 3D Slicer": ("points", None),
    "markups": ("points", "markup"),
    "controlPoints": ("points", "point"),
}
"""Headings of the page of files, each with its schema, and the definition there; None is the schema itself."""


def studies() -> list[str]:
    """Names of the commands of the studies."""
    folder = ROOT / "experiments"
    names = {path.stem for path in folder.glob("*.py")} | {path.parent.name for path in folder.glob("*/__main__.py")}
    return sorted(names - {"__init__"})


def help_of_all(names: list[str]) -> list[str]:
    """The text of each command's ``--help``, 100 columns wide, from one process that imports the rest once."""
    modules = [name.replace("regtorch", "regtorch.cli", 1).replace("python -m ", "").split() for name in names]
    environment = {k: v for k, v in os.environ.items() if k != "REGTORCH_DATA"} | {"COLUMNS": "100"}
    environment["PYTHONPATH"] = str(ROOT)
    words = [sys.executable, "-c", _ASK, json.dumps(modules)]
    done = subprocess.run(words, cwd=ROOT, env=environment, capture_output=True, text=True, check=True)
    return ["\n".join(line.rstrip() for line in text.strip().splitlines()) for text in json.loads(done.stdout)]


_ASK = """
import contextlib, io, json, runpy, sys
texts = []
for module, *rest in json.loads(sys.argv[1]):
    sys.argv = [module, *rest, "--help"]
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.suppress(SystemExit):
        runpy.run_module(module, run_name="__main__")
    texts.append(out.getvalue())
print(json.dumps(texts))
"""


def commands() -> list[str]:
    return [f"regtorch {name}".strip() for name in REGTORCH] + [f"python -m experiments.{name}" for name in studies()]


def command_line() -> str:
    names = commands()
    texts = help_of_all(names)
    parts = [
        "# Command line",
        "Each command tells its options on `--help`. This page repeats these texts. `regtorch` is installed with the "
        "package. The studies run from a checkout of the repository.",
    ]
    for name, text in zip(names, texts, strict=True):
        parts.append(f"## {name}\n\n```text\n{text}\n```")
    return "\n\n".join(parts) + "\n"


def settings() -> str:
    """A table for each group of ``Settings``, from the file that the studies read."""
    import yaml

    path = ROOT / "conf" / "registration" / "hybrid.yaml"
    values = yaml.safe_load(path.read_text(encoding="utf-8"))["settings"]
    source = (ROOT / "regtorch/registration/search/settings.py").read_text(encoding="utf-8")
    sentences = dict(re.findall(r"^    (\w+): [^\n]*\n    \"\"\"(.*?)\"\"\"", source, re.MULTILINE | re.DOTALL))
    parts = [
        "# Settings of the search",
        "The fields of `regtorch.registration.Settings`. The values are those of `conf/registration/hybrid.yaml`, "
        "which `python -m experiments.settings` makes of the same class.\n\n"
        "```python\nfrom functools import partial\n\nfrom regtorch.registration import Settings, hybrid, register\n\n"
        "result = register(ct, radiograph, view, method=partial(hybrid, settings=Settings(poses=500)))\n```\n\n"
        "In a study: `python -m experiments.search registration.settings.poses=500`.",
    ]
    for line in source.splitlines():
        if heading := re.fullmatch(r"    # (\w[\w ]*)", line):
            parts.append(f"## {heading[1]}\n\n| setting | default | meaning |\n|---|---|---|")
        elif (field := re.match(r"    (\w+): ", line)) and field[1] in values and field[1] in sentences:
            parts[-1] += f"\n| `{field[1]}` | {_value(values[field[1]])} | {' '.join(sentences[field[1]].split())} |"
    return "\n\n".join(parts) + "\n"


def _value(value: object) -> str:
    if isinstance(value, list) and isinstance(value[0], dict):
        return "; ".join(f"{v['pixels']}, {v['candidates']}, {v['steps']}" for v in value)
    if isinstance(value, list):
        return ", ".join(map(str, value))
    return {True: "on", False: "off"}[value] if isinstance(value, bool) else f"{value}"


def files() -> str:
    """The page of files, with each table made anew of its schema."""
    text = (FOLDER / "files.md").read_text(encoding="utf-8")
    for heading, (name, part) in TABLES.items():
        table = rf"(^##+ {re.escape(heading)}\n(?:(?![|#]).*\n)*)(?:\|.*\n)+"
        text, count = re.subn(table, lambda found: found[1] + _table(name, part), text, flags=re.MULTILINE)  # noqa: B023
        if count != 1:
            raise RuntimeError(f"docs/reference/files.md: {count} tables under {heading!r}, expected one")
    return text


def schema(name: str) -> dict:
    return json.loads((SCHEMAS / f"{name}.schema.json").read_text(encoding="utf-8"))


def _table(name: str, part: str | None) -> str:
    whole = schema(name)
    told = whole["$defs"][part] if part else whole
    lines = ["| key | type | content |", "|---|---|---|"]
    for key, entry in told["properties"].items():
        absent = "" if key in told["required"] else " or absent"
        lines.append(f"| `{key}` | {_kind(whole, entry)}{absent} | {entry['description']} |")
    return "\n".join(lines) + "\n"


def _kind(whole: dict, entry: dict) -> str:
    """The type of a value in words: a matrix by its size, a list by what it holds."""
    if "$ref" in entry:
        return _kind(whole, whole["$defs"][entry["$ref"].rpartition("/")[2]])
    if "type" not in entry:  # one of several values, which are strings
        return "string"
    if entry["type"] != "array":
        return " or ".join(entry["type"]) if isinstance(entry["type"], list) else entry["type"]
    items = entry["items"]
    if items.get("type") == "array":
        return f"{entry['minItems']} x {items['minItems']}"
    return f"list of {_kind(whole, items)}s"


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    for name, text in (("command_line.md", command_line()), ("settings.md", settings()), ("files.md", files())):
        (FOLDER / name).write_text(text, encoding="utf-8")
        print(f"wrote docs/reference/{name}")


if __name__ == "__main__":
    main()
