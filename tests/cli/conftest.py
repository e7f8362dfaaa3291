"""Input for the commands, good and bad, and a search that takes no time."""

import json
from functools import partial
from pathlib import Path

import pytest
import torch

from regtorch.cli import main
from regtorch.formats import write_volume
from regtorch.phantom import make_phantom
from regtorch.registration import cmaes
from regtorch.registration.found import Found
from regtorch.registration.trust.evidence import measure

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
        initial, similarity = problem.searched.initial, torch.full((3,), self.similarity).double()
        starts = initial.repeat(3, 1)
        evidence = measure(problem, initial, self.similarity, starts, similarity, comparable=True)
        return Found(initial, self.similarity, starts, similarity, 3, evidence)


@pytest.fixture
def method(monkeypatch) -> Method:
    stub = Method()
    stub.tiny = partial(cmaes, starts=3, generations=2, pixels=(16, 24), survivors=1, final_generations=2)
    for name in ("cmaes", "hybrid"):
        monkeypatch.setattr(f"regtorch.registration.{name}", stub)
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
