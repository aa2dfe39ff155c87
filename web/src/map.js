/* The map: deck.gl draws what moves; streets, buildings and tracks are painted once a view into a picture beneath it,
   and texts on a canvas above it. */

import { Deck, OrthographicView } from "@deck.gl/core";
import { BitmapLayer, IconLayer, LineLayer, ScatterplotLayer } from "@deck.gl/layers";

const MARGIN = 0.35; // how far the picture beneath reaches beyond the view, as a share of it
const SETTLED = 140; // ms without a move after which it is painted again
const CROWD = 2500; // vehicles in view above which they are drawn small and plain

export class FleetMap {
  /* onView is called after every pan and zoom, onPoint with what lies under the pointer, onPick at a click. */
  constructor(parent, { onView, onPoint, onPick }) {
    this.parent = parent;
    this.texts = parent.querySelector("#texts");
    this.view = { target: [0, 0, 0], zoom: 0 };
    this.onView = onView;
    this.scene = null;
    this.frames = 0;
    this.deck = new Deck({
      parent,
      id: "map",
      views: new OrthographicView({ flipY: false, controller: { keyboard: false, inertia: false, doubleClickZoom: true } }),
      viewState: this.view,
      deviceProps: { type: "webgl", webgl: { preserveDrawingBuffer: true, antialias: true } },
      layers: [],
      getCursor: ({ isDragging }) => (isDragging ? "grabbing" : "crosshair"),
      onViewStateChange: ({ viewState }) => {
        this.view = { target: viewState.target, zoom: this.#bounded(viewState.zoom) };
        this.onView(true);
      },
      onLoad: () => {
        const canvas = this.deck.getCanvas();
        canvas.setAttribute("aria-hidden", "true"); // what it shows is told by the element around it, which has the focus
        canvas.tabIndex = -1;
      },
      onAfterRender: () => { this.frames++; },
      onError: (error) => { throw error; },
    });
    const point = (event) => {
      const bounds = parent.getBoundingClientRect();
      return [event.clientX - bounds.left, event.clientY - bounds.top];
    };
    let down = null;
    parent.addEventListener("pointerdown", (event) => { down = point(event); });
    parent.addEventListener("pointermove", (event) => {
      if (event.pointerType !== "touch" && !event.buttons) onPoint(this.hit(...point(event)), point(event));
    });
    parent.addEventListener("pointerleave", () => onPoint(null));
    parent.addEventListener("click", (event) => {
      if (event.target.closest("button")) return;
      const [x, y] = point(event);
      if (down && Math.hypot(x - down[0], y - down[1]) > 5) return; // the end of a pan
      onPick(this.hit(x, y), this.unproject(x, y));
    });
  }

  #bounded(zoom) {
    return Math.max(this.least - 3, Math.min(5, zoom));
  }

  get size() {
    return [this.parent.clientWidth, this.parent.clientHeight];
  }

  /* Pixels of a metre. */
  get scale() {
    return 2 ** this.view.zoom;
  }

  project(x, y) {
    const [width, height] = this.size;
    return [width / 2 + (x - this.view.target[0]) * this.scale, height / 2 - (y - this.view.target[1]) * this.scale];
  }

  unproject(px, py) {
    const [width, height] = this.size;
    return [this.view.target[0] + (px - width / 2) / this.scale, this.view.target[1] - (py - height / 2) / this.scale];
  }

  setRun(run) {
    this.run = run;
    this.fit(run.area);
  }

  get least() {
    if (!this.run) return 0;
    const [width, height] = this.size, [x0, y0, x1, y1] = this.run.area;
    return Math.log2(Math.min(width / (x1 - x0), height / (y1 - y0)) / 1.04);
  }

  fit([x0, y0, x1, y1], margin = 1.04) {
    const [width, height] = this.size;
    if (!width || !height) return;
    const zoom = Math.log2(Math.min(width / (x1 - x0), height / (y1 - y0)) / margin);
    this.look((x0 + x1) / 2, (y0 + y1) / 2, zoom);
  }

