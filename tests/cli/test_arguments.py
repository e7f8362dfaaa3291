"""The options of the commands and their help."""

import math
import re
import subprocess
import sys

import pytest

from regtorch.arguments import parser
from regtorch.geometry import VIEWS, Detector
from regtorch.imaging import BONE_HU
from regtorch.registration.start import SEARCH
from regtorch.simulation.simulator import DETECTOR, RANGES

from .commands import REGISTER


def test_help_describes_every_command_and_loads_nothing_heavy():
    program = """
import contextlib, sys
from regtorch.cli import main
for words in ([], ["demo"], ["simulate"], ["register"], ["evaluate"], None):
    with contextlib.suppress(SystemExit):
        main(["--version"] if words is None else [*words, "--help"])
heavy = {"torch", "numpy", "numba", "SimpleITK", "matplotlib", "pandas", "cma"} & set(sys.modules)
sys.exit(f"loads {heavy}" if heavy else 0)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    for word in (
        "Exit codes: 0",
        "demo",
        "--landmark-radiograph COLUMN ROW",
        "--targets FILE",
        ".mrk.json",
        "truth.json",
        "0.1.0",
    ):
        assert word in done.stdout


def test_what_is_said_of_defaults_is_what_the_package_does(capsys):
    """The command line repeats these values, so that it need not import heavy modules."""
    found = parser().parse_args(REGISTER.split())
    assert all(map(math.isnan, [*found.source_range_mm, *found.patient_range_mm, *found.rotation_range_deg]))
    with pytest.raises(SystemExit):
        parser().parse_args(["register", "--help"])
    said = re.findall(r"its limit \(([\d ]+)\)", " ".join(capsys.readouterr().out.split()))
    assert [float(number) for text in said[:2] for number in text.split()] == list(SEARCH[:6])
    assert [math.radians(float(said[2]))] * 3 == pytest.approx(SEARCH[6:])
    assert found.threshold_hu == BONE_HU
    made = parser().parse_args(["simulate", "CT", "--view", "PA", "--out", "DIR"])
    angles = [math.radians(deg) for deg in made.rotation_range_deg]
    assert [*made.source_range_mm, *made.patient_range_mm, *angles] == pytest.approx(RANGES)
    assert Detector(made.rows, made.columns, made.pixel_mm) == DETECTOR
    for view in VIEWS:
        assert parser().parse_args(f"demo --view {view}".split()).view == view


@pytest.mark.parametrize("x", ["-10", "-1e1", "-1E+1", "-.1e2", "-10."])
def test_negative_numbers_are_no_options_however_written(x):
    options = parser().parse_args(f"{REGISTER} --landmark-ct {x} 2 {x} --threshold-hu {x}".split())
    assert options.landmark_ct == [-10, 2, -10]
    assert options.threshold_hu == -10
