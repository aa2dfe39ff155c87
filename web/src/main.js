/* The page of a run: from a file that holds it whole, or from a feed as it happens. State is what the controls say; every
   change ends in draw(), which paints the page once a frame. */

import { Charts } from "./charts.js";
import { Lists } from "./lists.js";
import { listen } from "./live.js";
import { FleetMap } from "./map.js";
import { Member, facts, nameOf } from "./member.js";
import { sixMaps } from "./maps.js";
import { fromPayload, LiveRun } from "./run.js";
import { observe, whereIs } from "./scene.js";
import { $, clock, count, html, inUnits, percent, svg } from "./words.js";

const LIVE = document.documentElement.dataset.source === "live";
const calm = matchMedia("(prefers-reduced-motion: reduce)");
const state = { time: 0, playing: false, following: LIVE, rate: 5, mode: "", zone: 0, picked: null, hovered: null };
const layers = { discs: true, serving: true, links: true, labels: false };
let run = null, theme = null, map = null, charts = null, lists = null, member = null, scene = null;

const step = () => Math.max(run.first, Math.min(run.steps, Math.floor(state.time + 1e-6)));

/* ---- time ---- */

function seek(time) {
  state.time = Math.max(Math.max(0, run.first), Math.min(run.steps, time));
  if (run.live) follow(state.time >= run.steps);
  else if (state.time >= run.steps && state.playing) play(false);
  draw();
}

const SHAPES = { play: "M5 3l12 7-12 7z", pause: "M4 3h4v14H4zM12 3h4v14h-4z" };

function showPlay(on) {
  $("play").setAttribute("aria-label", on ? "Pause" : LIVE ? "Follow the fleet" : "Play");
  $("play").querySelector("path").setAttribute("d", on ? SHAPES.pause : SHAPES.play);
}

function play(on) {
  if (run.live) {
    follow(on);
    return draw();
  }
  if (on && state.time >= run.steps) state.time = 0;
  state.playing = on;
  showPlay(on);
  if (!on) {
    remember();
    return draw();
  }
  let last = performance.now();
  requestAnimationFrame(function frame(now) {
    if (!state.playing) return;
    const passed = Math.min(250, Math.max(0, now - last)) / 1000;
    last = now;
    seek(state.time + passed * state.rate);
    requestAnimationFrame(frame);
  });
}

/* A live page stays a step behind the news, so that it can fly between two of them. */
const pace = { arrived: 0, between: 1000 };
let following = false;

function follow(on) {
  state.following = on;
  showPlay(on);
  if (!on || following) return;
  following = true;
  let last = performance.now();
  requestAnimationFrame(function frame(now) {
    if (!state.following) {
      following = false;
      return;
    }
    const passed = Math.max(0, now - last);
    last = now;
    const behind = run.steps - state.time;
    const time = behind > 2.5 ? run.steps - 1 : Math.min(run.steps, state.time + (passed / pace.between) * (behind > 1.2 ? 1.25 : 1));
    if (time !== state.time) {
      state.time = Math.max(run.first, time);
      draw();
    }
    requestAnimationFrame(frame);
  });
}

/* ---- painting ---- */

let drawing = false;
function draw() {
  if (drawing || !run) return;
  drawing = true;
  requestAnimationFrame(paint);
}

function paint() {
  drawing = false;
  if (!run || run.first < 0) return;
  const started = performance.now();
  scene = observe(run, state.mode, state.time, calm.matches);
  const marked = [state.picked, state.hovered].filter(Boolean).map((one) => ({ ...one, at: whereIs(scene, one) }));
  map.draw(scene, { layers, marked, theme, zoneTexts });
  charts.cursor(scene.at, calm.matches ? scene.at : state.time);
  lists.draw(scene.at);
  member.draw(scene, state.picked, state.mode, theme);
  drawTexts();
  page.painted++;
  page.script += performance.now() - started;
}

function zoneTexts(zone) {
  const kind = state.mode;
  const covered = Math.round(100 * run.metric(kind + "coverage", zone)[scene.at]);
  if (!Number.isFinite(covered)) return {}; // without a team
  const linked = run.metric(kind + "connectivity", zone)[scene.at] >= 1;
  return { text: `${covered} %, ${linked ? "linked" : "split"}`, warn: !linked };
}

