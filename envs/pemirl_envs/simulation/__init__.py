"""A batch of simulations behind one narrow interface."""

from pemirl_envs.simulation.base import Fields, Simulation, SimulationError, State
from pemirl_envs.simulation.mujoco_batch import MujocoBatch, available_cpus
from pemirl_envs.simulation.seeding import Seed, generator_seed

__all__ = [
    "Fields",
    "MujocoBatch",
    "Seed",
    "Simulation",
    "SimulationError",
    "State",
    "available_cpus",
    "generator_seed",
]
