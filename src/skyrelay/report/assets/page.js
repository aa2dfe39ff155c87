"use strict";

/* The replay of one run. State is what the controls say; every change ends in draw(), which paints the whole page.
   Text of the run (ids, event arguments) enters the document by textContent only. */

const $ = (id) => document.getElementById(id);

/* ---- the run: see skyrelay/report/payload.py for the layout ---- */

async function load() {
  const text = atob($("payload").textContent);
  const packed = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) packed[i] = text.charCodeAt(i);
  const inflated = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = await new Response(inflated).arrayBuffer();
  const length = new DataView(bytes).getUint32(0, true);
  const run = JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, 4, length)));
  const types = { Uint8Array, Uint16Array, Int32Array, Float32Array };
  for (const [name, [type, offset, size]] of Object.entries(run.arrays)) {
    run[name] = new types[type](bytes, 4 + length + offset, size);
  }
  const [x0, y0, x1, y1] = run.box;
  for (const name of ["vehicle_x", "vehicle_y", "uav_x", "uav_y", "uav_static_x", "uav_static_y"]) {
    const [low, high] = name.endsWith("x") ? [x0, x1] : [y0, y1];
    const differences = run[name];
    const metres = new Float32Array(differences.length);
    for (let i = 0, sum = 0; i < metres.length; i++) {
      sum = (sum + differences[i]) & 0xffff;
      metres[i] = low + (sum / 65535) * (high - low);
    }
    run[name] = metres;
  }
  // Where a vehicle's row of a step is; -1 where it is away.
  run.columns = run.steps + 1;
  run.row = new Int32Array(run.vehicles.length * run.columns).fill(-1);
  for (let i = 0; i < run.vehicle.length; i++) run.row[run.vehicle[i] * run.columns + run.vehicle_step[i]] = i;
  return run;
}

/* A metric's values by step in a zone (0: the whole area); a zone that never had a team has none. */
function metric(name, zone) {
  const start = run.metricZones.indexOf(zone) * run.columns;
  return start < 0 ? new Float32Array(run.columns).fill(NaN) : run["metric_" + name].subarray(start, start + run.columns);
}

/* How many of the sorted values are at most `limit`. */
function countUpTo(limit, length, value) {
  let low = 0, high = length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (value(middle) <= limit) low = middle + 1; else high = middle;
  }
  return low;
}

const clockText = (step) => {
  const seconds = Math.round(step * run.stepSeconds);
  return Math.floor(seconds / 60) + ":" + String(seconds % 60).padStart(2, "0");
};
const number = (value, digits) => Number.isFinite(value) ? value.toFixed(digits) : "–";
const percent = (value) => Number.isFinite(value) ? (100 * value).toFixed(1) + " %" : "–";

/* ---- state ---- */

let run, theme;
const state = { time: 0, playing: false, rate: 5, mode: "learned", zone: 0, picked: null, hovered: null };
const layers = { discs: true, serving: true, links: true, labels: false };
const calm = matchMedia("(prefers-reduced-motion: reduce)");

const step = () => Math.min(run.steps, Math.floor(state.time + 1e-6));
const periodOf = (at) => Math.floor(Math.min(at, run.steps - 1) / run.periodSteps);

function seek(time) {
  state.time = Math.max(0, Math.min(run.steps, time));
  if (state.time >= run.steps && state.playing) play(false);
  draw();
}

function play(on) {
  if (on && state.time >= run.steps) state.time = 0;
  state.playing = on;
  $("play").setAttribute("aria-label", on ? "Pause" : "Play");
  $("play").querySelector("path").setAttribute("d", on ? "M4 3h4v14H4zM12 3h4v14h-4z" : "M5 3l12 7-12 7z");
  if (!on) return draw();
  let last = performance.now();
  requestAnimationFrame(function frame(now) {
    if (!state.playing) return;
    const passed = Math.min(250, Math.max(0, now - last)) / 1000;
    last = now;
    seek(state.time + passed * state.rate);
    requestAnimationFrame(frame);
  });
}

/* However many changes there are, the page is painted once a frame. */
let drawing = false;
function draw() {
  if (drawing) return;
  drawing = true;
  requestAnimationFrame(paint);
}

function paint() {
  drawing = false;
  const scene = observe();
  drawMap(scene);
  drawCursors();
  drawEvents();
  drawTexts(scene);
}

/* ---- what is where at this moment ---- */

