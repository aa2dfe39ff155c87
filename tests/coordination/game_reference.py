"""The observation as the paper tells it, in plain loops: four whole maps, a window cut out, blocks summed."""

from __future__ import annotations

import math
from fractions import Fraction

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
        result[i, 0] = location[low : low + n, left : left + n] * (2 * zoom) ** 2
        result[i, 1] = own[low : low + n, left : left + n] * (2 * zoom) ** 2
        result[i, 2], result[i, 3], result[i, 5] = (bilinear(full, n, zoom) for full in (location, team, own))
        for y in range(n):
            for x in range(n):
                result[i, 4, y, x] = coverage[y * zoom : (y + 1) * zoom, x * zoom : (x + 1) * zoom].sum()
    return result


def outlook_maps(uavs, active, vehicles, owner, reach, step, n, seen=lambda vehicle, uav: True):
    """[N, 2, n, n] levels of safe moves and of cover nearby.

    Args:
        seen: whether the line between two points is clear.
    """
    result = np.zeros((len(uavs), 2, n, n))
    team = [j for j in range(len(uavs)) if active[j]]
    tree = spanning_tree([uavs[j] for j in team])
    for i, uav in enumerate(uavs):
        if not active[i]:
            continue
        middles = []
        for a, b in tree:
            if i in (team[a], team[b]):
                middles.append(0.5 * (uavs[team[a]] + uavs[team[b]]))
        away, cells = [], []
        for action in range(9):
            heading = np.array([math.cos(math.pi * action / 4), math.sin(math.pi * action / 4)]) * (action > 0)
            place = np.clip(uav + step * heading, 0.0, 1.0)
            away.append(max([0.0] + [math.dist(place, middle) - 0.5 * (1 - 1e-5) * reach for middle in middles]))
            cells.append([n // 2 + round(c) for c in (heading[1], heading[0])])
        for far, (row, column) in zip(away, cells, strict=True):
            result[i, 0, row, column] = far <= min(away) + 1e-3 * step * (min(away) > 0)
        for row in range(n):
            for column in range(n):
                k = np.array([column, row]) - n // 2
                ring = max(abs(k))
                place = np.clip(uav + step * ring**1.25 * k / max(math.hypot(*k), 1), 0.0, 1.0)
                for v, vehicle in enumerate(vehicles):
                    if owner[v] == i and seen(vehicle, place):
                        inside = (reach**2 - math.dist(place, vehicle) ** 2) / (2 * reach)
                        result[i, 1, row, column] += min(max(inside / step + 0.5, 0.0), 1.0)
    result[:, 1] = np.rint(8 * result[:, 1])
    return result


def spanning_tree(places):
    """Pairs of neighbours, by Prim's algorithm."""
    inside, pairs = {0}, []
    while len(inside) < len(places):
        outside = set(range(len(places))) - inside
        pair = min(((a, b) for a in inside for b in outside), key=lambda ab: math.dist(places[ab[0]], places[ab[1]]))
        pairs.append(pair)
        inside.add(pair[1])
    return pairs


def bilinear(full, n, zoom):
    """A full map downsampled by the tent filter, in units of 1 / (2 zoom)^2; beyond the border the edge repeats."""
    coarse = np.zeros((n, n))
    for row in range(n * zoom):
        for column in range(n * zoom):
            y, x = ((index + 0.5) / zoom - 0.5 for index in (row, column))  # in coarse cells, centres at whole numbers
            for j in range(-1, n + 1):
                for i in range(-1, n + 1):
                    share = max(0.0, 1 - abs(y - j)) * max(0.0, 1 - abs(x - i))
                    coarse[min(max(j, 0), n - 1), min(max(i, 0), n - 1)] += share * full[row, column]
    return np.rint(coarse * (2 * zoom) ** 2)


def cell(position, cells):
    """Column and row of a position."""
    return tuple(min(max(math.floor(c * cells), 0), cells - 1) for c in position)


def normalise(levels, zoom):
    """[N, 6, n, n] the network's input, map by map."""
    result = np.zeros(levels.shape, dtype=np.float64)
    for i in range(len(levels)):
        own = max(int(levels[i, 5].sum()), 1)  # in the same unit as the levels
        for channel in range(6):
            for y in range(levels.shape[2]):
                for x in range(levels.shape[3]):
                    level = int(levels[i, channel, y, x])
                    point = (2 * zoom) ** 2
                    scales = (4.0 / point, 8.0 / own, 4.0 / point, 2.0 / point, 0.1 / zoom**2, 8.0 / own)
                    result[i, channel, y, x] = scales[channel] * level
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


def blocks(ground, air, wall):
    """Whether a wall stands in the way, by solving for where the two lines meet, in whole fractions."""
    (px, py), (qx, qy) = (tuple(map(Fraction, map(float, point))) for point in (ground, air))
    ax, ay, bx, by, rise = map(Fraction, map(float, wall))
    # p + t (q - p) = a + s (b - a), by Cramer's rule.
    a11, a12, a21, a22 = qx - px, ax - bx, qy - py, ay - by
    determinant = a11 * a22 - a12 * a21
    if determinant == 0:
        return False
    t = ((ax - px) * a22 - a12 * (ay - py)) / determinant
    s = (a11 * (ay - py) - (ax - px) * a21) / determinant
    return 0 < t < rise and 0 <= s <= 1


def sees(ground, air, walls):
    """Whether no wall blocks."""
    return not any(blocks(ground, air, wall) for wall in walls)


def inside(point, polygon):
    """Whether a point is in a polygon's interior, by the even-odd rule."""
    x, y = point
    odd = False
    for (x0, y0), (x1, y1) in zip(polygon, polygon[1:] + polygon[:1], strict=True):
        if (y0 <= y) != (y1 <= y) and x < x0 + (y - y0) / (y1 - y0) * (x1 - x0):
            odd = not odd
    return odd


def obstacle_maps(uavs, vehicles, owner, reach, walls, buildings, n, zoom):
    """[N, 3, n, n] levels; ``buildings`` are the polygons that the walls stand around."""
    cells = n * zoom
    built = np.array(
        [[any(inside(((x + 0.5) / cells, (y + 0.5) / cells), b) for b in buildings) for x in range(cells)]
         for y in range(cells)]
    )  # fmt: skip
    result = np.zeros((len(uavs), 3, n, n))
    for i in range(len(uavs)):
        left, low = (min(max(c - n // 2, 0), cells - n) for c in cell(uavs[i], cells))
        for y in range(n):
            for x in range(n):
                result[i, 0, y, x] = built[low + y, left + x]
                result[i, 1, y, x] = built[y * zoom : (y + 1) * zoom, x * zoom : (x + 1) * zoom].sum()
                centre = ((left + x + 0.5) / cells, (low + y + 0.5) / cells)
                result[i, 2, y, x] = sum(
                    math.dist(vehicles[v], centre) <= reach and sees(vehicles[v], centre, walls)
                    for v in range(len(vehicles))
                    if owner[v] == i
                )
    return result


def energy_maps(uavs, charger, radius, flight, n, zoom):
    """[N, 4, n, n] levels."""
    cells = n * zoom
    full = np.zeros((cells, cells), dtype=np.int64)
    column, row = cell(charger, cells)
    full[row, column] = 1
    result = np.zeros((len(uavs), 4, n, n))
    for i in range(len(uavs)):
        left, low = (min(max(c - n // 2, 0), cells - n) for c in cell(uavs[i], cells))
        result[i, 0] = full[low : low + n, left : left + n] * (2 * zoom) ** 2
        result[i, 1] = bilinear(full, n, zoom)
        result[i, 2] = round(255 * min(float(flight[i]) / 2, 1))
        result[i, 3] = math.dist(uavs[i], charger) <= radius
    return result
