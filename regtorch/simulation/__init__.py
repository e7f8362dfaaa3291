"""Radiographs of a CT whose geometry is known."""

from regtorch.simulation.noise import add_quantum_noise
from regtorch.simulation.simulate import Simulation, draw_parameters, simulate

__all__ = ["Simulation", "add_quantum_noise", "draw_parameters", "simulate"]
