"""Simulated radiographs of a CT, with known geometry."""

from regtorch.simulation.blur import add_scatter, blur_detector, blur_focal_spot
from regtorch.simulation.devices import add_devices
from regtorch.simulation.imaging_chain import realistic
from regtorch.simulation.no_grid import add_scatter_without_grid
from regtorch.simulation.noise import add_quantum_noise
from regtorch.simulation.presentation import STRENGTHS, process_for_presentation
from regtorch.simulation.readout import add_gain_and_offset, digitise
from regtorch.simulation.simulator import Simulation, draw_geometry, draw_parameters, simulate
from regtorch.simulation.soft_tissue import move_soft_tissue
from regtorch.simulation.text import add_text

__all__ = [
    "STRENGTHS",
    "Simulation",
    "add_devices",
    "add_gain_and_offset",
    "add_quantum_noise",
    "add_scatter",
    "add_scatter_without_grid",
    "add_text",
    "blur_detector",
    "blur_focal_spot",
    "digitise",
    "draw_geometry",
    "draw_parameters",
    "move_soft_tissue",
    "process_for_presentation",
    "realistic",
    "simulate",
]
