/* The picked member: what it does now, its history as two small series, what a UAV has around it, and its selections. */

import { CELLS, NAMES, sixMaps } from "./maps.js";
import { $, clock, html, number, svg } from "./words.js";

const PIXELS = 8; // of a map's cell
const LEFT = 34, WIDTH = 300, HEIGHT = 64;

export class Member {
  constructor(run, { seek, close }) {
    this.run = run;
    this.seek = seek;
    this.key = "";
    $("member-close").onclick = close;
    this.pens = NAMES.map(() => html("canvas", { width: CELLS * PIXELS, height: CELLS * PIXELS }).getContext("2d", { willReadFrequently: true }));
    $("member-maps").replaceChildren(...this.pens.map(({ canvas }, m) => {
      const figure = html("figure", {});
      figure.append(canvas);
      html("figcaption", { textContent: NAMES[m] }, figure);
      return figure;
    }));
    for (const element of [$("member-history")]) {
      element.onpointerdown = (event) => {
        const chart = event.target.closest("svg");
        if (!chart || !this.history) return;
        const bounds = chart.getBoundingClientRect();
        const share = ((event.clientX - bounds.left) / bounds.width * WIDTH - LEFT) / (WIDTH - LEFT - 4);
        seek(Math.round(this.history.first + share * (this.history.last - this.history.first)));
      };
    }
  }

  draw(scene, picked, mode, theme) {
    $("member").hidden = !picked;
    if (!picked) {
      this.key = "";
      return;
    }
    const { run } = this;
    $("member-name").textContent = nameOf(run, picked);
    $("member-facts").replaceChildren(...facts(run, scene, picked, mode).map((line) => html("p", { textContent: line })));
    const key = [picked.kind, picked.index, mode].join();
    if (key !== this.key || (run.live && this.history.last !== run.steps)) {
      if (key !== this.key) this.history = null;
      this.key = key;
      this.#read(picked, mode);
      this.#drawHistory(picked);
    }
    for (const { cursor } of this.charts) cursor.style.transform = `translate(${(100 * this.px(scene.time)) / WIDTH}%)`;
    $("member-maps").hidden = picked.kind !== "uav";
    if (picked.kind === "uav") this.#drawMaps(scene, picked.index, theme);
  }

  /* By step: a UAV's battery, vehicles served and in range; a vehicle's way to its UAV. Goes on where it stopped. */
  #read({ kind, index }, mode) {
    const { run } = this;
    const first = Math.max(0, run.first);
    const history = this.history ?? { first, last: first - 1, values: [[], []], uavs: [] };
    for (let step = history.last + 1; step <= run.steps; step++) {
      const frame = run.frame(mode, step), fleet = run.fleet(mode, step);
      const at = step - history.first;
      if (kind === "uav") {
        const flying = fleet.state[index] & 1;
        let covers = 0;
        for (let k = 0; k < frame.count; k++) covers += frame.uav[k] === index && frame.covered[k];
        history.values[0][at] = flying ? fleet.battery[index] : NaN;
        history.values[1][at] = flying ? covers : NaN;
      } else {
        const k = frame.place[index] ?? -1, uav = k < 0 ? -1 : frame.uav[k];
        const there = uav >= 0 && fleet.state[uav] & 1;
        history.values[0][at] = there ? Math.hypot(fleet.x[uav] - frame.x[k], fleet.y[uav] - frame.y[k]) : NaN;
        history.values[1][at] = k < 0 ? NaN : Number(uav >= 0 && frame.covered[k]);
        history.uavs[at] = uav;
      }
    }
    history.last = run.steps;
    this.history = history;
  }

  #drawHistory({ kind, index }) {
    const { run, history } = this;
    const span = Math.max(1, history.last - history.first);
    this.px = (at) => LEFT + ((at - history.first) / span) * (WIDTH - LEFT - 4);
    const rows = kind === "uav"
      ? [["Battery", "%", null], ["Vehicles in range", "", null]]
      : [["Way to its UAV", "m", run.range], ["In range (1) or not (0)", "", null]];
    const box = $("member-history");
    box.replaceChildren();
    this.charts = rows.map(([title, unit, limit], row) => {
      html("h3", { textContent: title + (unit ? ` [${unit}]` : "") }, box);
      const plot = html("div", { className: "history" }, box);
      const chart = svg("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": title + " over time" }, plot);
      const values = history.values[row];
      let high = limit ?? 0;
      for (const value of values) if (value > high) high = value;
      high = high || 1;
      const py = (value) => 6 + (HEIGHT - 14) * (1 - value / high);
      for (const value of [0, high]) {
        svg("line", { class: "axis", x1: LEFT, x2: WIDTH - 4, y1: py(value), y2: py(value) }, chart);
        svg("text", { x: LEFT - 5, y: py(value) + 3.5, "text-anchor": "end" }, chart).textContent = Math.round(value);
      }
      if (limit) svg("line", { class: "limit", x1: LEFT, x2: WIDTH - 4, y1: py(limit), y2: py(limit) }, chart);
      let path = "", pen = "M";
      values.forEach((value, at) => {
        if (!Number.isFinite(value)) { pen = "M"; return; }
        path += pen + this.px(history.first + at).toFixed(1) + " " + py(value).toFixed(1);
        pen = "L";
      });
      svg("path", { class: "series learned", d: path }, chart);
      return { cursor: html("div", { className: "cursor" }, plot) };
    });
    $("member-selections").replaceChildren(...this.#selections(kind, index));
  }

  /* Whom it chose, or who chose it, period by period. */
  #selections(kind, index) {
    const { run, history } = this;
    const rows = [];
    const add = (step, text) => {
      const button = html("button", { type: "button" });
      html("time", { textContent: clock(run, step) }, button);
      button.append(text);
      button.addEventListener("click", () => this.seek(step));
      const row = html("li", {});
      row.append(button);
      rows.push(row);
    };
    for (let at = 0; kind === "vehicle" && at < history.uavs.length; at++) {
      const step = history.first + at, uav = history.uavs[at];
      if (at && uav === history.uavs[at - 1]) continue;
      const i = run.proposals[run.periodOf(step)]?.of?.get(index);
      const quality = i === undefined ? "" :
        `, QoU ${number(run.proposal_qou[i], 1)}, ${number(run.proposal_demand[i] / 1000, 2)} Mbit/s`;
      const here = Number.isFinite(history.values[1][at]);
      if (!here && !at) continue;
      add(step, uav >= 0 ? `served by ${run.uavs[uav]}${quality}` : here ? "not served" : "away");
    }
    if (kind === "uav") {
      let before = -1;
      for (let step = history.first; step <= history.last; step++) {
        const state = run.fleet("", step).state[index] ?? 0;
        if (state !== before) add(step, state >= 2 ? "selected" : state ? "idle" : run.places ? "away to be charged" : "landed");
        before = state;
      }
    }
    return rows.slice(-12).reverse();
  }

  /* The six maps, north up, each shaded by its own greatest level; a frame where the UAV itself is. */
  #drawMaps(scene, index, theme) {
    $("member-maps").hidden = !scene.uavs.zone[index];
    if ($("member-maps").hidden) return;
    const maps = sixMaps(this.run, scene, index);
    const own = [maps[0], maps[2]].map((map) => map.indexOf(Math.max(...map)));
    maps.forEach((map, m) => {
      const pen = this.pens[m];
      const most = Math.max(1, ...map);
      const at = (i) => [(i % CELLS) * PIXELS, (CELLS - 1 - Math.floor(i / CELLS)) * PIXELS];
      pen.clearRect(0, 0, CELLS * PIXELS, CELLS * PIXELS);
      pen.fillStyle = `rgb(${theme.learned.join(" ")})`;
      map.forEach((level, i) => {
        pen.globalAlpha = level / most;
        pen.fillRect(...at(i), PIXELS - 1, PIXELS - 1);
      });
      pen.globalAlpha = 1;
      pen.strokeStyle = `rgb(${theme.ink.join(" ")})`;
      pen.lineWidth = 2;
      pen.strokeRect(...at(own[m < 2 ? 0 : 1]), PIXELS - 1, PIXELS - 1);
    });
  }
}

