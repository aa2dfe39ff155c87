/* What is where at one moment, between two steps interpolated: typed arrays that are used again from frame to frame. */

import { teamsOf } from "./run.js";

let room = 0;
let columns = null;

function grown(count) {
  if (count > room || !columns) {
    room = Math.max(1024, 2 * count);
    columns = {
      vehicle: new Int32Array(room), x: new Float32Array(room), y: new Float32Array(room),
      uav: new Int32Array(room), covered: new Uint8Array(room),
    };
  }
  return columns;
}

export function observe(run, kind, time, still) {
  const at = Math.max(run.first, Math.min(run.steps, Math.floor(time + 1e-6)));
  const part = still || at >= run.steps ? 0 : time - at;
  const frame = run.frame(kind, at), fleet = run.fleet(kind, at);
  const nextFrame = part > 0 ? run.frame(kind, at + 1) : frame;
  const nextFleet = part > 0 ? run.fleet(kind, at + 1) : fleet;

  const count = run.uavs.length;
  const uavs = {
    count, x: new Float32Array(count), y: new Float32Array(count), zone: new Int32Array(count),
    state: new Uint8Array(count), battery: fleet.battery, age: fleet.age,
    serves: new Int32Array(count), covers: new Int32Array(count),
  };
  for (let u = 0; u < count; u++) {
    const state = (uavs.state[u] = fleet.state[u] ?? 0);
    if (!(state & 1)) continue; // it has landed
    uavs.zone[u] = fleet.zone[u];
    const moves = part > 0 && nextFleet.state[u] & 1;
    uavs.x[u] = fleet.x[u] + (moves ? (nextFleet.x[u] - fleet.x[u]) * part : 0);
    uavs.y[u] = fleet.y[u] + (moves ? (nextFleet.y[u] - fleet.y[u]) * part : 0);
  }

  const vehicles = grown(frame.count);
  let served = 0, covered = 0;
  for (let k = 0; k < frame.count; k++) {
    const v = frame.vehicle[k], uav = frame.uav[k];
    const next = part > 0 ? nextFrame.place[v] : -1;
    vehicles.vehicle[k] = v;
    vehicles.x[k] = frame.x[k] + (next >= 0 ? (nextFrame.x[next] - frame.x[k]) * part : 0);
    vehicles.y[k] = frame.y[k] + (next >= 0 ? (nextFrame.y[next] - frame.y[k]) * part : 0);
    vehicles.uav[k] = uav;
    vehicles.covered[k] = frame.covered[k];
    if (uav < 0) continue;
    served++;
    covered += frame.covered[k];
    uavs.serves[uav]++;
    uavs.covers[uav] += frame.covered[k];
  }

  const teams = teamsOf(uavs);
  const links = [];
  for (const team of teams.values()) {
    for (let a = 0; a < team.length; a++) {
      for (let b = a + 1; b < team.length; b++) {
        const [i, j] = [team[a], team[b]];
        if (Math.hypot(uavs.x[i] - uavs.x[j], uavs.y[i] - uavs.y[j]) <= run.range) links.push(i, j);
      }
    }
  }
  return { at, time, count: frame.count, vehicles, place: frame.place, traffic: frame.traffic, served, covered, uavs, teams, links };
}

/* Where a picked member is, or null where it is away or has landed. */
export function whereIs(scene, picked) {
  if (!picked) return null;
  if (picked.kind === "uav") {
    return scene.uavs.state[picked.index] & 1 ? [scene.uavs.x[picked.index], scene.uavs.y[picked.index]] : null;
  }
  const k = scene.place[picked.index] ?? -1;
  return k < 0 ? null : [scene.vehicles.x[k], scene.vehicles.y[k]];
}
