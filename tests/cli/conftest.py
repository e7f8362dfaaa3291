"""Input for the commands, good and bad, and a search that takes no time."""

import json
from functools import partial
from pathlib import Path

import pytest
import torch

from regtorch.cli import main
from regtorch.formats import write_volume
from regtorch.phantom import make_phantom
from regtorch.registration import evolution as evolution_module
from regtorch.registration import hybrid as hybrid_module
from regtorch.registration.problem import Found

from .bad_files import bad_radiographs, bad_texts, bad_volumes
from .commands import SIZE, result_of


class Method:
    """Stands in for the search: remembers the problem and answers with the start, or runs a tiny search."""

    def __init__(self) -> None:
        self.problems, self.similarity, self.search = [], 0.5, None

    def __call__(self, problem, **options):
        self.problems.append(problem)
        problem.progress(0.1, "searching")
        if self.search is not None:
            return self.search(problem, **options)
        starts = problem.initial.repeat(3, 1)
        return Found(problem.initial, self.similarity, starts, torch.full((3,), self.similarity).double(), 3)


@pytest.fixture
def method(monkeypatch) -> Method:
    stub = Method()
    stub.tiny = partial(
        evolution_module.evolution, starts=3, generations=2, pixels=(16, 24), survivors=1, final_generations=2
    )
    monkeypatch.setattr(evolution_module, "evolution", stub)
    monkeypatch.setattr(hybrid_module, "hybrid", stub)
    return stub


@pytest.fixture(scope="session")
def inputs(tmp_path_factory) -> Path:
    """A CT and a radiograph of it that are in order (``ct.nii.gz``, ``good/``) among much that is not."""
    folder = tmp_path_factory.mktemp("inputs")
    ct, _ = make_phantom(6.0)
    write_volume(folder / "ct.nii.gz", ct)
    assert main(f"simulate {folder}/ct.nii.gz --view PA {SIZE} --out {folder}/good".split()) == 0
    answer = result_of(folder / "good" / "truth.json")
    (folder / "good" / "result.json").write_text(json.dumps(answer))
    bad_volumes(folder)
    bad_radiographs(folder)
    bad_texts(folder, json.loads((folder / "good" / "truth.json").read_text()))
    (folder / "taken" / "result.json").mkdir(parents=True)
    (folder / "taken" / "truth.json").mkdir()
    return folder
