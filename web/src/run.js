/* What a run holds, whichever way it came. Positions are metres from `origin`, so that 32 bits hold them anywhere.

   Both kinds answer the same questions:
     frame(kind, step)  who is where: { count, vehicle, x, y, uav, covered, place }, columns by row; place[vehicle] is a
                        vehicle's row, -1 where it is away; traffic(row): what it asks for, what is carried and delivered
                        of it [kbit/s], where that is known. kind is "" (as flown) or "static_" (the comparator).
     fleet(kind, step)  { x, y, zone, state, battery, age }, by UAV; state bit 0: in the air, bit 1: selected.
     metric(name, zone) a value for each step from 0 to `steps` (zone 0: the whole area), NaN where there is none. */

const POSITIONS = ["vehicle_x", "vehicle_y", "uav_x", "uav_y", "uav_static_x", "uav_static_y"];
const TYPES = { Uint8Array, Uint16Array, Int32Array, Float32Array };

/* The payload of a page on disk: see skyrelay/report/payload.py for its layout. */
export async function fromPayload(text) {
  const binary = atob(text);
  const packed = new Uint8Array(binary.length);
  for (let i = 0; i < binary.length; i++) packed[i] = binary.charCodeAt(i);
  const inflated = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = await new Response(inflated).arrayBuffer();
  const length = new DataView(bytes).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, 4, length)));
  const arrays = {};
  for (const [name, [type, offset, size]] of Object.entries(header.arrays)) {
    arrays[name] = new TYPES[type](bytes, 4 + length + offset, size);
  }
  return new RecordedRun(header, arrays);
}

class Run {
  constructor() {
    this.first = 0;
    this.frames = new Map();
    this.named = { vehicle: new Map(), uav: new Map() };
  }

  find(kind, id) {
    return this.named[kind].get(id) ?? -1;
  }

  /* Corners of the whole area. */
  get area() {
    const { x0, y0, side, columns, rows } = this.grid;
    return [x0, y0, x0 + side * columns, y0 + side * rows];
  }

  zoneAt(x, y) {
    const { x0, y0, side, columns, rows } = this.grid;
    const column = Math.floor((x - x0) / side), row = Math.floor((y - y0) / side);
    return column >= 0 && row >= 0 && column < columns && row < rows ? row * columns + column + 1 : 0;
  }

  zoneArea(zone) {
    const { x0, y0, side, columns } = this.grid;
    const x = x0 + ((zone - 1) % columns) * side, y = y0 + Math.floor((zone - 1) / columns) * side;
    return [x, y, x + side, y + side];
  }

  periodOf(step) {
    return Math.floor(Math.max(0, step) / this.periodSteps);
  }
}

export class RecordedRun extends Run {
  constructor(header, arrays) {
    super();
    const [x0, y0, x1, y1] = header.box;
    Object.assign(this, arrays, header, { live: false, origin: [x0, y0] });
    this.box = [0, 0, x1 - x0, y1 - y0];
    this.grid = { ...header.grid, x0: header.grid.x0 - x0, y0: header.grid.y0 - y0 };
    this.columns = this.steps + 1;
    const shifted = (line) => line.map((value, i) => value - this.origin[i % 2]);
    this.buildings = header.buildings.map(({ corners, height }) => ({ corners: shifted(corners), height }));
    this.charging = header.charging
      ? header.charging.points.map((point) => [...shifted(point), header.charging.radius]) : [];
    this.streets = [];
    for (let i = 0, at = 0; i < arrays.street_length.length; at += arrays.street_length[i++]) {
      const line = new Float32Array(2 * arrays.street_length[i]);
      for (let k = 0; k < line.length / 2; k++) {
        line[2 * k] = arrays.street_x[at + k];
        line[2 * k + 1] = arrays.street_y[at + k];
      }
      this.streets.push(line);
    }
    for (const name of POSITIONS) {
      const length = name.endsWith("x") ? x1 - x0 : y1 - y0;
      const metres = new Float32Array(arrays[name].length);
      for (let i = 0, sum = 0; i < metres.length; i++) {
        sum = (sum + arrays[name][i]) & 0xffff;
        metres[i] = (sum / 65535) * length;
      }
      this[name] = metres;
    }
    header.vehicles.forEach((id, i) => this.named.vehicle.set(id, i));
    header.uavs.forEach((id, i) => this.named.uav.set(id, i));
    // The rows of each step, one after the other.
    this.starts = new Int32Array(this.columns + 1);
    for (const step of this.vehicle_step) this.starts[step + 1]++;
    for (let step = 0; step < this.columns; step++) this.starts[step + 1] += this.starts[step];
    this.rows = new Int32Array(this.vehicle.length);
    const next = this.starts.slice();
    for (let i = 0; i < this.vehicle.length; i++) this.rows[next[this.vehicle_step[i]]++] = i;
    this.tracksLast = this.vehicle.length;
    this.proposals = this.#indexProposals();
    this.alerts = header.alerts.map(([step, kind, about, text]) => ({ step, kind, about, text }));
  }

