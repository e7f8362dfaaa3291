"""Mutation run: changes modules one place at a time, and tells which changes the tests of their own files notice.

    pip install -e '.[test,mutations]'
    python tests/mutations.py [--share 0.2] [--only geometry] [--out results/mutations]

cosmic-ray makes the mutants, in a copy of the checkout. Modules are plain Python and torch; numba and Triton compile
kernels by ways of their own, so kernels are left out. Tests run in a fork of this program, which has torch loaded.
Left out as well: annotations, messages of errors, decorators, and ``strict`` of ``zip``.
"""

import argparse
import ast
import hashlib
import math
import os
import platform
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

import beartype  # noqa: F401
import cma  # noqa: F401
import jaxtyping  # noqa: F401
import numba  # noqa: F401
import pandas as pd
import parso
import pytest
import torch
from cosmic_ray.ast import ast_nodes, get_ast, is_number
from cosmic_ray.mutating import mutate_code
from cosmic_ray.operators.operator import Operator
from cosmic_ray.plugins import get_operator

ROOT = Path(__file__).parent.parent

OWN_TESTS = {
    "geometry/conventions.py": ["geometry/test_conventions.py"],
    "geometry/detector.py": ["geometry/test_detector.py"],
    "geometry/parameters.py": ["geometry/test_parameters.py"],
    "geometry/projection.py": ["geometry/test_projection.py"],
    "geometry/rays.py": ["geometry/test_rays.py"],
    "geometry/rotation.py": ["geometry/test_rotation.py"],
    "geometry/views.py": ["geometry/test_rotation.py"],
    "optimization/box.py": ["optimization/test_box.py", "optimization/test_evolution_strategy.py"],
    "optimization/climbing.py": ["optimization/test_climbing.py"],
    "optimization/evolution_climbing.py": ["optimization/test_evolution_climbing.py"],
    "optimization/evolution_strategy.py": ["optimization/test_evolution_strategy.py"],
    "optimization/partition.py": ["optimization/test_partition.py"],
    "optimization/rows.py": ["optimization/test_evolution_strategy.py"],
    "optimization/start.py": ["optimization/test_evolution_strategy.py"],
    "optimization/stopping.py": ["optimization/test_stopping.py"],
    "optimization/strategy.py": ["optimization/test_strategy.py", "optimization/test_stopping.py"],
    "registration/trust/evidence.py": ["registration/test_trust.py"],
    "registration/trust/limits.py": ["registration/test_trust.py", "experiments/calibration/test_calibration.py"],
    "registration/trust/rules.py": ["registration/test_trust.py"],
    "registration/trust/uncertainty.py": ["registration/test_uncertainty.py"],
}
"""Modules of the package, and the tests of each: files that a checkout lacks are skipped."""

_BINARY = "Add_Sub Sub_Add Mul_Div Div_Mul FloorDiv_Div Mod_Mul Pow_Mul BitAnd_BitOr BitOr_BitAnd"
_COMPARED = "Lt_LtE Lt_GtE LtE_Lt LtE_Gt Gt_GtE Gt_LtE GtE_Gt GtE_Lt Eq_NotEq NotEq_Eq Is_IsNot IsNot_Is"
_OTHERS = (
    "ReplaceUnaryOperator_USub_UAdd ReplaceUnaryOperator_Delete_Not ReplaceUnaryOperator_Delete_Invert AddNot "
    "ReplaceTrueWithFalse ReplaceFalseWithTrue ReplaceAndWithOr ReplaceOrWithAnd ReplaceBreakWithContinue "
    "ReplaceContinueWithBreak ZeroIterationForLoop"
)
OPERATORS = [
    *(f"ReplaceBinaryOperator_{pair}" for pair in _BINARY.split()),
    *(f"ReplaceComparisonOperator_{pair}" for pair in _COMPARED.split()),
    *_OTHERS.split(),
]
"""Of cosmic-ray. Numbers have an operator of their own, and pairs of operators that end in type errors are left out."""


class Number(Operator):
    """Whole numbers one more or less; others half or half as much again."""

    def mutation_positions(self, node):
        if is_number(node):
            yield from [(node.start_pos, node.end_pos)] * 2

    def mutate(self, node, index):
        whole = node.value.isdigit()
        value = int(node.value) + (1, -1)[index] if whole else float(node.value) * (1.5, 0.5)[index]
        return parso.python.tree.Number(repr(value), node.start_pos, node.prefix)

    @classmethod
    def examples(cls):
        return ()


@dataclass(frozen=True)
class Mutant:
    """One change of one module: ``before`` and ``after`` are the line that differs."""

    module: str
    operator: str
    occurrence: int
    line: int
    before: str
    after: str

    @property
    def order(self) -> str:
        """Of a sample: by chance, the same each time, and untouched by changes of other lines."""
        return hashlib.sha256(f"{self.module} {self.operator} {self.before} {self.after}".encode()).hexdigest()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--share", type=float, default=1.0, help="of each module's mutants")
    parser.add_argument("--only", default="", help="part of a module's name")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "mutations")
    options = parser.parse_args()
    began, rows, survivors = time.perf_counter(), [], []
    with tempfile.TemporaryDirectory() as folder:
        copy = _copied(Path(folder) / "checkout")
        for module in (module for module in OWN_TESTS if options.only in module):
            row, alive = _run(copy, module, options.share)
            rows.append(row)
            survivors += alive
            print(*row.values(), f"{(time.perf_counter() - began) / 60:.1f} min", flush=True)
    _write(options.out, pd.DataFrame(rows), survivors, options.share, time.perf_counter() - began)


