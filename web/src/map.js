/* The map, on one 2D canvas: streets, buildings and tracks are painted once a view into a picture of their own, vehicles
   and UAVs are stamped as pixels, and lines, ranges and texts are drawn over and under them. Of a crowd all but the texts
   is pixels, put onto the canvas at once: one call instead of 20,000. */

import { opaque, Stamps } from "./stamps.js";

const MARGIN = 0.35; // how far the picture beneath reaches beyond the view, as a share of it
const SETTLED = 140; // ms without a move after which it is painted again
const CROWD = 2500; // vehicles in view above which they are drawn small and plain
const FILLED = 60; // ranges in view above which they are faint outlines
const CLICK = 5; // pixels that the pointer may move during a click

export class FleetMap {
  /* onView is called after every pan and zoom, onPoint with what lies under the pointer, onPick at a click. */
  constructor(parent, { onView, onPoint, onPick }) {
    this.parent = parent;
    this.canvas = parent.querySelector("#picture");
    this.pen = context(this.canvas);
    this.stamps = new Stamps();
    this.view = { target: [0, 0], zoom: 0 };
    this.onView = onView;
    this.scene = null;
    this.#listen(onPoint, onPick);
  }

  /* One pointer drags the map, two pinch it, the wheel and a double click zoom to where they are. */
  #listen(onPoint, onPick) {
    const { parent, canvas } = this;
    const point = (event) => {
      const bounds = canvas.getBoundingClientRect();
      return [event.clientX - bounds.left, event.clientY - bounds.top];
    };
    const held = new Map();
    let down = null, dragged = false;
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button) return;
      canvas.setPointerCapture(event.pointerId);
      if (!held.size) [down, dragged] = [point(event), false];
      else dragged = true; // a pinch is no click
      held.set(event.pointerId, point(event));
    });
    canvas.addEventListener("pointermove", (event) => {
      const now = point(event), last = held.get(event.pointerId);
      if (!last) {
        if (event.pointerType !== "touch" && !event.buttons) onPoint(this.hit(...now), now);
        return;
      }
      dragged ||= Math.hypot(now[0] - down[0], now[1] - down[1]) > CLICK;
      if (!dragged) return;
      canvas.classList.add("dragged");
      const before = middle(held);
      held.set(event.pointerId, now);
      const after = middle(held);
      this.#turn(before, after, before.spread ? Math.log2(after.spread / before.spread) : 0);
    });
    const up = (event) => {
      held.delete(event.pointerId);
      canvas.classList.toggle("dragged", dragged && held.size > 0);
    };
    canvas.addEventListener("pointerup", up);
    canvas.addEventListener("pointercancel", up);
    parent.addEventListener("pointerleave", () => onPoint(null));
    canvas.addEventListener("click", (event) => {
      if (dragged) return; // the end of a pan
      const [x, y] = point(event);
      onPick(this.hit(x, y), this.unproject(x, y));
    });
    canvas.addEventListener("dblclick", (event) => {
      const [x, y] = point(event);
      this.#turn({ x, y }, { x, y }, event.shiftKey ? -1 : 1);
    });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const [x, y] = point(event);
      const pixels = event.deltaY * [1, 16, 400][event.deltaMode];
      this.#turn({ x, y }, { x, y }, Math.max(-1, Math.min(1, -pixels / 300)));
    }, { passive: false });
  }

  /* Brings what lies at `from` to `to` [pixels], `step` zoom levels closer. */
  #turn(from, to, step) {
    const [x, y] = this.unproject(from.x, from.y);
    const [width, height] = this.size;
    const zoom = this.#bounded(this.view.zoom + step), scale = 2 ** zoom;
    this.view = { target: [x - (to.x - width / 2) / scale, y + (to.y - height / 2) / scale], zoom };
    this.onView(true);
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
    this.view = { target: [x, y], zoom: this.#bounded(zoom) };
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
    const { run, scale, pen } = this;
    const { uavs } = scene;
    const [width, height] = this.size;
    if (!width || !height) return;
    this.#resize(width, height);
    const [left, top] = this.unproject(-30, -30), [right, bottom] = this.unproject(width + 30, height + 30);
    const seen = (x, y) => x >= left && x <= right && y >= bottom && y <= top;

    const crowd = this.#vehiclesIn(scene, seen);
    const plain = crowd.length > CROWD;
    // To a quarter of a pixel, so that few stamps serve all views.
    const radius = quarters(plain
      ? Math.max(1.5, Math.min(3, 90 / Math.sqrt(crowd.length)))
      : Math.max(2.5, Math.min(6, 60 / Math.sqrt(Math.max(1, crowd.length)))));
    const reach = run.range * scale;
    const flying = [];
    for (let u = 0; u < uavs.count; u++) if (uavs.state[u] & 1) flying.push(u);
    const near = flying.filter((u) => uavs.state[u] >= 2 &&
      uavs.x[u] + run.range >= left && uavs.x[u] - run.range <= right &&
      uavs.y[u] + run.range >= bottom && uavs.y[u] - run.range <= top);
    const drones = flying.filter((u) => seen(uavs.x[u], uavs.y[u]));
    const size = quarters(Math.max(reach > 200 ? 8 : 0, Math.max(3, Math.min(7, 60 / Math.sqrt(Math.max(1, drones.length))))));

    pen.lineCap = "butt";
    this.stamps.clear(this.canvas.width, this.canvas.height, this.ratio);
    if (plain) {
      this.#layGround();
      if (layers.discs && reach > 6) this.#circles(near, reach);
      if (layers.serving && reach > 10) this.#servingPixels(scene, crowd);
      if (layers.links) this.#linkPixels(scene);
      this.#vehicles(scene, crowd, radius, plain);
      this.#drones(drones, size);
      this.stamps.onto(pen);
      this.#pickedLines(scene, marked);
    } else {
      this.#clear(width, height);
      this.#ground();
      if (layers.discs && reach > 6) this.#discs(near, reach);
      if (layers.serving && reach > 10) this.#serving(scene, crowd);
      if (layers.links) this.#links(scene);
      this.#pickedLines(scene, marked);
      this.#vehicles(scene, crowd, radius, plain);
      this.#drones(drones, size);
      pen.drawImage(this.stamps.picture(), 0, 0, width, height);
    }
    this.#rings(marked);
    this.#write(drones, size, layers.labels, zoneTexts);
  }

  #resize(width, height) {
    const { canvas, pen } = this;
    this.ratio = devicePixelRatio || 1;
    const [across, down] = [Math.round(width * this.ratio), Math.round(height * this.ratio)];
    if (canvas.width !== across || canvas.height !== down) Object.assign(canvas, { width: across, height: down });
    pen.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    pen.globalAlpha = 1;
  }

  #clear(width, height) {
    this.pen.fillStyle = css(this.theme.map);
    this.pen.fillRect(0, 0, width, height);
  }

  #vehiclesIn({ count, vehicles }, seen) {
    const rows = new Int32Array(count);
    let length = 0;
    for (let k = 0; k < count; k++) if (seen(vehicles.x[k], vehicles.y[k])) rows[length++] = k;
    return rows.subarray(0, length);
  }

  #discs(team, reach) {
    const { pen, theme, run } = this;
    const { x, y } = this.scene.uavs;
    const circles = (rows) => {
      pen.beginPath();
      for (const u of rows) {
        const [px, py] = this.project(x[u], y[u]);
        pen.moveTo(px + reach, py);
        pen.arc(px, py, reach, 0, 7);
      }
    };
    if (team.length <= FILLED) {
      circles(team);
      pen.globalAlpha = 0.09;
      pen.fillStyle = css(theme.disc);
      pen.fill();
    }
    pen.globalAlpha = team.length <= FILLED ? 0.6 : 0.35;
    pen.lineWidth = this.#hair(1.2);
    for (const [colour, rows] of grouped(team, (u) => run.colours[u])) {
      circles(rows);
      pen.strokeStyle = css(theme.colours[colour]);
      pen.stroke();
    }
    pen.globalAlpha = 1;
  }

  /* Lines of one device pixel need no outline to be filled. */
  #hair(wide) {
    return this.scene.count > CROWD || this.ratio === 1 ? 1 / this.ratio : wide;
  }

  #serving({ vehicles, uavs }, crowd) {
    const { pen, theme, run } = this;
    const rows = crowd.filter((k) => vehicles.uav[k] >= 0 && uavs.state[vehicles.uav[k]] & 1);
    pen.globalAlpha = 0.6;
    pen.lineWidth = this.#hair(1.1);
    for (const [colour, some] of grouped(rows, (k) => vehicles.covered[k] ? run.colours[vehicles.uav[k]] : -1)) {
      pen.strokeStyle = css(colour < 0 ? theme.warn : theme.colours[colour]);
      this.#lines(some, (k) => [uavs.x[vehicles.uav[k]], uavs.y[vehicles.uav[k]], vehicles.x[k], vehicles.y[k]]);
    }
    pen.globalAlpha = 1;
  }

  /* Strokes a line for each of some rows: ends [m] of a row are [x, y, x, y]. */
  #lines(rows, ends) {
    const { pen, scale } = this;
    const [left, top] = this.unproject(0, 0);
    pen.beginPath();
    for (const row of rows) {
      const [x0, y0, x1, y1] = ends(row);
      pen.moveTo((x0 - left) * scale, (top - y0) * scale);
      pen.lineTo((x1 - left) * scale, (top - y1) * scale);
    }
    pen.stroke();
  }

  #links({ links, uavs }) {
    const { pen } = this;
    const pairs = Array.from({ length: links.length / 2 }, (_, i) => i);
    for (const [width, colour, alpha] of [[5, this.theme.map, 0.78], [2.2, this.theme.ink, 0.75]]) {
      Object.assign(pen, { lineWidth: width, strokeStyle: css(colour), globalAlpha: alpha });
      this.#lines(pairs, (i) => [uavs.x[links[2 * i]], uavs.y[links[2 * i]], uavs.x[links[2 * i + 1]], uavs.y[links[2 * i + 1]]]);
    }
    pen.globalAlpha = 1;
  }

  /* The same of a crowd, as pixels. */

  #circles(team, reach) {
    const { stamps, ratio, theme, run } = this;
    const { x, y } = this.scene.uavs;
    const colours = theme.colours.map(opaque);
    for (const u of team) {
      const [px, py] = this.project(x[u], y[u]);
      stamps.circle(px * ratio, py * ratio, reach * ratio, colours[run.colours[u]], 45);
    }
  }

  #servingPixels({ vehicles, uavs }, crowd) {
    const { stamps, theme, run } = this;
    const colours = theme.colours.map(opaque), warn = opaque(theme.warn);
    const scale = this.scale * this.ratio, [left, top] = this.unproject(0, 0);
    for (const k of crowd) {
      const u = vehicles.uav[k];
      if (u < 0 || !(uavs.state[u] & 1)) continue;
      stamps.line((uavs.x[u] - left) * scale, (top - uavs.y[u]) * scale, (vehicles.x[k] - left) * scale,
        (top - vehicles.y[k]) * scale, vehicles.covered[k] ? colours[run.colours[u]] : warn, 77);
    }
  }

  #linkPixels({ links, uavs }) {
    const scale = this.scale * this.ratio, [left, top] = this.unproject(0, 0), ink = opaque(this.theme.ink);
    for (let i = 0; i < links.length; i += 2) {
      const [a, b] = [links[i], links[i + 1]];
      const ends = [(uavs.x[a] - left) * scale, (top - uavs.y[a]) * scale, (uavs.x[b] - left) * scale, (top - uavs.y[b]) * scale];
      this.stamps.line(...ends, ink, 96);
      const flat = Math.abs(ends[2] - ends[0]) > Math.abs(ends[3] - ends[1]); // twice, so that links are not lines of service
      this.stamps.line(...ends.map((value, at) => value + (at % 2 === Number(flat))), ink, 96);
    }
  }

  #vehicles({ vehicles }, crowd, radius, plain) {
    const { theme, run, stamps, scale, ratio } = this;
    const [left, top] = this.unproject(0, 0);
    const unserved = stamps.of(`unserved ${radius} ${plain} ${theme.name}`, radius + 1, (pen) => dot(pen, radius * 0.75, theme.grey, !plain && theme.map));
    const served = theme.colours.map((colour, i) =>
      stamps.of(`vehicle ${i} ${radius} ${plain} ${theme.name}`, radius + 1, (pen) => dot(pen, radius, colour, !plain && theme.map)));
    const halo = stamps.of(`halo ${radius} ${plain} ${theme.name}`, radius + 5, (pen) => {
      pen.arc(0, 0, radius + (plain ? 1.5 : 3), 0, 7);
      Object.assign(pen, { lineWidth: plain ? 1 : 1.8, strokeStyle: css(theme.warn) });
      pen.stroke();
    });
    const put = (stamp, k) => stamps.put(stamp, (vehicles.x[k] - left) * scale * ratio, (top - vehicles.y[k]) * scale * ratio);
    for (const k of crowd) put(vehicles.uav[k] < 0 ? unserved : served[run.colours[vehicles.uav[k]]], k);
    for (const k of crowd) if (vehicles.uav[k] >= 0 && !vehicles.covered[k]) put(halo, k);
  }

  /* Four arms with their rotors, and a body in the UAV's colour where it is at work. */
  #drones(drones, size) {
    const { theme, run, stamps, ratio } = this;
    const { uavs } = this.scene;
    const kind = (colour) => {
      const radius = colour < 0 ? size * 0.7 : size, unit = (3.4 * radius) / 64;
      const [line, body] = colour < 0 ? [theme.grey, theme.map] : [theme.ink, theme.colours[colour]];
      return stamps.of(`uav ${colour} ${size} ${theme.name}`, 2 * radius, (pen) => {
        Object.assign(pen, { lineWidth: 4 * unit, strokeStyle: css(line) });
        for (const [dx, dy] of [[-1, -1], [1, -1], [1, 1], [-1, 1]]) {
          pen.moveTo(0, 0);
          pen.lineTo(19 * unit * dx, 19 * unit * dy);
          pen.moveTo(20 * unit * dx + 8 * unit, 20 * unit * dy);
          pen.arc(20 * unit * dx, 20 * unit * dy, 8 * unit, 0, 7);
        }
        pen.stroke();
        dot(pen, 0.75 * radius, body, line, 1.2);
      });
    };
    for (const u of drones) {
      const [x, y] = this.project(uavs.x[u], uavs.y[u]);
      stamps.put(kind(uavs.state[u] >= 2 ? run.colours[u] : -1), x * ratio, y * ratio);
    }
  }

  #pickedLines({ count, vehicles, uavs }, marked) {
    const rows = [];
    for (const { kind, index } of marked) {
      for (let k = 0; k < count; k++) {
        const u = vehicles.uav[k];
        if (u >= 0 && uavs.state[u] & 1 && index === (kind === "uav" ? u : vehicles.vehicle[k])) rows.push(k);
      }
    }
    Object.assign(this.pen, { lineWidth: 2, strokeStyle: css(this.theme.ink) });
    this.#lines(rows, (k) => [uavs.x[vehicles.uav[k]], uavs.y[vehicles.uav[k]], vehicles.x[k], vehicles.y[k]]);
  }

  #rings(marked) {
    const { pen } = this;
    Object.assign(pen, { lineWidth: 2.4, strokeStyle: css(this.theme.ink) });
    for (const { kind, at } of marked) {
      if (!at) continue;
      pen.beginPath();
      pen.arc(...this.project(...at), kind === "uav" ? 16 : 10, 0, 7);
      pen.stroke();
    }
  }

  /* ---- the picture beneath ---- */

  #ground() {
    this.#renewGround();
    const { pen, view } = this;
    const { canvas, corner, zoom, ratio } = this.ground;
    const larger = 2 ** (view.zoom - zoom) / ratio;
    let [x, y] = this.project(...corner);
    // At its own zoom it lies on whole pixels, and is copied instead of interpolated.
    if (zoom === view.zoom) [x, y] = [Math.round(x * ratio) / ratio, Math.round(y * ratio) / ratio];
    pen.drawImage(canvas, x, y, canvas.width * larger, canvas.height * larger);
  }

  /* The same as pixels; while the map is zoomed, by way of the canvas, which scales it. */
  #layGround() {
    this.#renewGround();
    const { ground, view, ratio, stamps, theme } = this;
    if (ground.zoom !== view.zoom || ground.ratio !== ratio) {
      this.#clear(...this.size);
      this.#ground();
      const { width, height } = this.canvas;
      stamps.lay(pixelsOf(this.pen, width, height), 0, 0, theme.map);
      return;
    }
    ground.picture ??= pixelsOf(context(ground.canvas), ground.canvas.width, ground.canvas.height);
    const [x, y] = this.project(...ground.corner);
    stamps.lay(ground.picture, -Math.round(x * ratio), -Math.round(y * ratio), theme.map);
  }

  #renewGround() {
    const { run, theme, view } = this;
    const [width, height] = this.size;
    const wanted = [...view.target, view.zoom, width, height, theme.name, run.tracksLast ?? 0, run.session].join();
    if (this.ground?.theme !== theme.name || this.ground.run !== run) this.#paintGround(wanted);
    else if (this.ground.key !== wanted) {
      clearTimeout(this.settling);
      this.settling = setTimeout(() => {
        this.#paintGround(wanted);
        this.onView(false);
      }, SETTLED);
    }
  }

  #paintGround(key) {
    clearTimeout(this.settling);
    const [width, height] = this.size;
    const [across, down] = [Math.ceil(width * MARGIN), Math.ceil(height * MARGIN)];
    const [left, top] = this.unproject(-across, -down);
    const ratio = Math.min(devicePixelRatio || 1, 2, 4096 / (width + 2 * across), 4096 / (height + 2 * down));
    const canvas = this.ground?.canvas ?? document.createElement("canvas");
    canvas.width = Math.max(1, Math.round((width + 2 * across) * ratio));
    canvas.height = Math.max(1, Math.round((height + 2 * down) * ratio));
    const scale = this.scale * ratio;
    const px = (x) => (x - left) * scale, py = (y) => (top - y) * scale;
    const pen = context(canvas);
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
    this.ground = { key, canvas, corner: [left, top], zoom: this.view.zoom, ratio, run, theme: theme.name };
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
    const { pen } = this;
    const [width, height] = this.size;
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
        const wide = label(pen, name, x, y, theme.muted, theme);
        const { text, warn } = pixels < 150 ? {} : zoneTexts(zone);
        if (text && right - x > wide + 90) label(pen, text, x + wide + 7, y, warn ? theme.warn : theme.muted, theme, 400);
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