  frame(kind, step) {
    const key = kind + step;
    let frame = this.frames.get(key);
    if (frame) return frame;
    const rows = this.rows.subarray(this.starts[step], this.starts[step + 1]);
    const count = rows.length;
    frame = {
      count, vehicle: new Int32Array(count), x: new Float32Array(count), y: new Float32Array(count),
      uav: new Int32Array(count), covered: new Uint8Array(count), place: new Int32Array(this.vehicles.length).fill(-1),
      traffic: (k) => ["demand", kind + "carried", kind + "delivered"].map((name) => this["vehicle_" + name][rows[k]]),
    };
    const owners = this[`vehicle_${kind}uav`], covered = this[`vehicle_${kind}covered`];
    for (let k = 0; k < count; k++) {
      const i = rows[k];
      frame.vehicle[k] = this.vehicle[i];
      frame.x[k] = this.vehicle_x[i];
      frame.y[k] = this.vehicle_y[i];
      frame.uav[k] = owners[i];
      frame.covered[k] = covered[i];
      frame.place[this.vehicle[i]] = k;
    }
    if (this.frames.size >= 8) this.frames.delete(this.frames.keys().next().value);
    this.frames.set(key, frame);
    return frame;
  }

  fleet(kind, step) {
    const count = this.uavs.length;
    const at = (values) => Float32Array.from({ length: count }, (_, u) => values[u * this.columns + step]);
    return {
      x: at(this[`uav_${kind}x`]), y: at(this[`uav_${kind}y`]), zone: at(this[`uav_${kind}zone`]),
      state: at(this[`uav_${kind}state`]), battery: at(this.uav_battery), age: null,
    };
  }

  metric(name, zone) {
    const start = this.metricZones.indexOf(zone) * this.columns;
    const values = this["metric_" + name];
    return start < 0 || !values ? new Float32Array(this.columns).fill(NaN) : values.subarray(start, start + this.columns);
  }

  eventCount() {
    return this.event_step.length;
  }

  event(i) {
    return { step: this.event_step[i], block: this.event_block[i], name: this.eventNames[this.event_name[i]], parts: this.eventArgs[i] };
  }

  /* By period: how many proposals, how many accepted, and each vehicle's last one. */
  #indexProposals() {
    const periods = {};
    for (let i = 0; i < this.proposal_period.length; i++) {
      const period = (periods[this.proposal_period[i]] ??= { asked: 0, accepted: 0, of: new Map() });
      period.asked++;
      period.accepted += this.proposal_accepted[i];
      period.of.set(this.proposal_vehicle[i], i);
    }
    return periods;
  }
}

const MOST_ROWS = 4_000_000;
const MOST_EVENTS = 100_000;

