"""A batch of simulations behind one narrow interface."""

from pemirl_envs.simulation.base import Fields, Simulation, SimulationError, State
from pemirl_envs.simulation.mujoco_batch import MujocoBatch, available_cpus

__all__ = ["Fields", "MujocoBatch", "Simulation", "SimulationError", "State", "available_cpus"]