function drawTexts() {
  const { at, count: here, served, covered, uavs } = scene;
  $("scrub").min = Math.max(0, run.first);
  $("scrub").max = run.steps;
  $("scrub").value = at;
  $("scrub").setAttribute("aria-valuetext", `${clock(run, at)}, step ${at} of ${run.steps}`);
  const now = clock(run, at), end = " / " + clock(run, run.steps);
  if ($("clock").textContent !== now + end) $("clock").replaceChildren(now, html("small", { textContent: end }));
  const period = run.periodOf(run.live ? at : Math.min(at, run.steps - 1));
  let selected = 0;
  for (const one of uavs.state) selected += one >= 2;
  const { asked = 0, accepted = 0 } = run.proposals[period] ?? {};
  const selection = `Selection ${period + 1}` + (run.live ? "" : ` of ${Math.ceil(run.steps / run.periodSteps)}`);
  const status =
    (state.mode ? `${selection}, same rules: ${selected} UAVs hover. `
      : run.live ? `${selection}: ${selected} UAVs at work. `
        : `${selection}: ${accepted} of ${asked} proposals accepted, ${selected} UAVs at work. `) +
    `${count(here)} vehicles here, ${count(served)} served, ${count(covered)} in range.`;
  if ($("status").textContent !== status) $("status").textContent = status; // the same text anew is painted anew
  if (run.live) drawTiles(here, served, covered, selected);
  if (!state.playing && !state.following) $("stage-map").setAttribute("aria-label", "Map. " + $("status").textContent);
  drawCard();
}

function drawTiles(here, served, covered, selected) {
  const connectivity = run.metric("connectivity", 0)[scene.at];
  const tiles = [
    ["In range", `${count(covered)} of ${count(here)}`, "connected vehicles now"],
    ["Coverage of those served", percent(served ? covered / served : NaN), `${count(served)} served`],
    ["Connectivity", percent(connectivity), "of the teams are linked"],
    ["UAVs at work", `${selected}`, `of ${run.uavs.length}`],
  ];
  $("tiles").replaceChildren(...tiles.map(([name, value, note]) => {
    const tile = html("div", { className: "tile" });
    html("dt", { textContent: name }, tile);
    html("small", { textContent: note }, html("dd", { textContent: value }, tile));
    return tile;
  }));
}

/* What is under the pointer, in the corner that is farthest from it. */
function drawCard() {
  const shown = state.hovered;
  $("card").hidden = !shown;
  if (!shown) return;
  const [width, height] = map.size;
  const [x, y] = state.pointer ?? [0, 0];
  $("card").className = `card ${x > width / 2 ? "left" : "right"} ${y > height / 2 ? "upper" : "lower"}`;
  $("card").replaceChildren(
    html("b", { textContent: nameOf(run, shown) }),
    ...facts(run, scene, shown, state.mode).map((line) => html("p", { textContent: line })),
  );
}

/* ---- controls ---- */

function readTheme() {
  const style = getComputedStyle(document.documentElement);
  const read = (name) => {
    const hex = style.getPropertyValue("--" + name).trim();
    return [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));
  };
  theme = {
    name: document.documentElement.dataset.theme, font: getComputedStyle(document.body).fontFamily,
    colours: Array.from({ length: 8 }, (_, i) => read("c" + i)),
  };
  for (const name of ["map", "ink", "muted", "street", "zone", "grey", "disc", "warn", "learned"]) theme[name] = read(name);
}

function setTheme(name) {
  document.documentElement.dataset.theme = name;
  readTheme();
  remember();
  draw();
}

function setMode(mode) {
  state.mode = mode;
  document.querySelector(`input[name="mode"][value="${mode ? "static" : "learned"}"]`).checked = true;
  remember();
  draw();
}

function setZone(zone) {
  state.zone = zone;
  $("zone").value = zone;
  state.moved = false;
  map.fit(zone ? run.zoneArea(zone) : run.area, zone ? 1.2 : 1.04);
  charts.draw(zone);
  remember();
  draw();
}

function moveMap(move) {
  state.moved = true;
  move();
  remember();
}

/* Picks a member, brings it into sight where it is out of it, and lists its events. */
function pick(picked, look = true) {
  state.picked = picked;
  const id = picked ? nameOf(run, picked) : "";
  // Events follow the member where they name it (some contracts name only its address).
  const named = id && lists.run.eventCount() && eventNames(id);
  lists.set(lists.kind, named ? id : "");
  if (picked && look) {
    const at = whereIs(observe(run, state.mode, state.time, true), picked);
    if (at) {
      const [x, y] = map.project(...at), [width, height] = map.size;
      if (x < 20 || y < 20 || x > width - 20 || y > height - 20) moveMap(() => map.look(...at));
    }
  }
  $("say").textContent = picked ? `${id} picked` : "";
  remember();
  draw();
}

