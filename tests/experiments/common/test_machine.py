"""Rows name the libraries and the processor that made them."""

import numpy as np
import torch

from experiments.common.machine import MACHINE, _processor, machine


def test_versions_are_those_of_the_loaded_libraries():
    told = machine()
    assert tuple(told) == MACHINE
    assert (told["torch"].split("+")[0], told["numpy"]) == (torch.__version__.split("+")[0], np.__version__)
    assert told["processor"]


def test_the_processor_is_the_model_that_linux_tells(tmp_path):
    told = tmp_path / "cpuinfo"
    told.write_text(2 * "processor\t: 0\nmodel name\t: Some CPU @ 2.0 GHz\n")
    assert _processor(told) == "Some CPU @ 2.0 GHz"
    assert _processor(tmp_path / "none")