/* Texts are slow to outline: each is drawn once, and copied from then on. */
const labels = new Map();

function label(pen, text, x, y, colour, theme, weight = 600) {
  const ratio = Math.ceil(devicePixelRatio || 1);
  const key = [text, colour, weight, theme.name, ratio, theme.font].join();
  let held = labels.get(key);
  if (!held) {
    if (labels.size > 2000) labels.clear();
    const font = weight + " 11px " + theme.font;
    pen.font = font;
    const width = Math.ceil(pen.measureText(text).width);
    const canvas = Object.assign(document.createElement("canvas"), { width: (width + 2 * EDGE) * ratio, height: 22 * ratio });
    const own = canvas.getContext("2d", { willReadFrequently: true });
    own.scale(ratio, ratio);
    Object.assign(own, { font, lineWidth: 3, lineJoin: "round", textBaseline: "alphabetic", strokeStyle: css(theme.map), fillStyle: css(colour) });
    own.strokeText(text, EDGE, BASE);
    own.fillText(text, EDGE, BASE);
    labels.set(key, (held = { canvas, width, ratio }));
  }
  const left = x - EDGE - (pen.textAlign === "right" ? held.width : 0);
  const above = { top: 4, middle: 11, alphabetic: BASE }[pen.textBaseline];
  pen.drawImage(held.canvas, left, y - above, held.canvas.width / held.ratio, held.canvas.height / held.ratio);
  return held.width;
}
const EDGE = 3, BASE = 14; // pixels around a text, and to its base line