function observe() {
  const at = step();
  const part = calm.matches ? 0 : state.time - at;
  const kind = state.mode === "static" ? "static_" : "";
  const between = (values, i, j) => values[i] + (values[j] - values[i]) * part;
  const uavs = [];
  const states = run[`uav_${kind}state`], zones = run[`uav_${kind}zone`];
  const uavX = run[`uav_${kind}x`], uavY = run[`uav_${kind}y`];
  for (let u = 0; u < run.uavs.length; u++) {
    const i = u * run.columns + at;
    if (!(states[i] & 1)) continue; // it has landed
    const j = part > 0 && states[i + 1] & 1 ? i + 1 : i;
    uavs[u] = {
      index: u, x: between(uavX, i, j), y: between(uavY, i, j), zone: zones[i], selected: states[i] >= 2,
      battery: run.uav_battery[i], colour: run.colours[u], serves: 0, covers: 0,
    };
  }
  const vehicles = [];
  const owners = run[`vehicle_${kind}uav`], covered = run[`vehicle_${kind}covered`];
  for (let v = 0; v < run.vehicles.length; v++) {
    const r = v * run.columns + at;
    const i = run.row[r];
    if (i < 0) continue;
    const j = part > 0 && run.row[r + 1] >= 0 ? run.row[r + 1] : i;
    const vehicle = {
      index: v, uav: owners[i], covered: covered[i] === 1,
      x: between(run.vehicle_x, i, j), y: between(run.vehicle_y, i, j),
    };
    const uav = uavs[vehicle.uav];
    if (uav) {
      uav.serves++;
      if (vehicle.covered) uav.covers++;
    }
    vehicles.push(vehicle);
  }
  const teams = new Map();
  for (const uav of uavs) {
    if (!uav?.selected) continue;
    if (!teams.has(uav.zone)) teams.set(uav.zone, []);
    teams.get(uav.zone).push(uav);
  }
  const links = [];
  for (const team of teams.values()) {
    for (let a = 0; a < team.length; a++) {
      for (let b = a + 1; b < team.length; b++) {
        if (Math.hypot(team[a].x - team[b].x, team[a].y - team[b].y) <= run.range) links.push([team[a], team[b]]);
      }
    }
  }
  return { uavs, vehicles, teams, links };
}

/* ---- the map ---- */

const map = { canvas: $("map"), streets: document.createElement("canvas"), streetsOf: "", view: null };

function fit() {
  const { grid } = run;
  const width = map.canvas.clientWidth, height = map.canvas.clientHeight;
  let x0 = grid.x0, y0 = grid.y0, w = grid.side * grid.columns, h = grid.side * grid.rows, margin = 0.02;
  if (state.zone) {
    x0 += ((state.zone - 1) % grid.columns) * grid.side;
    y0 += Math.floor((state.zone - 1) / grid.columns) * grid.side;
    w = h = grid.side;
    margin = 0.12;
  }
  const scale = Math.min(width / w, height / h) / (1 + 2 * margin);
  map.view = { scale, x: width / 2 - (x0 + w / 2) * scale, y: height / 2 + (y0 + h / 2) * scale, width, height };
}

const sx = (x) => map.view.x + x * map.view.scale;
const sy = (y) => map.view.y - y * map.view.scale;

/* Buildings, the higher the darker; over them the tracks of all vehicles: the streets appear where they drive. */
function streets(ratio) {
  const { view, streets: canvas } = map;
  const key = [view.scale, view.x, view.y, view.width, view.height, ratio, theme.street].join();
  if (map.streetsOf === key) return canvas;
  map.streetsOf = key;
  canvas.width = view.width * ratio;
  canvas.height = view.height * ratio;
  const pen = canvas.getContext("2d");
  pen.scale(ratio, ratio);
  pen.fillStyle = theme.street;
  const highest = Math.max(...run.buildings.map((building) => building.height));
  for (const { corners, height } of run.buildings) {
    pen.globalAlpha = 0.15 + 0.35 * height / highest;
    pen.beginPath();
    for (let i = 0; i < corners.length; i += 2) pen.lineTo(sx(corners[i]), sy(corners[i + 1]));
    pen.fill();
  }
  pen.strokeStyle = theme.street;
  pen.globalAlpha = Math.max(0.03, Math.min(0.12, 20 / run.vehicles.length));
  pen.lineWidth = Math.max(1.4, Math.min(9, 6 * view.scale));
  pen.lineJoin = pen.lineCap = "round";
  const jump = 60 * run.stepSeconds; // faster than 60 m/s is a gap in the trace, not a street
  for (let i = 0; i < run.vehicle.length; ) {
    const vehicle = run.vehicle[i];
    pen.beginPath();
    for (let first = true; i < run.vehicle.length && run.vehicle[i] === vehicle; i++, first = false) {
      const x = run.vehicle_x[i], y = run.vehicle_y[i];
      const gap = first || run.vehicle_step[i] !== run.vehicle_step[i - 1] + 1
        || Math.hypot(x - run.vehicle_x[i - 1], y - run.vehicle_y[i - 1]) > jump;
      if (gap) pen.moveTo(sx(x), sy(y)); else pen.lineTo(sx(x), sy(y));
    }
    pen.stroke();
  }
  return canvas;
}