function eventNames(id) {
  for (let i = 0; i < run.eventCount(); i++) if (run.event(i).parts.some((part, k) => k % 2 && part === id)) return true;
  return false;
}

function go(at, found) {
  if (state.playing) play(false);
  seek(at);
  if (found) pick(found);
  remember();
}

/* The next member in sight, from west to east: UAVs first, then vehicles. */
function nextMember(direction) {
  const [width, height] = map.size;
  const members = [];
  const add = (kind, index, x, y) => {
    const [px, py] = map.project(x, y);
    if (px >= 0 && py >= 0 && px <= width && py <= height) members.push({ kind, index, x });
  };
  for (let u = 0; u < scene.uavs.count; u++) if (scene.uavs.state[u] & 1) add("uav", u, scene.uavs.x[u], scene.uavs.y[u]);
  for (let k = 0; k < scene.count; k++) add("vehicle", scene.vehicles.vehicle[k], scene.vehicles.x[k], scene.vehicles.y[k]);
  if (!members.length) return;
  members.sort((a, b) => (a.kind < b.kind ? -1 : a.kind > b.kind ? 1 : a.x - b.x));
  const now = members.findIndex(({ kind, index }) => kind === state.picked?.kind && index === state.picked?.index);
  const next = members[now < 0 ? (direction > 0 ? 0 : members.length - 1) : (now + direction + members.length) % members.length];
  pick({ kind: next.kind, index: next.index });
}

/* ---- the address: #step=40&zone=5&mode=static&pick=uav:uav_03 opens there ---- */

let remembering = 0;
function remember() {
  clearTimeout(remembering);
  if (!state.ready) return;
  remembering = setTimeout(() => {
    const hash = new URLSearchParams();
    if (!run.live) hash.set("step", step());
    if (state.zone) hash.set("zone", state.zone);
    if (state.mode) hash.set("mode", "static");
    if (state.picked) hash.set("pick", `${state.picked.kind}:${nameOf(run, state.picked)}`);
    if (lists.kind) hash.set("kind", lists.kind);
    if (lists.member && (!state.picked || lists.member !== nameOf(run, state.picked))) hash.set("member", lists.member);
    const off = Object.keys(layers).filter((name) => layers[name] !== (name !== "labels"));
    if (off.length) hash.set("layers", off.join("."));
    if (state.rate !== 5) hash.set("speed", state.rate);
    const { target: [x, y], zoom } = map.view;
    if (state.moved) hash.set("view", [x + run.origin[0], y + run.origin[1]].map((value) => value.toFixed(0)).join() + "," + zoom.toFixed(2));
    if (document.documentElement.dataset.theme !== preferred()) hash.set("theme", document.documentElement.dataset.theme);
    written = "#" + hash;
    history.replaceState(null, "", written);
  }, 200);
}
let written = "";

