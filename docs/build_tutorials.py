"""Makes the tutorials' pages from their scripts: docstring and comments as text, code as code, output, picture.

    python docs/build_tutorials.py

Each script runs in a temporary folder. Its page and its picture are kept in docs/tutorials/.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs" / "tutorials"
SCRIPTS = tuple(
    FOLDER / f"{name}.py"
    for name in (
        "chest_pa",
        "lateral_abdomen",
        "narrow_field",
        "degrees_of_freedom",
        "slicer_targets",
        "drrs_and_gradients",
        "own_study",
    )
)


def run(script: Path, folder: Path) -> str:
    """The output of a script that runs in ``folder``, and leaves its picture there."""
    environment = os.environ | {"MPLBACKEND": "agg", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, str(script)]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{script.name}: {done.stderr}")
    return done.stdout


def page(script: Path, output: str) -> str:
    """Markdown of a script and its output."""
    _, doc, body = script.read_text(encoding="utf-8").split('"""', 2)
    title, _, text = doc.partition("\n")
    parts = [f"# {title.strip()}", text.strip()]
    for block in re.split(r"\n{2,}", body.strip()):
        lines = block.splitlines()
        if all(line.startswith("#") for line in lines):
            parts.append("\n".join(line.removeprefix("#").removeprefix(" ") for line in lines))
        else:
            parts.append(block)
    merged: list[str] = []
    fence = "```python\n"
    for part, code in zip(parts, _is_code(body, len(parts)), strict=True):
        if code and merged and merged[-1].startswith(fence):
            merged[-1] = f"{merged[-1][:-4]}\n\n{part}\n```"
        else:
            merged.append(f"{fence}{part}\n```" if code else part)
    merged.append(f"![{title.strip()}]({script.stem}.png)")
    merged.append(f"The script prints:\n\n```text\n{output.rstrip()}\n```")
    merged.append(f"This page is made of `docs/tutorials/{script.name}` by `python docs/build_tutorials.py`.")
    return "\n\n".join(merged) + "\n"


def _is_code(body: str, count: int) -> list[bool]:
    blocks = re.split(r"\n{2,}", body.strip())
    code = [not all(line.startswith("#") for line in block.splitlines()) for block in blocks]
    return [False] * (count - len(code)) + code


def main() -> None:
    for script in SCRIPTS:
        with tempfile.TemporaryDirectory() as folder:
            output = run(script, Path(folder))
            script.with_suffix(".md").write_text(page(script, output), encoding="utf-8")
            shutil.copy(Path(folder) / f"{script.stem}.png", FOLDER)
        print(f"wrote {script.with_suffix('.md').relative_to(ROOT)}")


if __name__ == "__main__":
    main()