function drawMap(scene) {
  fit();
  const { canvas, view } = map;
  const ratio = devicePixelRatio || 1;
  if (canvas.width !== Math.round(view.width * ratio) || canvas.height !== Math.round(view.height * ratio)) {
    canvas.width = Math.round(view.width * ratio);
    canvas.height = Math.round(view.height * ratio);
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.fillStyle = theme.map;
  pen.fillRect(0, 0, view.width, view.height);
  pen.drawImage(streets(ratio), 0, 0, view.width, view.height);
  if (layers.discs) drawDiscs(pen, scene);
  drawZones(pen);
  if (layers.serving) drawServing(pen, scene);
  if (layers.links) drawLinks(pen, scene);
  drawPickedLines(pen, scene);
  drawVehicles(pen, scene);
  drawUavs(pen, scene);
  drawPicked(pen, scene);
  drawScale(pen);
}

function drawZones(pen) {
  const { grid } = run;
  const side = grid.side * map.view.scale;
  const at = step();
  const prefix = state.mode === "static" ? "static_" : "";
  const left = sx(grid.x0), bottom = sy(grid.y0), right = left + side * grid.columns, top = bottom - side * grid.rows;
  const sharp = (pixel) => Math.round(pixel) + 0.5;
  pen.strokeStyle = theme.zone;
  pen.lineWidth = 1;
  pen.beginPath();
  for (let column = 0; column <= grid.columns; column++) {
    pen.moveTo(sharp(left + column * side), sharp(top));
    pen.lineTo(sharp(left + column * side), sharp(bottom));
  }
  for (let row = 0; row <= grid.rows; row++) {
    pen.moveTo(sharp(left), sharp(bottom - row * side));
    pen.lineTo(sharp(right), sharp(bottom - row * side));
  }
  pen.stroke();
  for (const [x, y] of run.charging ? run.charging.points : []) {
    const radius = run.charging.radius * map.view.scale;
    pen.setLineDash([3, 3]);
    pen.beginPath();
    pen.arc(sx(x), sy(y), radius, 0, 7);
    pen.stroke();
    pen.setLineDash([]);
    if (side >= 60) label(pen, "⚡", sx(x) - 5, sy(y) - 7, theme.muted);
  }
  if (side < 60) return;
  pen.textBaseline = "top";
  for (let zone = 1; zone <= grid.columns * grid.rows; zone++) {
    const x = left + ((zone - 1) % grid.columns) * side + 7;
    const y = bottom - (Math.floor((zone - 1) / grid.columns) + 1) * side + 7;
    const name = side < 100 ? String(zone) : "Zone " + zone;
    label(pen, name, x, y, theme.muted);
    const covered = Math.round(100 * metric(prefix + "coverage", zone)[at]);
    if (side < 150 || !Number.isFinite(covered)) continue; // small, or without a team
    const linked = metric(prefix + "connectivity", zone)[at] >= 1;
    const indent = pen.measureText(name + "  ").width;
    label(pen, `${covered} %, ${linked ? "linked" : "split"}`, x + indent, y, linked ? theme.muted : theme.warn, 400);
  }
}

function drawDiscs(pen, { teams }) {
  const radius = run.range * map.view.scale;
  for (const team of teams.values()) {
    pen.globalAlpha = 0.09;
    pen.fillStyle = theme.disc;
    pen.beginPath(); // one path: where discs overlap, the tint stays the same
    for (const uav of team) {
      pen.moveTo(sx(uav.x) + radius, sy(uav.y));
      pen.arc(sx(uav.x), sy(uav.y), radius, 0, 7);
    }
    pen.fill();
    pen.globalAlpha = 0.5;
    pen.lineWidth = 1.1;
    for (const uav of team) {
      pen.strokeStyle = theme.colours[uav.colour];
      pen.beginPath();
      pen.arc(sx(uav.x), sy(uav.y), radius, 0, 7);
      pen.stroke();
    }
  }
  pen.globalAlpha = 1;
}

function drawServing(pen, { uavs, vehicles }) {
  for (const covered of [true, false]) {
    pen.setLineDash(covered ? [] : [4, 4]);
    pen.lineWidth = covered ? 1 : 1.3;
    for (let colour = 0; colour < theme.colours.length; colour++) {
      pen.beginPath();
      for (const vehicle of vehicles) {
        const uav = uavs[vehicle.uav];
        if (!uav || uav.colour !== colour || vehicle.covered !== covered) continue;
        pen.moveTo(sx(uav.x), sy(uav.y));
        pen.lineTo(sx(vehicle.x), sy(vehicle.y));
      }
      pen.strokeStyle = covered ? theme.colours[colour] : theme.warn;
      pen.globalAlpha = covered ? 0.5 : 0.7;
      pen.stroke();
    }
  }
  pen.setLineDash([]);
  pen.globalAlpha = 1;
}

function drawLinks(pen, { links }) {
  pen.lineCap = "round";
  for (const [width, colour, alpha] of [[5, theme.map, 0.8], [2.4, theme.ink, 0.75]]) {
    pen.lineWidth = width;
    pen.strokeStyle = colour;
    pen.globalAlpha = alpha;
    pen.beginPath();
    for (const [a, b] of links) {
      pen.moveTo(sx(a.x), sy(a.y));
      pen.lineTo(sx(b.x), sy(b.y));
    }
    pen.stroke();
  }
  pen.globalAlpha = 1;
}

const vehicleRadius = () => Math.max(2.6, Math.min(5, 60 / Math.sqrt(run.vehicles.length))) * (state.zone ? 1.5 : 1);

function drawVehicles(pen, { vehicles }) {
  const radius = vehicleRadius();
  const dots = (keep, r) => {
    pen.beginPath();
    for (const vehicle of vehicles) {
      if (!keep(vehicle)) continue;
      pen.moveTo(sx(vehicle.x) + r, sy(vehicle.y));
      pen.arc(sx(vehicle.x), sy(vehicle.y), r, 0, 7);
    }
  };
  pen.fillStyle = theme.grey;
  dots((v) => v.uav < 0, radius * 0.75);
  pen.fill();
  pen.lineWidth = 1.8;
  pen.strokeStyle = theme.map;
  for (let colour = 0; colour < theme.colours.length; colour++) {
    dots((v) => run.colours[v.uav] === colour, radius);
    pen.stroke();
    pen.fillStyle = theme.colours[colour];
    pen.fill();
  }
  pen.strokeStyle = theme.warn;
  dots((v) => v.uav >= 0 && !v.covered, radius + 3);
  pen.stroke();
}

function drawUavs(pen, { uavs }) {
  const size = state.zone ? 8 : Math.max(4, Math.min(6, 38 / Math.sqrt(run.uavs.length)));
  pen.textBaseline = "middle";
  for (const uav of [...uavs].filter(Boolean).sort((a, b) => a.selected - b.selected)) {
    const x = sx(uav.x), y = sy(uav.y);
    const r = uav.selected ? size : size * 0.7;
    pen.strokeStyle = uav.selected ? theme.ink : theme.grey;
    pen.lineWidth = 1.1;
    pen.fillStyle = theme.map;
    pen.beginPath();
    for (const [dx, dy] of [[-1, -1], [1, -1], [1, 1], [-1, 1]]) {
      pen.moveTo(x, y);
      pen.lineTo(x + dx * r, y + dy * r);
    }
    pen.stroke();
    if (uav.selected) {
      for (const [dx, dy] of [[-1, -1], [1, -1], [1, 1], [-1, 1]]) {
        pen.beginPath();
        pen.arc(x + dx * r, y + dy * r, r * 0.45, 0, 7);
        pen.fill();
        pen.stroke();
      }
    }
    pen.beginPath();
    pen.arc(x, y, r * 0.72, 0, 7);
    if (uav.selected) pen.fillStyle = theme.colours[uav.colour];
    pen.fill();
    pen.stroke();
    if (layers.labels) label(pen, run.uavs[uav.index], x + r * 1.7, y, uav.selected ? theme.ink : theme.muted);
  }
}

function label(pen, text, x, y, colour, weight = 600) {
  pen.font = weight + " 11px " + theme.font;
  pen.lineWidth = 3;
  pen.lineJoin = "round";
  pen.strokeStyle = theme.map;
  pen.strokeText(text, x, y);
  pen.fillStyle = colour;
  pen.fillText(text, x, y);
}

const member = (scene, picked) => picked?.kind === "uav"
  ? scene.uavs[picked.index]
  : scene.vehicles.find((vehicle) => vehicle.index === picked?.index);

/* Whom the picked UAV serves, or who serves the picked vehicle. */
function drawPickedLines(pen, scene) {
  pen.strokeStyle = theme.ink;
  pen.lineWidth = 2;
  pen.beginPath();
  for (const picked of [state.picked, state.hovered]) {
    for (const vehicle of scene.vehicles) {
      const uav = scene.uavs[vehicle.uav];
      if (!picked || !uav || picked.index !== (picked.kind === "uav" ? vehicle.uav : vehicle.index)) continue;
      pen.moveTo(sx(uav.x), sy(uav.y));
      pen.lineTo(sx(vehicle.x), sy(vehicle.y));
    }
  }
  pen.stroke();
}

function drawPicked(pen, scene) {
  pen.strokeStyle = theme.ink;
  pen.lineWidth = 2;
  for (const picked of [state.picked, state.hovered]) {
    const found = picked && member(scene, picked);
    if (!found) continue;
    pen.beginPath();
    pen.arc(sx(found.x), sy(found.y), picked.kind === "uav" ? 15 : 9, 0, 7);
    pen.stroke();
  }
}

function drawScale(pen) {
  const { view } = map;
  const metres = [10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000, 20000, 50000].find((m) => m * view.scale > 60) ?? 100000;
  const x = view.width - 16 - metres * view.scale, y = view.height - 16;
  pen.strokeStyle = theme.muted;
  pen.lineWidth = 1.5;
  pen.lineCap = "butt";
  pen.beginPath();
  pen.moveTo(x, y - 4);
  pen.lineTo(x, y);
  pen.lineTo(view.width - 16, y);
  pen.lineTo(view.width - 16, y - 4);
  pen.stroke();
  pen.textBaseline = "alphabetic";
  pen.textAlign = "right";
  label(pen, metres >= 1000 ? metres / 1000 + " km" : metres + " m", view.width - 16, y - 7, theme.muted);
  pen.textAlign = "left";
}

/* The nearest member within 14 pixels of a point of the map. */
function hit(scene, x, y) {
  let best = null, least = 14;
  const consider = (kind, thing, bonus) => {
    const distance = Math.hypot(sx(thing.x) - x, sy(thing.y) - y) - bonus;
    if (distance < least) [best, least] = [{ kind, index: thing.index }, distance];
  };
  for (const vehicle of scene.vehicles) consider("vehicle", vehicle, 0);
  for (const uav of scene.uavs) if (uav) consider("uav", uav, 3);
  return best;
}

/* ---- time series ---- */

const CHARTS = [
  { title: "Coverage", unit: "%", scale: 100, top: 1, lines: [["coverage", "learned", "learned"], ["static_coverage", "static", "hovering"]] },
  { title: "Connectivity", unit: "%", scale: 100, top: 1, lines: [["connectivity", "learned", "learned"], ["connectivity_neighbor", "neighbor", "neighbour"], ["static_connectivity", "static", "hovering"]] },
  { title: "Served bandwidth", unit: "Mbit/s", scale: 1, lines: [["served_mbps", "learned", "learned"], ["static_served_mbps", "static", "hovering"]] },
  { title: "Mean battery in the air", unit: "%", scale: 1, lines: [["energy_percent", "learned", ""]] },
];
const LEFT = 34, RIGHT = 6;

function svg(name, attributes, parent) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  parent?.append(element);
  return element;
}

