"""A command's output: a bar while it works, text for people and JSON for programs when it is done."""

import json
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from regtorch.files import write_text


@contextmanager
def progress_bar(what: str = "") -> Iterator[Callable[[float, str], None]]:
    """A function of the share done and the next step's name; shown on stderr, on a terminal only."""
    from tqdm import tqdm

    def progress(share: float, what: str) -> None:
        bar.set_description_str(what, refresh=False)
        bar.update(max(0.0, round(100 * share, 1) - bar.n))  # a search that looks further says an earlier share

    layout = {"bar_format": "{desc} {bar} {elapsed} < {remaining}", "leave": False}
    with tqdm(desc=what, total=100, disable=None, mininterval=0, miniters=0, **layout) as bar:
        yield progress


def print_result(result) -> None:
    print(f"{result.status}: {result.message}")
    for line in result.warnings:
        print(f"warning: {line}")
    print(f"similarity {result.similarity:.4f}, {result.evaluations} evaluations, {result.seconds:.1f} s")
    found = result.to_dict()
    if "expected_pde_mm" in found:
        expected, limit = found["expected_pde_mm"], found["pde_95_mm"]
        print(
            f"expected error in the image {expected:.3f} mm, below {limit:.3f} mm in 95 % of cases like those simulated"
        )
    deviations = found.get("standard_deviations", {})
    for key, value in found["parameters"].items():
        print(f"  {key:10} {value:10.3f}" + (f" +- {deviations[key]:.3f}" if deviations else ""))


def print_evaluation(found: dict[str, Any]) -> None:
    count = len(found["targets"])
    if behind := sum(not math.isfinite(target["pde_mm"]) for target in found["targets"].values()):
        print(f"pde_mm           infinite ({behind} of {count} targets behind the source; null in JSON)")
    else:
        print(f"pde_mm           {found['pde_mm']:.4f}   (mean over {count} targets, in the detector plane)")
    print(f"target_error_mm  {found['target_error_mm']:.4f}   (in space, seen from the detector)")
    print("parameter_errors")
    for key, value in found["parameter_errors"].items():
        print(f"  {key:10} {value:+10.4f}")


def to_json(content: dict[str, Any]) -> str:
    """JSON has no infinity: numbers that are not finite become null."""
    return json.dumps(_with_null(content), indent=2, allow_nan=False)


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Raises ``RegtorchError`` where ``path`` cannot be written."""
    write_text(path, to_json(content) + "\n")


def _with_null(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _with_null(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_with_null(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
