"""What UAVs in flight see, from positions in metres."""

import numpy as np

from skyrelay.airspace.maps import PAPER_MAPS
from skyrelay.airspace.observation import Observer, Scene


def observe_team(uavs, vehicles, owner, corner, side, reach, *, n, zoom, names=PAPER_MAPS, **known):
    """[N, maps, n, n] of a whole team, drawn at once."""
    return Observer(names, n, zoom).look(Scene.in_metres(uavs, vehicles, owner, corner, side, reach, **known))


def observe(own, team, vehicles, corner, side, reach, *, n, zoom, names=PAPER_MAPS, **known):
    """[maps, n, n] of one UAV, from its own place, its team's and its own vehicles'."""
    uavs = np.vstack([np.reshape(own, (1, 2)), np.reshape(team, (-1, 2))])
    vehicles = np.reshape(vehicles, (-1, 2))
    scene = Scene.in_metres(uavs, vehicles, np.zeros(len(vehicles), dtype=int), corner, side, reach, **known)
    return Observer(names, n, zoom).look(scene, seers=1)[0]