function html(name, properties, parent) {
  const element = Object.assign(document.createElement(name), properties);
  parent?.append(element);
  return element;
}

function makeCharts() {
  for (const chart of CHARTS) {
    const box = html("div", { className: "chart" }, $("charts"));
    const head = html("header", {}, box);
    chart.heading = html("h2", {}, head);
    chart.values = html("div", { className: "values" }, head);
    chart.plot = html("div", { className: "plot" }, box);
    chart.svg = svg("svg", { role: "img", "aria-label": chart.title + " over time" }, chart.plot);
    const scrub = (event) => {
      const bounds = chart.svg.getBoundingClientRect();
      seek(Math.round(((event.clientX - bounds.left - LEFT) / (bounds.width - LEFT - RIGHT)) * run.steps));
    };
    chart.svg.addEventListener("pointerdown", (event) => { chart.svg.setPointerCapture(event.pointerId); scrub(event); });
    chart.svg.addEventListener("pointermove", (event) => { if (event.buttons) scrub(event); });
  }
}

const ROUND = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 21600, 86400];

function drawCharts() {
  const width = CHARTS[0].plot.clientWidth;
  const plotWidth = Math.max(40, width - LEFT - RIGHT);
  const px = (at) => LEFT + (at / Math.max(1, run.steps)) * plotWidth;
  CHARTS.forEach((chart, index) => {
    const last = index === CHARTS.length - 1;
    chart.heading.textContent = chart.title + (state.zone ? ", zone " + state.zone : "");
    const plotHeight = Math.max(20, chart.plot.clientHeight - 14);
    const series = chart.lines.map(([name]) => metric(name, state.zone));
    let low = Infinity, high = -Infinity;
    for (const values of series) for (const value of values) {
      if (value < low) low = value;
      if (value > high) high = value;
    }
    if (low > high) [low, high] = [0, 1];
    if (chart.top) {
      high = chart.top;
      low = Math.max(0, Math.floor(low * 5 - 1e-6) / 5);
    } else {
      const unit = 10 ** Math.floor(Math.log10(Math.max(high - low, high * 0.1, 1e-6)));
      low = Math.max(0, Math.floor(low / unit) * unit);
      high = Math.max(Math.ceil(high / unit) * unit, low + unit);
    }
    const py = (value) => 6 + plotHeight * (1 - (value - low) / (high - low));
    chart.py = py;
    chart.px = px;
    chart.svg.replaceChildren();
    chart.svg.setAttribute("viewBox", `0 0 ${width} ${chart.plot.clientHeight}`);
    for (let at = run.periodSteps; at < run.steps; at += run.periodSteps) {
      if (run.steps / run.periodSteps <= 60) svg("line", { class: "period", x1: px(at), x2: px(at), y1: 6, y2: 6 + plotHeight }, chart.svg);
    }
    for (const value of [low, (low + high) / 2, high]) {
      svg("line", { class: "axis", x1: LEFT, x2: LEFT + plotWidth, y1: py(value), y2: py(value) }, chart.svg);
      svg("text", { x: LEFT - 6, y: py(value) + 3.5, "text-anchor": "end" }, chart.svg).textContent =
        +(value * chart.scale).toFixed(1);
    }
    if (last) {
      const total = run.steps * run.stepSeconds;
      const gap = ROUND.find((seconds) => total / seconds <= plotWidth / 62) ?? total;
      for (let at = 0; at <= total; at += gap) {
        svg("text", { x: px(at / run.stepSeconds), y: plotHeight + 21, "text-anchor": "middle" }, chart.svg).textContent =
          clockText(at / run.stepSeconds);
      }
    }
    chart.lines.forEach(([, kind], line) => {
      let path = "", pen = "M";
      series[line].forEach((value, at) => {
        if (Number.isFinite(value)) {
          path += pen + px(at).toFixed(1) + " " + py(value).toFixed(1);
          pen = "L";
        } else pen = "M";
      });
      svg("path", { class: "series " + kind, d: path }, chart.svg);
    });
    chart.cursor = svg("line", { class: "cursor", y1: 3, y2: 9 + plotHeight }, chart.svg);
    chart.values.replaceChildren();
    chart.marks = chart.lines.map(([, kind, text], line) => {
      const value = html("span", {}, chart.values);
      if (text) value.append(text + " ");
      return {
        values: series[line], text: html("b", { className: kind }, value),
        dot: svg("circle", { class: "dot " + kind, r: 3.2 }, chart.svg),
      };
    });
  });
}