const css = ([red, green, blue]) => `rgb(${red} ${green} ${blue})`;
/* Drawn by the processor: a browser that has its GPU imitated in software takes twenty times as long on "the GPU". */
const context = (canvas) => canvas.getContext("2d", { alpha: false, willReadFrequently: true });

function pixelsOf(pen, width, height) {
  return { pixels: new Int32Array(pen.getImageData(0, 0, width, height).data.buffer), width, height };
}

const quarters = (value) => Math.round(4 * value) / 4;

function dot(pen, radius, fill, line, width = 1) {
  pen.beginPath();
  pen.arc(0, 0, radius, 0, 7);
  pen.fillStyle = css(fill);
  pen.fill();
  if (!line) return;
  Object.assign(pen, { lineWidth: width, strokeStyle: css(line) });
  pen.stroke();
}

function grouped(rows, keyOf) {
  const groups = new Map();
  for (const row of rows) {
    const key = keyOf(row), group = groups.get(key);
    if (group) group.push(row); else groups.set(key, [row]);
  }
  return groups;
}

/* Of one pointer its place, of two the middle of them and how far they are apart. */
function middle(held) {
  const [a, b = a] = held.values();
  return { x: (a[0] + b[0]) / 2, y: (a[1] + b[1]) / 2, spread: Math.hypot(a[0] - b[0], a[1] - b[1]) };
}