export const nameOf = (run, { kind, index }) => (kind === "uav" ? run.uavs : run.vehicles)[index];

/* What a member does at this moment, in lines. */
export function facts(run, scene, { kind, index }, mode) {
  const { uavs, vehicles } = scene;
  const flown = mode === ""; // batteries and proposals are those of the flying fleet
  if (kind === "uav") {
    if (!(uavs.state[index] & 1))
      return flown && run.places ? ["is away to be charged", `battery ${number(uavs.battery[index], 1)} %`] : ["has landed"];
    const lines = [`zone ${uavs.zone[index]}, ` + (uavs.state[index] >= 2 ? `serves ${uavs.serves[index]}, ${uavs.covers[index]} of them in range` : "idle")];
    if (flown) lines.push(`battery ${number(uavs.battery[index], 1)} %`);
    if (uavs.age && Number.isFinite(uavs.age[index])) lines.push(`heard of ${number(uavs.age[index], 1)} s ago`);
    return lines;
  }
  const k = scene.place[index] ?? -1;
  if (k < 0) return ["not on the map now"];
  const lines = [];
  const uav = vehicles.uav[k];
  if (uav < 0) lines.push("not served");
  else if (!(uavs.state[uav] & 1)) lines.push(`served by ${run.uavs[uav]}, which ${flown && run.places ? "is away to be charged" : "has landed"}`);
  else {
    const distance = Math.round(Math.hypot(uavs.x[uav] - vehicles.x[k], uavs.y[uav] - vehicles.y[k]));
    lines.push(`served by ${run.uavs[uav]}, ${distance} m away${vehicles.covered[k] ? "" : ": out of range"}`);
  }
  if (scene.traffic && uav >= 0) {
    const [demand, carried, delivered] = scene.traffic(k).map((kbps) => number(kbps / 1000, 2));
    lines.push(`asks for ${demand} Mbit/s: ${carried} carried, ${delivered} delivered`);
  }
  const i = run.proposals[run.periodOf(Math.min(scene.at, run.steps - 1))]?.of.get(index);
  if (flown && i !== undefined) {
    lines.push(`proposed to ${run.uavs[run.proposal_uav[i]]}: QoU ${number(run.proposal_qou[i], 1)}, ` +
      `${number(run.proposal_demand[i] / 1000, 2)} Mbit/s, ${run.proposal_accepted[i] ? "accepted" : "rejected"}`);
  }
  return lines;
}