function drawCursors() {
  const at = step();
  for (const chart of CHARTS) {
    const x = chart.px(calm.matches ? at : state.time);
    chart.cursor.setAttribute("x1", x);
    chart.cursor.setAttribute("x2", x);
    for (const { values, text, dot } of chart.marks) {
      const value = values[at];
      text.textContent = number(value * chart.scale, 1) + " " + chart.unit;
      dot.setAttribute("cx", chart.px(at));
      dot.setAttribute("cy", Number.isFinite(value) ? chart.py(value) : -99);
    }
  }
}

/* ---- events ---- */

const SHOWN = 80;
const events = { matching: null, listed: "" };

function matchEvents() {
  const name = $("event-name").value === "" ? -1 : +$("event-name").value;
  const wanted = $("event-member").value.trim().toLowerCase();
  const matching = [];
  for (let i = 0; i < run.event_step.length; i++) {
    if (name >= 0 && run.event_name[i] !== name) continue;
    if (wanted && !run.eventArgs[i].some((part, k) => k % 2 && part.toLowerCase().includes(wanted))) continue;
    matching.push(i);
  }
  events.matching = matching;
  events.listed = "";
}

function filterEvents() {
  matchEvents();
  draw();
}

function drawEvents() {
  const { matching } = events;
  const at = step();
  const count = countUpTo(at, matching.length, (k) => run.event_step[matching[k]]);
  const key = count + ":" + matching.length;
  if (key === events.listed) return;
  events.listed = key;
  $("event-count").textContent = count.toLocaleString("en") + (count > SHOWN ? `, newest ${SHOWN}` : "");
  const rows = [];
  for (let k = count - 1; k >= Math.max(0, count - SHOWN); k--) {
    const i = matching[k];
    const row = html("li", {});
    html("time", { textContent: clockText(run.event_step[i]), title: "block " + run.event_block[i] }, row);
    html("b", { textContent: run.eventNames[run.event_name[i]] }, row);
    const parts = run.eventArgs[i];
    const line = html("p", {}, row);
    for (let p = 0; p < parts.length; p += 2) {
      const pair = html("span", {}, line);
      html("i", { textContent: parts[p] + " " }, pair);
      const value = parts[p + 1];
      const long = value.length > 40 && !value.includes(" ");
      pair.append(long ? value.slice(0, 12) + "…" + value.slice(-8) : value);
      if (long) pair.title = value;
    }
    rows.push(row);
  }
  if (!rows.length) rows.push(html("li", { className: "none", textContent: "No such event up to here." }));
  $("events").replaceChildren(...rows);
}