  look(x, y, zoom = this.view.zoom) {
    this.view = { target: [x, y, 0], zoom: this.#bounded(zoom) };
    this.onView(false);
  }

  zoomBy(step) {
    this.look(this.view.target[0], this.view.target[1], this.view.zoom + step);
  }

  panBy(right, up) {
    const [x, y] = this.view.target;
    this.look(x + right / this.scale, y + up / this.scale);
  }

  /* The nearest member within 14 pixels of a point of the map. */
  hit(px, py) {
    const { scene } = this;
    if (!scene) return null;
    const [x, y] = this.unproject(px, py);
    let best = null, least = 14 / this.scale;
    for (let k = 0; k < scene.count; k++) {
      const distance = Math.hypot(scene.vehicles.x[k] - x, scene.vehicles.y[k] - y);
      if (distance < least) [best, least] = [{ kind: "vehicle", index: scene.vehicles.vehicle[k] }, distance];
    }
    for (let u = 0; u < scene.uavs.count; u++) {
      if (!(scene.uavs.state[u] & 1)) continue;
      const distance = Math.hypot(scene.uavs.x[u] - x, scene.uavs.y[u] - y) - 3 / this.scale;
      if (distance < least) [best, least] = [{ kind: "uav", index: u }, distance];
    }
    return best;
  }

  draw(scene, { layers, marked, theme, zoneTexts }) {
    this.scene = scene;
    this.theme = theme;
    const { run, scale } = this;
    const { uavs } = scene;
    const [width, height] = this.size;
    const [left, top] = this.unproject(-30, -30), [right, bottom] = this.unproject(width + 30, height + 30);
    const seen = (x, y) => x >= left && x <= right && y >= bottom && y <= top;

    const crowd = this.#vehiclesIn(scene, seen);
    const plain = crowd.length > CROWD;
    const radius = plain
      ? Math.max(1.4, Math.min(3, 90 / Math.sqrt(crowd.length)))
      : Math.max(2.6, Math.min(6, 60 / Math.sqrt(Math.max(1, crowd.length))));
    const reach = run.range * scale;
    const flying = [];
    for (let u = 0; u < uavs.count; u++) if (uavs.state[u] & 1) flying.push(u);
    const team = flying.filter((u) => uavs.state[u] >= 2);
    const near = team.filter((u) =>
      uavs.x[u] + run.range >= left && uavs.x[u] - run.range <= right &&
      uavs.y[u] + run.range >= bottom && uavs.y[u] - run.range <= top);
    const drones = flying.filter((u) => seen(uavs.x[u], uavs.y[u]));
    const size = Math.max(reach > 200 ? 8 : 0, Math.max(3, Math.min(7, 60 / Math.sqrt(Math.max(1, drones.length)))));

    const list = [this.#ground()];
    if (layers.discs && reach > 6) list.push(this.#discs(near));
    if (layers.serving && reach > 10) list.push(this.#serving(scene, crowd));
    if (layers.links) list.push(...this.#links(scene));
    list.push(this.#pickedLines(scene, marked));
    list.push(...this.#vehicles(scene, crowd, radius, plain));
    list.push(...this.#drones(drones, size));
    list.push(this.#rings(marked));
    this.deck.setProps({ viewState: this.view, layers: list });
    this.#write(drones, size, layers.labels, zoneTexts);
  }

  #vehiclesIn({ count, vehicles }, seen) {
    const rows = new Int32Array(count);
    let length = 0;
    for (let k = 0; k < count; k++) if (seen(vehicles.x[k], vehicles.y[k])) rows[length++] = k;
    return rows.subarray(0, length);
  }

  #discs(team) {
    const { x, y } = this.scene.uavs;
    const { theme } = this;
    return new ScatterplotLayer({
      id: "discs",
      data: table(team.length, {
        getPosition: positions(team, x, y),
        getFillColor: colours(team.length, () => theme.disc, team.length > 60 ? 14 : 24),
        getLineColor: colours(team.length, (k) => theme.colours[this.run.colours[team[k]]], 150),
      }),
      getRadius: this.run.range, stroked: true, filled: true, lineWidthUnits: "pixels", getLineWidth: 1.2,
    });
  }

  #serving({ vehicles, uavs }, crowd) {
    const { theme, run } = this;
    const rows = crowd.filter((k) => vehicles.uav[k] >= 0 && uavs.state[vehicles.uav[k]] & 1);
    const from = new Float32Array(2 * rows.length), to = new Float32Array(2 * rows.length);
    rows.forEach((k, i) => {
      const u = vehicles.uav[k];
      from[2 * i] = uavs.x[u];
      from[2 * i + 1] = uavs.y[u];
      to[2 * i] = vehicles.x[k];
      to[2 * i + 1] = vehicles.y[k];
    });
    return new LineLayer({
      id: "serving",
      data: table(rows.length, {
        getSourcePosition: { value: from, size: 2 },
        getTargetPosition: { value: to, size: 2 },
        getColor: colours(rows.length, (i) => vehicles.covered[rows[i]] ? theme.colours[run.colours[vehicles.uav[rows[i]]]] : theme.warn, 150),
      }),
      getWidth: 1.1,
    });
  }

  #links({ links, uavs }) {
    const from = new Float32Array(links.length), to = new Float32Array(links.length);
    for (let i = 0; i < links.length; i += 2) {
      from[i] = uavs.x[links[i]];
      from[i + 1] = uavs.y[links[i]];
      to[i] = uavs.x[links[i + 1]];
      to[i + 1] = uavs.y[links[i + 1]];
    }
    return [["halo", 5, this.theme.map, 200], ["link", 2.2, this.theme.ink, 190]].map(([id, getWidth, colour, alpha]) =>
      new LineLayer({
        id: "links-" + id,
        data: table(links.length / 2, { getSourcePosition: { value: from, size: 2 }, getTargetPosition: { value: to, size: 2 } }),
        getWidth, getColor: [...colour, alpha], updateTriggers: { getColor: [colour] },
      }));
  }

  #vehicles({ vehicles }, crowd, radius, plain) {
    const { theme, run } = this;
    const colour = (i) => {
      const uav = vehicles.uav[crowd[i]];
      return uav < 0 ? theme.grey : theme.colours[run.colours[uav]];
    };
    const dots = new ScatterplotLayer({
      id: "vehicles",
      data: table(crowd.length, {
        getPosition: positions(crowd, vehicles.x, vehicles.y),
        getFillColor: colours(crowd.length, colour, 255),
        getRadius: { value: Float32Array.from(crowd, (k) => vehicles.uav[k] < 0 ? radius * 0.75 : radius), size: 1 },
      }),
      radiusUnits: "pixels", lineWidthUnits: "pixels", stroked: !plain, getLineWidth: 1, getLineColor: [...theme.map, 255],
      updateTriggers: { getLineColor: [theme.map] },
    });
    const out = crowd.filter((k) => vehicles.uav[k] >= 0 && !vehicles.covered[k]);
    const halos = new ScatterplotLayer({
      id: "out-of-range",
      data: table(out.length, { getPosition: positions(out, vehicles.x, vehicles.y) }),
      radiusUnits: "pixels", lineWidthUnits: "pixels", getRadius: radius + (plain ? 1.5 : 3), filled: false, stroked: true,
      getLineWidth: plain ? 1 : 1.8, getLineColor: [...theme.warn, 255], updateTriggers: { getLineColor: [theme.warn], getRadius: [radius, plain] },
    });
    return [dots, halos];
  }

  #drones(drones, size) {
    const { theme, run, scene } = this;
    const { uavs } = scene;
    const where = positions(drones, uavs.x, uavs.y);
    const busy = (i) => uavs.state[drones[i]] >= 2;
    const radii = Float32Array.from(drones, (u) => (uavs.state[u] >= 2 ? size : size * 0.7));
    return [
      new IconLayer({
        id: "arms",
        data: table(drones.length, {
          getPosition: where,
          getColor: colours(drones.length, (i) => busy(i) ? theme.ink : theme.grey, 255),
          getSize: { value: radii.map((radius) => 3.4 * radius), size: 1 },
        }),
        iconAtlas: armsIcon(), iconMapping: { arms: { x: 0, y: 0, width: 64, height: 64, mask: true } }, getIcon: () => "arms",
      }),
      new ScatterplotLayer({
        id: "bodies",
        data: table(drones.length, {
          getPosition: where,
          getFillColor: colours(drones.length, (i) => busy(i) ? theme.colours[run.colours[drones[i]]] : theme.map, 255),
          getLineColor: colours(drones.length, (i) => busy(i) ? theme.ink : theme.grey, 255),
          getRadius: { value: radii.map((radius) => 0.75 * radius), size: 1 },
        }),
        radiusUnits: "pixels", lineWidthUnits: "pixels", stroked: true, getLineWidth: 1.2,
      }),
    ];
  }

  #pickedLines({ count, vehicles, uavs }, marked) {
    const from = [], to = [];
    for (const { kind, index } of marked) {
      for (let k = 0; k < count; k++) {
        const u = vehicles.uav[k];
        if (u < 0 || !(uavs.state[u] & 1) || index !== (kind === "uav" ? u : vehicles.vehicle[k])) continue;
        from.push(uavs.x[u], uavs.y[u]);
        to.push(vehicles.x[k], vehicles.y[k]);
      }
    }
    return new LineLayer({
      id: "picked-lines",
      data: table(from.length / 2, {
        getSourcePosition: { value: Float32Array.from(from), size: 2 }, getTargetPosition: { value: Float32Array.from(to), size: 2 },
      }),
      getWidth: 2, getColor: [...this.theme.ink, 255], updateTriggers: { getColor: [this.theme.ink] },
    });
  }

  #rings(marked) {
    const at = marked.filter(({ at: point }) => point);
    return new ScatterplotLayer({
      id: "rings",
      data: table(at.length, {
        getPosition: { value: Float32Array.from(at.flatMap(({ at: point }) => point)), size: 2 },
        getRadius: { value: Float32Array.from(at, ({ kind }) => (kind === "uav" ? 16 : 10)), size: 1 },
      }),
      radiusUnits: "pixels", lineWidthUnits: "pixels", filled: false, stroked: true, getLineWidth: 2.4,
      getLineColor: [...this.theme.ink, 255], updateTriggers: { getLineColor: [this.theme.ink] },
    });
  }

  /* ---- the picture beneath ---- */

  #ground() {
    const [width, height] = this.size;
    const [left, bottom] = this.unproject(-width * MARGIN, height * (1 + MARGIN));
    const [right, top] = this.unproject(width * (1 + MARGIN), -height * MARGIN);
    const wanted = [left, bottom, right, top, this.theme.name, this.run.tracksLast ?? 0, this.run.session].join();
    const ground = this.ground;
    if (!ground || ground.theme !== this.theme.name || ground.run !== this.run) this.#paintGround(wanted, [left, bottom, right, top]);
    else if (ground.key !== wanted) {
      clearTimeout(this.settling);
      this.settling = setTimeout(() => {
        this.#paintGround(wanted, [left, bottom, right, top]);
        this.onView(false);
      }, SETTLED);
    }
    return new BitmapLayer({ id: "ground", image: this.ground.canvas, bounds: this.ground.bounds });
  }

