"""Imports point down: each part of the package knows only what lies below it."""

import ast
from pathlib import Path

import pytest

import regtorch

FOLDER = Path(regtorch.__file__).parent

# From the bottom; what a part may import besides itself and the package's own name and version.
BELOW = {
    "errors": set(),
    "kernel_cache": set(),
    "limits": set(),
    "batches": set(),
    "files": {"errors"},
    "geometry": {"errors"},
    "optimization": {"errors"},  # knows no X-rays
    "imaging": {"errors", "geometry", "limits"},
    "formats": {"errors", "files", "geometry", "imaging", "limits"},
    "phantom": {"errors", "geometry", "imaging"},
    "drr": {"errors", "batches", "geometry", "imaging"},
    "similarity": {"errors", "batches", "geometry", "imaging"},
    "scoring": {"errors", "batches", "geometry", "imaging", "drr", "similarity"},
    "evaluation": {"errors", "geometry", "imaging"},
    "simulation": {"errors", "geometry", "imaging", "drr"},
    "registration": {
        "errors",
        "batches",
        "limits",
        "geometry",
        "imaging",
        "drr",
        "similarity",
        "scoring",
        "evaluation",
        "optimization",
    },
}
BELOW["plotting"] = set(BELOW) - {"files"}
BELOW["arguments"] = {"errors", "limits"}  # of the command line
BELOW["output"] = {"files"}
BELOW["cli"] = set(BELOW)


def _part(file: Path) -> str:
    return file.relative_to(FOLDER).parts[0].removesuffix(".py")


def _imported(file: Path) -> set[str]:
    """Dotted names of all modules that a file imports, at its top or later."""
    names = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: a relative import, expected the whole name"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


@pytest.mark.parametrize("part", BELOW)
def test_imports_point_down(part):
    files = [file for file in FOLDER.rglob("*.py") if _part(file) == part]
    assert files
    for file in files:
        for name in _imported(file):
            package, _, rest = name.partition(".")
            assert package not in ("experiments", "tests"), f"{file} imports {name}"
            if package == "regtorch":
                imported = rest.partition(".")[0]
                assert imported in BELOW[part] | {part, "__version__"}, f"{file} imports {name}"


STUDIES = Path(__file__).parent.parent / "experiments"
PACKAGES = sorted(path.parent.name for path in STUDIES.glob("*/__init__.py"))


@pytest.mark.parametrize("study", PACKAGES)
def test_no_study_imports_another(study):
    """A command that only reads tables is not to be imported either: commands are for people."""
    for file in (STUDIES / study).rglob("*.py"):
        for name in _imported(file):
            package, _, rest = name.partition(".")
            if package == "experiments":
                imported = rest.partition(".")[0]
                assert imported in {"common", study}, f"{file} imports {name}"


def test_commands_are_short():
    for file in (*STUDIES.glob("*.py"), *STUDIES.glob("*/__main__.py")):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        functions = [node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)]
        assert functions in ([], ["main"]), f"{file} defines {functions}, expected main alone"


def test_every_part_has_its_layer():
    assert {_part(file) for file in FOLDER.rglob("*.py")} == {*BELOW, "__init__"}


def test_the_package_itself_imports_only_what_costs_nothing():
    own = {name for name in _imported(FOLDER / "__init__.py") if name.startswith("regtorch")}
    assert own == {"regtorch.kernel_cache.forget_stale_kernels"}
    assert not any(name.startswith("experiments") for name in _imported(FOLDER / "__init__.py"))


def test_all_that_the_package_offers_can_be_had():
    for name in regtorch.__all__:
        assert getattr(regtorch, name) is not None