/* ---- texts ---- */

function drawTexts(scene) {
  const at = step();
  $("scrub").value = at;
  $("scrub").setAttribute("aria-valuetext", `${clockText(at)}, step ${at} of ${run.steps}`);
  $("clock").replaceChildren(clockText(at), html("small", { textContent: " / " + clockText(run.steps) }));
  const period = periodOf(at);
  const periods = Math.ceil(run.steps / run.periodSteps);
  const { asked = 0, accepted = 0 } = run.proposals[period] ?? {};
  const served = scene.vehicles.filter((vehicle) => vehicle.uav >= 0);
  const selected = scene.uavs.filter((uav) => uav?.selected).length;
  const selection = `Selection ${period + 1} of ${periods}`;
  $("status").textContent =
    (state.mode === "static" ? `${selection}, same rules: ${selected} UAVs hover. `
      : `${selection}: ${accepted} of ${asked} proposals accepted, ${selected} UAVs at work. `) +
    `${scene.vehicles.length} vehicles here, ${served.length} served, ` +
    `${served.filter((vehicle) => vehicle.covered).length} in range.`;
  if (!state.playing) map.canvas.setAttribute("aria-label", "Map of the run. " + $("status").textContent);
  drawCard(scene, at, period);
}

function drawCard(scene, at, period) {
  const shown = state.hovered ?? state.picked;
  $("card").hidden = !shown;
  if (!shown) return;
  const found = member(scene, shown);
  const lines = [];
  const flown = state.mode === "learned"; // batteries and proposals are those of the flying fleet
  if (shown.kind === "uav") {
    if (!found) lines.push("has landed");
    else lines.push(`zone ${found.zone}, ` + (found.selected ? `serves ${found.serves}, ${found.covers} of them in range` : "idle"));
    if (found && flown) lines.push(`battery ${number(found.battery, 1)} %`);
  } else {
    if (!found) lines.push("not on the map now");
    else if (found.uav < 0) lines.push("not served");
    else {
      const uav = scene.uavs[found.uav];
      const distance = uav ? `, ${Math.round(Math.hypot(uav.x - found.x, uav.y - found.y))} m away` : ", which has landed";
      lines.push(`served by ${run.uavs[found.uav]}${distance}${found.covered || !uav ? "" : ": out of range"}`);
    }
    const i = run.proposals[period]?.of.get(shown.index);
    if (flown && i !== undefined) {
      lines.push(`proposed to ${run.uavs[run.proposal_uav[i]]}: QoU ${number(run.proposal_qou[i], 1)}, ` +
        `${number(run.proposal_demand[i] / 1000, 2)} Mbit/s, ${run.proposal_accepted[i] ? "accepted" : "rejected"}`);
    }
  }
  $("card").replaceChildren(
    html("b", { textContent: (shown.kind === "uav" ? run.uavs : run.vehicles)[shown.index] }),
    ...lines.map((line) => html("p", { textContent: line })),
  );
}

