"""A whole scenario on one machine: the world that the agents of the protocol live in, and its record."""

from skyrelay.simulation.run import play

__all__ = ["play"]
