/* What a UAV sees: the six maps that every policy looks at, as levels, by the rules of skyrelay/airspace/observation.py
   (the tests hold both against each other). Row 0 is the zone's south, column 0 its west. */

export const CELLS = 11; // of a side of a map, as the shipped policy for open ground has it
const ZOOM = 3; // of the full maps over that
const FULL = CELLS * ZOOM, WHOLE = (2 * ZOOM) ** 2;

export const NAMES = ["itself, near", "its vehicles, near", "itself", "its team", "covered", "its vehicles"];

const clipped = (value, high) => Math.max(0, Math.min(high, value));
const cellOf = (share) => clipped(Math.floor(share * FULL), FULL - 1);

/* Along an axis, the two nearest coarse cells of a full map's cell, and their shares. */
function tent(cell) {
  const near = Math.floor(cell / ZOOM), offset = 2 * (cell % ZOOM) + 1 - ZOOM, beside = Math.abs(offset);
  return [[near, 2 * ZOOM - beside], [clipped(near + Math.sign(offset), CELLS - 1), beside]];
}

function scatter(map, column, row) {
  for (const [y, down] of tent(row)) for (const [x, across] of tent(column)) map[y * CELLS + x] += across * down;
}

export function sixMaps(run, scene, index) {
  const { uavs, vehicles } = scene;
  const zone = uavs.zone[index];
  const [x0, y0, x1] = run.zoneArea(zone);
  const side = x1 - x0, reach = run.range / side;
  const share = (x, y) => [clipped((x - x0) / side, 1), clipped((y - y0) / side, 1)];
  const maps = Array.from({ length: 6 }, () => new Float32Array(CELLS ** 2));
  const [localLocation, localVehicles, location, team, coverage, own] = maps;

  const [column, row] = share(uavs.x[index], uavs.y[index]).map(cellOf);
  const window = [column, row].map((cell) => clipped(cell - Math.floor(CELLS / 2), FULL - CELLS));
  localLocation[(row - window[1]) * CELLS + column - window[0]] = WHOLE;
  scatter(location, column, row);

  const others = (scene.teams.get(zone) ?? []).filter((u) => u !== index);
  for (const u of others) scatter(team, ...share(uavs.x[u], uavs.y[u]).map(cellOf));
  for (const u of [index, ...others]) {
    const [x, y] = share(uavs.x[u], uavs.y[u]);
    for (let i = 0; i < FULL; i++) {
      for (let j = 0; j < FULL; j++) {
        const dx = x - (j + 0.5) / FULL, dy = y - (i + 0.5) / FULL;
        if (dy * dy + dx * dx <= reach * reach) coverage[Math.floor(i / ZOOM) * CELLS + Math.floor(j / ZOOM)]++;
      }
    }
  }

  for (let k = 0; k < scene.count; k++) {
    if (vehicles.uav[k] !== index) continue;
    const [c, r] = share(vehicles.x[k], vehicles.y[k]).map(cellOf);
    scatter(own, c, r);
    const [i, j] = [r - window[1], c - window[0]];
    if (i >= 0 && j >= 0 && i < CELLS && j < CELLS) localVehicles[i * CELLS + j] += WHOLE;
  }
  return maps;
}