  #paintGround(key, bounds) {
    clearTimeout(this.settling);
    const [left, bottom, right, top] = bounds;
    const [width, height] = this.size;
    const ratio = Math.min(devicePixelRatio || 1, 2, 4096 / (width * (1 + 2 * MARGIN)), 4096 / (height * (1 + 2 * MARGIN)));
    const canvas = document.createElement("canvas"); // a new one: deck.gl knows by it that the picture changed
    canvas.width = Math.max(1, Math.round(width * (1 + 2 * MARGIN) * ratio));
    canvas.height = Math.max(1, Math.round(height * (1 + 2 * MARGIN) * ratio));
    const scale = canvas.width / (right - left);
    const px = (x) => (x - left) * scale, py = (y) => (top - y) * scale;
    const pen = canvas.getContext("2d");
    const { run, theme } = this;
    pen.fillStyle = css(theme.map);
    pen.fillRect(0, 0, canvas.width, canvas.height);
    pen.fillStyle = pen.strokeStyle = css(theme.street);
    let highest = 1;
    for (const { height: metres } of run.buildings) highest = Math.max(highest, metres);
    for (const { corners, height: metres } of run.buildings) {
      pen.globalAlpha = 0.15 + (0.35 * metres) / highest;
      pen.beginPath();
      for (let i = 0; i < corners.length; i += 2) pen.lineTo(px(corners[i]), py(corners[i + 1]));
      pen.fill();
    }
    pen.lineJoin = pen.lineCap = "round";
    if (run.streets.length) {
      // Roads as they are, at least a pixel and a half wide.
      pen.globalAlpha = 0.42;
      pen.lineWidth = Math.max(1.3 * ratio, Math.min(14 * ratio, 6 * scale));
      pen.beginPath();
      for (const line of run.streets) trace(pen, line, px, py, ratio);
      pen.stroke();
    } else if (!run.live) this.#tracks(pen, px, py, scale, ratio);
    pen.globalAlpha = 1;
    this.#zones(pen, px, py, ratio, scale);
    this.ground = { key, canvas, bounds, run, theme: theme.name };
  }

  /* Where no streets were named, the tracks of the vehicles: the streets appear where they drive. */
  #tracks(pen, px, py, scale, ratio) {
    const { run } = this;
    pen.globalAlpha = Math.max(0.03, Math.min(0.12, 20 / run.vehicles.length));
    pen.lineWidth = Math.max(1.4 * ratio, Math.min(9 * ratio, 6 * scale));
    const jump = 60 * run.stepSeconds; // faster than 60 m/s is a gap in the trace, not a street
    const most = 150_000; // segments; of more, every so many vehicles
    const every = Math.ceil(run.vehicle.length / most);
    for (let i = 0; i < run.vehicle.length; ) {
      const vehicle = run.vehicle[i];
      const drawn = vehicle % every === 0;
      if (drawn) pen.beginPath();
      let x0 = NaN, y0 = NaN;
      for (let first = true; i < run.vehicle.length && run.vehicle[i] === vehicle; i++, first = false) {
        if (!drawn) continue;
        const x = run.vehicle_x[i], y = run.vehicle_y[i];
        const gap = first || run.vehicle_step[i] !== run.vehicle_step[i - 1] + 1 || Math.hypot(x - x0, y - y0) > jump;
        if (gap) pen.moveTo(px(x), py(y)); else pen.lineTo(px(x), py(y));
        [x0, y0] = [x, y];
      }
      if (drawn) pen.stroke();
    }
  }

  #zones(pen, px, py, ratio, scale) {
    const { x0, y0, side, columns, rows } = this.run.grid;
    const sharp = (pixel) => Math.round(pixel) + 0.5;
    pen.strokeStyle = css(this.theme.zone);
    pen.lineWidth = ratio;
    pen.beginPath();
    for (let column = 0; column <= columns; column++) {
      pen.moveTo(sharp(px(x0 + column * side)), py(y0));
      pen.lineTo(sharp(px(x0 + column * side)), py(y0 + rows * side));
    }
    for (let row = 0; row <= rows; row++) {
      pen.moveTo(px(x0), sharp(py(y0 + row * side)));
      pen.lineTo(px(x0 + columns * side), sharp(py(y0 + row * side)));
    }
    pen.stroke();
    pen.setLineDash([3 * ratio, 3 * ratio]);
    for (const [x, y, radius] of this.run.charging) {
      pen.beginPath();
      pen.arc(px(x), py(y), radius * scale, 0, 7);
      pen.stroke();
    }
    pen.setLineDash([]);
  }

  /* ---- the texts above ---- */

  #write(drones, size, names, zoneTexts) {
    const [width, height] = this.size;
    const ratio = devicePixelRatio || 1;
    const canvas = this.texts;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    const { run, theme, scene } = this;
    const { side, columns, rows } = run.grid;
    const pixels = side * this.scale;
    if (pixels >= 44) {
      pen.textBaseline = "top";
      for (let zone = 1; zone <= columns * rows; zone++) {
        const [x0, , x1, y1] = run.zoneArea(zone);
        const [left, top] = this.project(x0, y1), [right] = this.project(x1, y1);
        if (right < 0 || left > width || top > height - 44 || top + pixels < 20) continue; // the ruler is at the bottom
        const x = Math.max(left, 0) + 7, y = Math.max(top, 0) + 7; // stays in sight while any of the zone is
        const name = pixels < 100 ? String(zone) : "Zone " + zone;
        label(pen, name, x, y, theme.muted, theme);
        const { text, warn } = pixels < 150 ? {} : zoneTexts(zone);
        if (text) label(pen, text, x + pen.measureText(name + "  ").width, y, warn ? theme.warn : theme.muted, theme, 400);
      }
      for (const [x, y] of pixels >= 60 ? run.charging : []) {
        const [px, py] = this.project(x, y);
        label(pen, "⚡", px - 5, py - 7, theme.muted, theme);
      }
    }
    if (names && drones.length <= 300) {
      pen.textBaseline = "middle";
      for (const u of drones) {
        const [x, y] = this.project(scene.uavs.x[u], scene.uavs.y[u]);
        label(pen, run.uavs[u], x + size * 1.9, y, scene.uavs.state[u] >= 2 ? theme.ink : theme.muted, theme);
      }
    }
    this.#ruler(pen, width, height);
  }

  #ruler(pen, width, height) {
    const metres = [10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000, 20000, 50000].find((m) => m * this.scale > 60) ?? 100000;
    const x = width - 16 - metres * this.scale, y = height - 14;
    pen.strokeStyle = css(this.theme.muted);
    pen.lineWidth = 1.5;
    pen.beginPath();
    pen.moveTo(x, y - 4);
    pen.lineTo(x, y);
    pen.lineTo(width - 16, y);
    pen.lineTo(width - 16, y - 4);
    pen.stroke();
    pen.textBaseline = "alphabetic";
    pen.textAlign = "right";
    label(pen, metres >= 1000 ? metres / 1000 + " km" : metres + " m", width - 16, y - 6, this.theme.muted, this.theme);
    pen.textAlign = "left";
  }
}

