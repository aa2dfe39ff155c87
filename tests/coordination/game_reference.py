"""The observation as the paper tells it, in plain loops: four whole maps, a window cut out, blocks summed."""

from __future__ import annotations

import math

import numpy as np


def observe(uavs, active, vehicles, owner, reach, n, zoom):
    """[N, 6, n, n] levels; arguments as `skyrelay.coordination.observation.observe`, lengths in zone sides."""
    cells = n * zoom
    result = np.zeros((len(uavs), 6, n, n), dtype=np.int64)
    for i in range(len(uavs)):
        if not active[i]:
            continue
        location, team, coverage, own = (np.zeros((cells, cells), dtype=np.int64) for _ in range(4))
        column, row = cell(uavs[i], cells)
        location[row, column] = 1
        for j in range(len(uavs)):
            if not active[j]:
                continue
            if j != i:
                other_column, other_row = cell(uavs[j], cells)
                team[other_row, other_column] += 1
            for y in range(cells):
                for x in range(cells):
                    dx, dy = uavs[j][0] - (x + 0.5) / cells, uavs[j][1] - (y + 0.5) / cells
                    coverage[y, x] += dx * dx + dy * dy <= reach * reach
        for v in range(len(vehicles)):
            if owner[v] == i:
                vehicle_column, vehicle_row = cell(vehicles[v], cells)
                own[vehicle_row, vehicle_column] += 1
        left, low = (min(max(c - n // 2, 0), cells - n) for c in (column, row))
        result[i, 0] = location[low : low + n, left : left + n]
        result[i, 1] = own[low : low + n, left : left + n]
        for channel, full in ((2, location), (3, team), (4, coverage), (5, own)):
            for y in range(n):
                for x in range(n):
                    result[i, channel, y, x] = full[y * zoom : (y + 1) * zoom, x * zoom : (x + 1) * zoom].sum()
    return result


def cell(position, cells):
    """Column and row of a position."""
    return tuple(min(max(math.floor(c * cells), 0), cells - 1) for c in position)


def normalise(levels, zoom):
    """[N, 6, n, n] the network's input, map by map."""
    result = np.zeros(levels.shape, dtype=np.float64)
    for i in range(len(levels)):
        own = max(int(levels[i, 5].sum()), 1)
        for channel in range(6):
            for y in range(levels.shape[2]):
                for x in range(levels.shape[3]):
                    level = int(levels[i, channel, y, x])
                    if channel in (1, 5):
                        result[i, channel, y, x] = 4.0 * level / own
                    elif channel == 4:
                        result[i, channel, y, x] = level / (2 * zoom * zoom)
                    else:
                        result[i, channel, y, x] = level
    return result


def connected(points, reach):
    """Whether a path of links joins every two points, by depth-first search."""
    if not points:
        return True
    seen, stack = {0}, [0]
    while stack:
        i = stack.pop()
        for j in range(len(points)):
            if j not in seen and math.dist(points[i], points[j]) <= reach:
                seen.add(j)
                stack.append(j)
    return len(seen) == len(points)
