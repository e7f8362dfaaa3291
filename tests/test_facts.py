"""Facts about the code that a reader can rely on: short functions, no cycles, the layout as drawn."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE, STUDIES = ROOT / "regtorch", ROOT / "experiments"
MOST_LINES, MOST_BRANCHES = 60, 12
SETTINGS = ("settings.py", "limits.py", "start.py")
"""Files of the registration that hold numbers."""

_BRANCHES = (ast.If, ast.For, ast.While, ast.ExceptHandler, ast.IfExp, ast.match_case)


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*.py") if "__pycache__" not in path.parts)


def _is_kernel(path: Path) -> bool:
    return path.name in ("cpu.py", "raster.py") or {"cpu", "triton"} & set(path.parts)


def _functions(path: Path) -> Iterator[ast.FunctionDef]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node


def branches(function: ast.AST) -> int:
    """Every place where the way may part: statements, ternaries, conditions of comprehensions, ``and`` and ``or``."""
    count = 0
    for node in ast.walk(function):
        count += isinstance(node, _BRANCHES)
        count += len(node.values) - 1 if isinstance(node, ast.BoolOp) else 0
        count += len(node.ifs) if isinstance(node, ast.comprehension) else 0
    return count


@pytest.mark.parametrize("folder", [PACKAGE, STUDIES], ids=lambda folder: folder.name)
def test_functions_are_short(folder):
    files = [path for path in _files(folder) if not _is_kernel(path)]
    long = {
        f"{path.relative_to(ROOT)}:{function.name}": function.end_lineno - function.lineno + 1
        for path in files
        for function in _functions(path)
    }
    assert {name: lines for name, lines in long.items() if lines > MOST_LINES} == {}


@pytest.mark.parametrize("folder", [PACKAGE, STUDIES], ids=lambda folder: folder.name)
def test_functions_branch_little(folder):
    files = [path for path in _files(folder) if not _is_kernel(path)]
    parts = {
        f"{path.relative_to(ROOT)}:{function.name}": branches(function)
        for path in files
        for function in _functions(path)
    }
    assert {name: count for name, count in parts.items() if count > MOST_BRANCHES} == {}


def _module(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def _imports(path: Path, modules: set[str]) -> set[str]:
    """Modules imported at the top of a file; a name of a package that is a module counts as this module."""
    found = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in modules else node.module for name in names}
    return found & modules


@pytest.mark.parametrize("folder", [PACKAGE, STUDIES], ids=lambda folder: folder.name)
def test_no_import_cycles(folder):
    files = {_module(path): path for path in _files(folder)}
    imports = {module: _imports(path, set(files)) - {module} for module, path in files.items()}
    while free := [module for module, others in imports.items() if not others & set(imports)]:
        for module in free:
            del imports[module]
    assert imports == {}


def test_no_package_offers_the_name_of_one_of_its_modules():
    for package in PACKAGE.rglob("__init__.py"):
        modules = {path.stem for path in package.parent.glob("*.py")} | {
            path.parent.name for path in package.parent.glob("*/__init__.py")
        }
        offered = {
            alias.asname or alias.name
            for node in ast.walk(ast.parse(package.read_text(encoding="utf-8")))
            if isinstance(node, ast.ImportFrom) and node.module != _module(package)
            for alias in node.names
        }
        assert not modules & offered, package


def test_no_bare_number_decides_in_the_registration():
    """Comparisons are with names; 0, 1, 2 and -1 count and index."""
    bare = []
    for path in _files(PACKAGE / "registration"):
        if path.name in SETTINGS:
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Compare):
                numbers = [
                    each.value
                    for side in (node.left, *node.comparators)
                    for each in ast.walk(side)
                    if isinstance(each, ast.Constant) and type(each.value) in (int, float)
                ]
                if any(number not in (0, 1, 2, 0.5) for number in numbers):
                    bare.append(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert bare == []


def test_the_layout_is_the_one_drawn():
    """The fenced block ``layout`` of ARCHITECTURE.md; folders end with a slash."""
    text = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```layout\n(.*?)```", text, re.S)
    drawn = [line.split()[0] for line in block.splitlines() if line.strip()]
    assert len(drawn) == len(set(drawn))
    assert set(drawn) == {*_entries(PACKAGE), *_entries(PACKAGE / "registration"), *_entries(STUDIES)}


def _entries(folder: Path) -> Iterator[str]:
    for path in folder.iterdir():
        if path.name.startswith(("_", ".")):
            continue
        if path.is_dir():
            yield f"{path.relative_to(ROOT)}/"
        elif path.suffix == ".py":
            yield str(path.relative_to(ROOT))