/* ---- controls ---- */

function readTheme() {
  const style = getComputedStyle(document.documentElement);
  const read = (name) => style.getPropertyValue("--" + name).trim();
  theme = { font: getComputedStyle(document.body).fontFamily, colours: Array.from({ length: 8 }, (_, i) => read("c" + i)) };
  for (const name of ["map", "ink", "muted", "street", "zone", "grey", "disc", "warn"]) theme[name] = read(name);
}

function setTheme(name) {
  document.documentElement.dataset.theme = name;
  readTheme();
  draw();
}

function setMode(mode) {
  state.mode = mode;
  document.querySelector(`input[name="mode"][value="${mode}"]`).checked = true;
  draw();
}

function setZone(zone) {
  state.zone = zone;
  $("zone").value = zone;
  drawCharts();
  paint();
}

function pick(picked) {
  state.picked = picked;
  const id = picked && (picked.kind === "uav" ? run.uavs : run.vehicles)[picked.index];
  // Events follow the member where they name it (some contracts name only its address).
  const named = id !== null && run.eventArgs.some((parts) => parts.some((part, k) => k % 2 && part === id));
  $("event-member").value = named ? id : "";
  filterEvents();
}

function makeControls() {
  const total = run.steps * run.stepSeconds;
  for (const rate of [1, 2, 5, 10, 20]) {
    html("option", { value: rate, textContent: "×" + +(rate * run.stepSeconds).toFixed(2), selected: rate === state.rate }, $("speed"));
  }
  $("speed").title = `Times real time; the run lasts ${clockText(run.steps)} (${total} s)`;
  for (const zone of run.metricZones) html("option", { value: zone, textContent: zone || "all" }, $("zone"));
  const counts = new Array(run.eventNames.length).fill(0);
  for (const name of run.event_name) counts[name]++;
  html("option", { value: "", textContent: "all kinds" }, $("event-name"));
  run.eventNames.forEach((name, i) => html("option", { value: i, textContent: `${name} (${counts[i]})` }, $("event-name")));

  $("play").addEventListener("click", () => play(!state.playing));
  $("scrub").addEventListener("input", () => seek(+$("scrub").value));
  $("speed").addEventListener("change", () => { state.rate = +$("speed").value; });
  $("zone").addEventListener("change", () => setZone(+$("zone").value));
  $("theme").addEventListener("click", () => setTheme(document.documentElement.dataset.theme === "dark" ? "light" : "dark"));
  $("event-name").addEventListener("change", filterEvents);
  $("event-member").addEventListener("input", filterEvents);
  for (const input of document.querySelectorAll('input[name="mode"]')) input.addEventListener("change", () => setMode(input.value));
  for (const name of Object.keys(layers)) {
    $("show-" + name).addEventListener("change", (event) => { layers[name] = event.target.checked; draw(); });
  }

  const point = (event) => {
    const bounds = map.canvas.getBoundingClientRect();
    return [event.clientX - bounds.left, event.clientY - bounds.top];
  };
  map.canvas.addEventListener("pointermove", (event) => {
    if (event.pointerType === "touch") return;
    state.hovered = hit(observe(), ...point(event));
    draw();
  });
  map.canvas.addEventListener("pointerleave", () => { state.hovered = null; draw(); });
  map.canvas.addEventListener("click", (event) => {
    const [x, y] = point(event);
    const found = hit(observe(), x, y);
    if (found) return pick(found);
    if (state.picked) return pick(null);
    const column = Math.floor(((x - map.view.x) / map.view.scale - run.grid.x0) / run.grid.side);
    const row = Math.floor(((map.view.y - y) / map.view.scale - run.grid.y0) / run.grid.side);
    const inside = column >= 0 && row >= 0 && column < run.grid.columns && row < run.grid.rows;
    const zone = row * run.grid.columns + column + 1;
    setZone(inside && !state.zone && run.metricZones.includes(zone) ? zone : 0);
  });

  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const target = event.target;
    const writing = target.matches("input[type=search], select");
    if (event.key === "Escape") { pick(null); setZone(0); return; }
    if (writing) return;
    const stride = event.shiftKey ? run.periodSteps : 1;
    const keys = {
      " ": () => play(!state.playing),
      ArrowLeft: () => seek(Math.ceil(state.time - 1e-6) - stride),
      ArrowRight: () => seek(step() + stride),
      Home: () => seek(0),
      End: () => seek(run.steps),
      m: () => setMode(state.mode === "learned" ? "static" : "learned"),
    };
    const radio = target.matches("input[type=radio]") && event.key.startsWith("Arrow");
    const own = event.key === " " && target.matches("button:not(#play), input[type=checkbox]");
    if (!keys[event.key] || radio || own) return;
    event.preventDefault();
    keys[event.key]();
  });
  // A focused button would answer the space key twice.
  $("play").addEventListener("keyup", (event) => { if (event.key === " ") event.preventDefault(); });
}