/* Points closer than a pixel to the last one are left out. */
function trace(pen, line, px, py, ratio) {
  let x0 = px(line[0]), y0 = py(line[1]);
  pen.moveTo(x0, y0);
  for (let i = 2; i < line.length; i += 2) {
    const x = px(line[i]), y = py(line[i + 1]);
    if (i + 2 < line.length && Math.abs(x - x0) < ratio && Math.abs(y - y0) < ratio) continue;
    pen.lineTo(x, y);
    [x0, y0] = [x, y];
  }
}

function label(pen, text, x, y, colour, theme, weight = 600) {
  pen.font = weight + " 11px " + theme.font;
  pen.lineWidth = 3;
  pen.lineJoin = "round";
  pen.strokeStyle = css(theme.map);
  pen.strokeText(text, x, y);
  pen.fillStyle = css(colour);
  pen.fillText(text, x, y);
}

const css = ([red, green, blue]) => `rgb(${red} ${green} ${blue})`;
const table = (length, attributes) => ({ length, attributes });

function positions(rows, x, y) {
  const value = new Float32Array(2 * rows.length);
  for (let i = 0; i < rows.length; i++) {
    value[2 * i] = x[rows[i]];
    value[2 * i + 1] = y[rows[i]];
  }
  return { value, size: 2 };
}

function colours(count, colour, alpha) {
  const value = new Uint8Array(4 * count);
  for (let i = 0; i < count; i++) {
    const [red, green, blue] = colour(i);
    value[4 * i] = red;
    value[4 * i + 1] = green;
    value[4 * i + 2] = blue;
    value[4 * i + 3] = alpha;
  }
  return { value, size: 4, type: "unorm8", normalized: true };
}

/* Four arms with their rotors, white: deck.gl colours it. */
let arms = null;
function armsIcon() {
  if (arms) return arms;
  arms = document.createElement("canvas");
  arms.width = arms.height = 64;
  const pen = arms.getContext("2d");
  pen.strokeStyle = "#fff";
  pen.lineWidth = 4;
  for (const [dx, dy] of [[-1, -1], [1, -1], [1, 1], [-1, 1]]) {
    pen.beginPath();
    pen.moveTo(32, 32);
    pen.lineTo(32 + 19 * dx, 32 + 19 * dy);
    pen.stroke();
    pen.beginPath();
    pen.arc(32 + 20 * dx, 32 + 20 * dy, 8, 0, 7);
    pen.stroke();
  }
  return arms;
}
