"""Agents as processes of their own: the bus, the world, the chain server, positions, autopilots, metrics."""