function drawPeriods() {
  const width = $("scrub").clientWidth;
  const box = $("periods");
  box.setAttribute("viewBox", `0 0 ${width} 12`);
  box.replaceChildren();
  const thumb = 16;
  const count = Math.ceil(run.steps / run.periodSteps);
  const every = Math.max(1, Math.ceil((count * 14) / width));
  for (let period = 0; period < count; period += every) {
    const x = thumb / 2 + ((period * run.periodSteps) / run.steps) * (width - thumb);
    svg("line", { x1: x, x2: x, y1: 0, y2: 5 }, box);
    if (width / count * every > 80) svg("text", { x: x + 4, y: 9 }, box).textContent = "selection " + (period + 1);
  }
}

/* By period: how many proposals, how many accepted, and each vehicle's last one. */
function indexProposals() {
  const periods = {};
  for (let i = 0; i < run.proposal_period.length; i++) {
    const period = (periods[run.proposal_period[i]] ??= { asked: 0, accepted: 0, of: new Map() });
    period.asked++;
    period.accepted += run.proposal_accepted[i];
    period.of.set(run.proposal_vehicle[i], i);
  }
  return periods;
}

async function start() {
  run = await load();
  run.proposals = indexProposals();
  document.documentElement.dataset.theme = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
  makeCharts();
  makeControls();
  // report.html#step=40&zone=5&mode=static&theme=dark opens there.
  const wanted = new URLSearchParams(location.hash.slice(1));
  if (["dark", "light"].includes(wanted.get("theme"))) document.documentElement.dataset.theme = wanted.get("theme");
  readTheme();
  if (wanted.get("mode") === "static") state.mode = "static";
  document.querySelector(`input[value="${state.mode}"]`).checked = true;
  const zone = parseInt(wanted.get("zone"), 10);
  if (run.metricZones.includes(zone)) state.zone = zone;
  $("zone").value = state.zone;
  matchEvents();
  state.time = Math.max(0, Math.min(run.steps, parseInt(wanted.get("step"), 10) || 0));
  const resized = () => { drawCharts(); drawPeriods(); paint(); }; // at once: a frame later, the map would be seen stretched
  const observer = new ResizeObserver(resized);
  for (const element of [map.canvas, $("charts"), $("scrub")]) observer.observe(element);
  resized();
  requestAnimationFrame(() => requestAnimationFrame(() => { document.body.dataset.ready = "true"; }));
}

start().catch((error) => {
  html("p", { className: "fatal", role: "alert", textContent: "This page could not be shown: " + error.message }, document.body);
  throw error;
});