def _copied(copy: Path) -> Path:
    """What tests read, without compiled code: a stale one would hide mutants."""
    for name in ("regtorch", "experiments", "conf", "tests", "results/calibration"):
        shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", copy)
    return copy


def _run(copy: Path, module: str, share: float) -> tuple[dict[str, object], list[Mutant]]:
    path = copy / "regtorch" / module
    source = path.read_text(encoding="utf-8")
    tests = [f"tests/{name}" for name in OWN_TESTS[module] if (copy / "tests" / name).exists()]
    every = sorted(mutants(module, source), key=lambda mutant: mutant.order)
    some = every[: math.ceil(share * len(every))]
    for _ in range(2):  # the first one compiles
        began = time.perf_counter()
        if not _pass(copy, tests, 600):
            raise SystemExit(f"{module}: the tests fail without a mutation: {' '.join(tests)}")
    limit = 10 + 4 * (time.perf_counter() - began)
    alive = []
    for mutant in some:
        path.write_text(_mutated(source, mutant.operator, mutant.occurrence), encoding="utf-8")
        _forget(path)
        if _pass(copy, tests, limit):
            alive.append(mutant)
            print(f"  {module}:{mutant.line}: {mutant.after}", flush=True)
    path.write_text(source, encoding="utf-8")
    _forget(path)
    return {"module": module, "mutants": len(every), "run": len(some), "killed": len(some) - len(alive)}, alive


def _forget(path: Path) -> None:
    for compiled in (path.parent / "__pycache__").glob(f"{path.stem}.*.pyc"):
        compiled.unlink()


def mutants(module: str, source: str) -> Iterator[Mutant]:
    """Every mutant of a module that differs from it and can be compiled."""
    left_out = list(_left_out(source))
    lines = source.splitlines()
    for name in ["Number", *OPERATORS]:
        operator = _operator(name)
        places = [start for node in ast_nodes(get_ast(source)) for start, _ in operator.mutation_positions(node)]
        for occurrence, place in enumerate(places):
            if any(start <= place < end for start, end in left_out):
                continue
            changed = _mutated(source, name, occurrence).splitlines()
            differ = [n for n, (old, new) in enumerate(zip(lines, changed, strict=False)) if old != new]
            if differ:
                first = differ[0]
                yield Mutant(module, name, occurrence, first + 1, lines[first].strip(), changed[first].strip())


def _operator(name: str) -> Operator:
    return Number() if name == "Number" else get_operator(f"core/{name}")()


def _mutated(source: str, name: str, occurrence: int) -> str:
    return mutate_code(source, _operator(name), occurrence) or source


def _left_out(source: str) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """Starts and ends of what is not mutated: (line, column)."""
    for node in ast.walk(ast.parse(source)):
        parts = [getattr(node, "annotation", None), getattr(node, "returns", None)]
        if isinstance(node, ast.Raise | ast.JoinedStr) or (isinstance(node, ast.keyword) and node.arg == "strict"):
            parts.append(node)
        for part in parts:
            if part is not None:
                yield (part.lineno, part.col_offset), (part.end_lineno, part.end_col_offset)


def _pass(copy: Path, tests: list[str], limit: float) -> bool:
    """Whether the tests pass, in a fork of this process. Tests that take longer than ``limit`` seconds fail."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            silence = os.open(os.devnull, os.O_WRONLY)
            os.dup2(silence, 1)
            os.dup2(silence, 2)
            os.chdir(copy)
            sys.path[:] = [str(copy), *(entry for entry in sys.path if Path(entry or ".").resolve() != ROOT)]
            code = int(pytest.main(["-x", "--tb=no", *tests]))
        finally:
            os._exit(code)
    end = time.perf_counter() + limit
    while time.perf_counter() < end:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return status == 0
        time.sleep(0.02)
    os.kill(child, 9)
    os.waitpid(child, 0)
    return False


def _write(out: Path, table: pd.DataFrame, survivors: list[Mutant], share: float, seconds: float) -> None:
    out.mkdir(parents=True, exist_ok=True)
    columns = list(Mutant.__dataclass_fields__)
    pd.DataFrame([asdict(mutant) for mutant in survivors], columns=columns).to_csv(out / "survivors.csv", index=False)
    total = {"module": "all", **table[["mutants", "run", "killed"]].sum().to_dict()}
    rows = [
        f"| {row['module']} | {row['mutants']} | {row['run']} | {row['killed']} | {row['killed'] / row['run']:.0%} |"
        for row in [*table.to_dict("records"), total]
    ]
    versions = ", ".join(f"{name} {version(name)}" for name in ("cosmic-ray", "pytest", "torch"))
    text = [
        "Mutants of each module that the tests of its own files kill. `survivors.csv` lists the others.",
        "",
        f"`python tests/mutations.py --share {share:g}`: {seconds / 60:.0f} minutes on one core.",
        f"Python {platform.python_version()}, {versions}. Kernels that numba or Triton compile are left out.",
        "",
        "| module | mutants | run | killed | share |",
        "|---|---|---|---|---|",
        *rows,
    ]
    (out / "table.md").write_text("\n".join(text) + "\n", encoding="utf-8")


if __name__ == "__main__":
    torch.set_num_threads(1)
    main()