const preferred = () => (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");

function recall() {
  const wanted = new URLSearchParams(location.hash.slice(1));
  document.documentElement.dataset.theme = ["dark", "light"].includes(wanted.get("theme")) ? wanted.get("theme") : preferred();
  readTheme();
  state.mode = wanted.get("mode") === "static" && !run.live ? "static_" : "";
  document.querySelector(`input[name="mode"][value="${state.mode ? "static" : "learned"}"]`).checked = true;
  const rate = parseFloat(wanted.get("speed"));
  if ([...$("speed").options].some(({ value }) => +value === rate)) state.rate = +($("speed").value = rate);
  for (const name of Object.keys(layers)) {
    layers[name] = (name !== "labels") !== (wanted.get("layers") ?? "").split(".").includes(name);
    $("show-" + name).checked = layers[name];
  }
  if (!run.live) state.time = Math.max(0, Math.min(run.steps, parseInt(wanted.get("step"), 10) || 0));
  const zone = parseInt(wanted.get("zone"), 10);
  state.zone = zone > 0 && zone <= run.grid.columns * run.grid.rows ? zone : 0;
  $("zone").value = state.zone;
  if (state.zone) map.fit(run.zoneArea(state.zone), 1.2);
  state.moved = wanted.has("view");
  const [x, y, zoom] = (wanted.get("view") ?? "").split(",").map(Number);
  if ([x, y, zoom].every(Number.isFinite) && wanted.has("view")) map.look(x - run.origin[0], y - run.origin[1], zoom);
  const [, kind, id] = /^(uav|vehicle):(.+)$/.exec(wanted.get("pick") ?? "") ?? [];
  const index = id === undefined ? -1 : run.find(kind, id);
  if (index >= 0) pick({ kind, index }, false); else state.picked = null;
  if (wanted.has("kind") || wanted.has("member")) lists.set(wanted.get("kind") ?? "", wanted.get("member") ?? lists.member);
}

function makeControls() {
  $("play").addEventListener("click", () => play(LIVE ? !state.following : !state.playing));
  $("scrub").addEventListener("input", () => { seek(+$("scrub").value); remember(); });
  $("speed").addEventListener("change", () => { state.rate = +$("speed").value; remember(); });
  $("zone").addEventListener("change", () => setZone(+$("zone").value));
  $("theme").addEventListener("click", () => setTheme(document.documentElement.dataset.theme === "dark" ? "light" : "dark"));
  $("zoom-in").addEventListener("click", () => moveMap(() => map.zoomBy(0.7)));
  $("zoom-out").addEventListener("click", () => moveMap(() => map.zoomBy(-0.7)));
  $("zoom-fit").addEventListener("click", () => setZone(0));
  for (const input of document.querySelectorAll('input[name="mode"]')) {
    input.addEventListener("change", () => setMode(input.value === "static" ? "static_" : ""));
  }
  for (const name of Object.keys(layers)) {
    $("show-" + name).addEventListener("change", (event) => { layers[name] = event.target.checked; remember(); draw(); });
  }
  $("find").addEventListener("input", suggest);
  $("find").addEventListener("change", () => find($("find").value));
  $("find").addEventListener("keydown", (event) => { if (event.key === "Enter") find($("find").value); });
  addEventListener("keydown", onKey);
  addEventListener("hashchange", () => { if (run && location.hash !== written) { recall(); charts.draw(state.zone); draw(); } });
  // A focused button would answer the space key twice.
  $("play").addEventListener("keyup", (event) => { if (event.key === " ") event.preventDefault(); });
}

function suggest() {
  const wanted = $("find").value.toLowerCase();
  const found = [];
  for (const names of [run.uavs, run.vehicles]) {
    for (const name of names) {
      if (found.length < 20 && wanted && name.toLowerCase().includes(wanted)) found.push(name);
    }
  }
  $("members").replaceChildren(...found.map((value) => html("option", { value })));
}

function find(id) {
  for (const kind of ["uav", "vehicle"]) {
    const index = run.find(kind, id.trim());
    if (index >= 0) return pick({ kind, index });
  }
  if (id.trim()) $("say").textContent = "no member of that name";
  return undefined;
}

function onKey(event) {
  if (event.ctrlKey || event.altKey || event.metaKey || !run) return;
  const target = event.target;
  if (event.key === "Escape") {
    pick(null);
    setZone(0);
    return;
  }
  if (target.matches("input[type=search], select")) return;
  const stride = event.shiftKey ? run.periodSteps : 1;
  const moved = (time) => { seek(time); remember(); };
  const keys = {
    " ": () => play(LIVE ? !state.following : !state.playing),
    ArrowLeft: () => moved(Math.ceil(state.time - 1e-6) - stride),
    ArrowRight: () => moved(step() + stride),
    Home: () => moved(0),
    End: () => moved(run.steps),
    m: () => run.live || setMode(state.mode ? "" : "static_"),
    "+": () => moveMap(() => map.zoomBy(0.7)),
    "=": () => moveMap(() => map.zoomBy(0.7)),
    "-": () => moveMap(() => map.zoomBy(-0.7)),
    n: () => nextMember(1),
    N: () => nextMember(-1),
  };
  if (target === $("stage-map")) {
    Object.assign(keys, {
      ArrowLeft: () => moveMap(() => map.panBy(-60, 0)), ArrowRight: () => moveMap(() => map.panBy(60, 0)),
      ArrowUp: () => moveMap(() => map.panBy(0, 60)), ArrowDown: () => moveMap(() => map.panBy(0, -60)),
    });
  }
  const radio = target.matches("input[type=radio]") && event.key.startsWith("Arrow");
  const own = [" ", "Enter"].includes(event.key) && target.matches("button:not(#play), input[type=checkbox]");
  if (!keys[event.key] || radio || own) return;
  event.preventDefault();
  keys[event.key]();
}

function drawPeriods() {
  const width = $("scrub").clientWidth;
  const box = $("periods");
  box.setAttribute("viewBox", `0 0 ${width} 12`);
  box.replaceChildren();
  if (run.live) return;
  const thumb = 16;
  const periods = Math.ceil(run.steps / run.periodSteps);
  const every = Math.max(1, Math.ceil((periods * 14) / width));
  for (let period = 0; period < periods; period += every) {
    const x = thumb / 2 + ((period * run.periodSteps) / run.steps) * (width - thumb);
    svg("line", { x1: x, x2: x, y1: 0, y2: 5 }, box);
    if ((width / periods) * every > 80) svg("text", { x: x + 4, y: 9 }, box).textContent = "selection " + (period + 1);
  }
}

/* ---- a run on the page ---- */

function show(shown) {
  run = page.run = shown;
  Object.assign(state, { picked: null, hovered: null, zone: 0 });
  charts = new Charts(run, (at) => { seek(at); remember(); });
  lists = new Lists(run, go, () => { remember(); draw(); });
  member = new Member(run, { seek: (at) => { seek(at); remember(); }, close: () => pick(null) });
  map.setRun(run);
  $("zone").replaceChildren(...Array.from({ length: run.grid.columns * run.grid.rows + 1 }, (_, zone) => zone)
    .filter((zone) => run.live || run.metricZones.includes(zone))
    .map((zone) => html("option", { value: zone, textContent: zone || "all" })));
  $("speed").replaceChildren(...[1, 2, 5, 10, 20].map((rate) =>
    html("option", { value: rate, textContent: "×" + +(rate * run.stepSeconds).toFixed(2), selected: rate === state.rate })));
  $("speed").title = "Times real time";
}

function layout() {
  if (!run) return;
  charts.draw(state.zone);
  drawPeriods();
  paint(); // at once: a frame later, the old picture would be seen stretched
}

async function start() {
  document.documentElement.dataset.theme = preferred();
  readTheme();
  map = page.map = new FleetMap($("stage-map"), {
    onView: (byHand) => { if (byHand) { state.moved = true; remember(); } draw(); },
    onPoint: (found, pointer) => {
      if (!run) return;
      Object.assign(state, { hovered: found, pointer });
      draw();
    },
    onPick: (found, [x, y]) => {
      if (!run) return;
      if (found) return pick(found, false);
      if (state.picked) return pick(null);
      const zone = run.zoneAt(x, y);
      if (zone && !state.zone && run.metricZones.includes(zone)) setZone(zone);
    },
  });
  makeControls();
  const resized = () => {
    const area = state.zone ? run?.zoneArea(state.zone) : run?.area;
    if (run && !state.moved) map.fit(area, state.zone ? 1.2 : 1.04);
    layout();
  };
  const observer = new ResizeObserver(resized);
  if (LIVE) startLive(observer);
  else {
    show(await fromPayload($("payload").textContent));
    recall();
    layout();
    opened();
  }
  for (const element of [$("stage-map"), $("charts"), $("scrub")]) observer.observe(element);
}

function opened() {
  state.ready = true;
  requestAnimationFrame(() => requestAnimationFrame(() => { document.body.dataset.ready = "true"; }));
}

function startLive() {
  const hash = new URLSearchParams(location.hash.slice(1));
  const token = hash.get("token"); // into this tab's memory, out of the address
  if (token) {
    hash.delete("token");
    history.replaceState(null, "", "#" + hash);
  }
  const words = { connected: "live", away: "no connection: trying again", ended: "the token is not the server's" };
  let waiting = null;
  listen({
    token,
    onState(name) {
      $("live").textContent = words[name];
      $("live").dataset.state = name;
    },
    onHeader(header) {
      if (run?.session === header.session) return;
      waiting = new LiveRun(header);
    },
    onRecord(record) {
      const now = performance.now();
      if (waiting) {
        waiting.add(record);
        const shown = waiting;
        waiting = null;
        $("title").textContent = shown.name;
        document.title = `SkyRelay · ${shown.name} · live`;
        show(shown);
        recall();
        state.time = run.steps;
        pace.arrived = now;
        follow(true);
        layout();
        opened();
        return;
      }
      if (!run?.add(record)) return;
      const between = now - pace.arrived;
      pace.arrived = now;
      if (between > 20) pace.between += 0.3 * (Math.min(between, 1000 * run.stepSeconds * 2) - pace.between);
      charts.draw(state.zone);
      if (!state.following || calm.matches) {
        if (state.following) state.time = run.steps;
        draw();
      }
    },
  });
}

/* For the console and the tests; the page itself reads nothing from it. */
const page = (window.skyrelay = { state, layers, painted: 0, script: 0, seek, pick, setZone, observe: () => observe(run, state.mode, state.time, false), inUnits, sixMaps });

start().catch((error) => {
  html("p", { className: "fatal", role: "alert", textContent: "This page could not be shown: " + error.message }, document.body);
  throw error;
});