/* A fleet as its feed tells of it (skyrelay/runfolder/feed.py): it grows by a record at a time and forgets the oldest. */
export class LiveRun extends Run {
  constructor(header) {
    super();
    const { x0, y0 } = header.grid;
    const { side, columns, rows } = header.grid;
    Object.assign(this, {
      live: true, session: header.session, name: header.name, stepSeconds: header.step_seconds,
      periodSteps: header.period_steps, range: header.range_m, reserve: header.reserve, origin: [x0, y0],
      grid: { x0: 0, y0: 0, side, columns, rows }, box: [0, 0, side * columns, side * rows],
      vehicles: [], uavs: [], colours: [], steps: 0, first: -1, alerts: [], events: [], proposals: {}, held: 0,
      metricZones: [0], eventNames: [], zonesWithTeams: new Set(),
    });
    const shifted = (line) => line.map((value, i) => value - (i % 2 ? y0 : x0));
    this.buildings = header.buildings.map(([corners, height]) => ({ corners: shifted(corners), height }));
    this.places = header.places;
    this.charging = header.charging.map(([x, y, radius]) => [x - x0, y - y0, radius]);
    this.streets = header.streets.map((line) => Float32Array.from(shifted(line)));
    this.metrics = new Map();
  }

  #index(kind, id) {
    const known = this.named[kind].get(id);
    if (known !== undefined) return known;
    const names = kind === "uav" ? this.uavs : this.vehicles;
    this.named[kind].set(id, names.length);
    names.push(id);
    if (kind === "uav") this.colours.push((names.length - 1) % 8);
    return names.length - 1;
  }

  /* Returns whether it was new. A second record of the newest step takes the place of the first, and adds what it tells. */
  add(record) {
    if (this.first >= 0 && record.step < this.steps) return false;
    const before = this.frames.get(record.step);
    if (before) this.held -= before.count + before.fleet.state.length + 1;
    const [x0, y0] = this.origin;
    const size = Math.max(this.uavs.length, record.uavs.length);
    const fleet = { x: [], y: [], zone: [], state: [], battery: [], age: [] };
    for (const [id, x, y, zone, battery, selected, age] of record.uavs) {
      const u = this.#index("uav", id);
      fleet.x[u] = x - x0;
      fleet.y[u] = y - y0;
      fleet.zone[u] = zone;
      fleet.state[u] = zone > 0 ? 1 + 2 * selected : 0;
      fleet.battery[u] = battery;
      fleet.age[u] = age ?? NaN;
    }
    for (let u = 0; u < Math.max(size, this.uavs.length); u++) if (fleet.state[u] === undefined) fleet.state[u] = 0;
    const count = record.vehicles.length;
    const frame = {
      count, vehicle: new Int32Array(count), x: new Float32Array(count), y: new Float32Array(count),
      uav: new Int32Array(count), covered: new Uint8Array(count), place: null, fleet,
    };
    record.vehicles.forEach(([id, x, y, uav, covered], k) => {
      frame.vehicle[k] = this.#index("vehicle", id);
      frame.x[k] = x - x0;
      frame.y[k] = y - y0;
      frame.uav[k] = uav ? this.#index("uav", uav) : -1;
      frame.covered[k] = covered;
    });
    this.frames.set(record.step, frame);
    this.held += count + fleet.state.length + 1;
    if (this.first < 0) this.first = record.step;
    this.steps = record.step;
    for (const [block, name, parts] of record.events) {
      if (!this.eventNames.includes(name)) this.eventNames.push(name);
      this.events.push({ step: record.step, block, name, parts });
    }
    for (const [kind, about, text] of record.alerts) this.alerts.push({ step: record.step, kind, about, text });
    if (this.events.length > MOST_EVENTS) this.events.splice(0, this.events.length - MOST_EVENTS);
    if (this.alerts.length > MOST_EVENTS) this.alerts.splice(0, this.alerts.length - MOST_EVENTS);
    this.#measure(record.step, frame);
    while (this.held > MOST_ROWS && this.frames.size > 2) {
      const [oldest, { count: rows, fleet: old }] = this.frames.entries().next().value;
      this.frames.delete(oldest);
      this.held -= rows + old.state.length + 1;
      this.first = this.frames.keys().next().value;
    }
    return true;
  }

  /* A step that never came shows the last one before it. */
  #held(step) {
    for (let at = Math.min(step, this.steps); at >= this.first; at--) {
      const frame = this.frames.get(at);
      if (frame) return frame;
    }
    return this.frames.get(this.first) ?? EMPTY;
  }

  frame(_kind, step) {
    const frame = this.#held(step);
    if (!frame.place || frame.place.length < this.vehicles.length) {
      frame.place = new Int32Array(this.vehicles.length).fill(-1);
      for (let k = 0; k < frame.count; k++) frame.place[frame.vehicle[k]] = k;
    }
    return frame;
  }

  fleet(_kind, step) {
    return this.#held(step).fleet;
  }

  eventCount() {
    return this.events.length;
  }

  event(i) {
    return this.events[i];
  }

  /* The same measures as a run's tables have, from what the feed says of a step. */
  #measure(step, frame) {
    const zones = new Map([[0, { connected: 0, vehicles: 0, covered: 0 }]]);
    const zone = (name) => zones.get(name) ?? zones.set(name, { connected: 0, vehicles: 0, covered: 0 }).get(name);
    for (let k = 0; k < frame.count; k++) {
      const tallies = [zones.get(0)];
      const home = frame.uav[k] >= 0 ? frame.fleet.zone[frame.uav[k]] : this.zoneAt(frame.x[k], frame.y[k]);
      if (home > 0) tallies.push(zone(home));
      for (const tally of tallies) {
        tally.connected++;
        if (frame.uav[k] >= 0) tally.vehicles++;
        if (frame.covered[k]) tally.covered++;
      }
    }
    const teams = teamsOf(frame.fleet);
    for (const [name, team] of teams) zone(name).linked = linked(frame.fleet, team, this.range) ? 1 : 0;
    const all = zones.get(0);
    all.linked = teams.size ? [...teams.keys()].reduce((sum, name) => sum + zones.get(name).linked, 0) / teams.size : NaN;
    const flying = frame.fleet.battery.filter((_, u) => frame.fleet.state[u] & 1);
    all.energy_percent = flying.length ? flying.reduce((sum, value) => sum + value, 0) / flying.length : NaN;
    for (const [name, tally] of zones) {
      if (name && !teams.has(name)) continue;
      if (name && !this.zonesWithTeams.has(name)) {
        this.zonesWithTeams.add(name);
        this.metricZones = [0, ...[...this.zonesWithTeams].sort((a, b) => a - b)];
      }
      this.#put("in_range_share", name, step, tally.connected ? tally.covered / tally.connected : NaN);
      this.#put("coverage", name, step, tally.vehicles ? tally.covered / tally.vehicles : NaN);
      this.#put("connectivity", name, step, tally.linked ?? NaN);
      this.#put("energy_percent", name, step, tally.energy_percent ?? NaN);
    }
  }

  #put(name, zone, step, value) {
    const key = name + zone;
    let values = this.metrics.get(key);
    if (!values || values.length <= step) {
      const longer = new Float32Array(Math.max(1024, 2 * step)).fill(NaN);
      if (values) longer.set(values);
      this.metrics.set(key, (values = longer));
    }
    values[step] = value;
  }

  metric(name, zone) {
    const values = this.metrics.get(name + zone) ?? new Float32Array(0);
    if (values.length > this.steps) return values.subarray(0, this.steps + 1);
    const longer = new Float32Array(this.steps + 1).fill(NaN);
    longer.set(values);
    return longer;
  }
}

const EMPTY = {
  count: 0, vehicle: [], x: [], y: [], uav: [], covered: [], place: [],
  fleet: { x: [], y: [], zone: [], state: [], battery: [], age: [] },
};

/* Of each zone, its selected UAVs. */
export function teamsOf(fleet) {
  const teams = new Map();
  for (let u = 0; u < fleet.state.length; u++) {
    if (fleet.state[u] < 2) continue;
    const team = teams.get(fleet.zone[u]);
    if (team) team.push(u); else teams.set(fleet.zone[u], [u]);
  }
  return teams;
}

/* Whether links of at most `range` metres join a team. */
export function linked(fleet, team, range) {
  const waiting = [team[0]], left = new Set(team.slice(1));
  while (waiting.length) {
    const a = waiting.pop();
    for (const b of left) {
      if (Math.hypot(fleet.x[a] - fleet.x[b], fleet.y[a] - fleet.y[b]) > range) continue;
      left.delete(b);
      waiting.push(b);
    }
  }
  return left.size === 0;
}
