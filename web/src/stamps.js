/* Small pictures, lines and circles, put by the thousand as pixels into one picture of the view. Canvas calls for each of
   10,000 dots and lines would take many times as long where no GPU draws them. */

const PHASES = 4; // places between two pixels, each way, at which a stamp is kept: without them, slow dots would jump
const MOST = 400; // stamps kept

export class Stamps {
  constructor() {
    this.canvas = document.createElement("canvas");
    this.pen = this.canvas.getContext("2d", { willReadFrequently: true });
    this.table = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
    this.kept = new Map();
  }

  /* Sizes are in device pixels, `ratio` of them to a pixel of the page. */
  clear(width, height, ratio) {
    if (ratio !== this.ratio || this.kept.size > MOST) this.kept.clear();
    this.ratio = ratio;
    if (this.image?.width === width && this.image.height === height) {
      this.pixels.fill(0);
      return;
    }
    Object.assign(this.canvas, { width, height });
    this.image = this.pen.createImageData(width, height);
    this.pixels = new Int32Array(this.image.data.buffer);
  }

  /* Begins with a picture beneath: its pixels from [left, top] on, where it reaches; elsewhere the colour. */
  lay({ pixels: below, width: across, height: down }, left, top, colour) {
    const { pixels, image: { width, height } } = this;
    const first = Math.max(0, -left), last = Math.min(width, across - left);
    if (first > 0 || last < width || top < 0 || top + height > down) pixels.fill(opaque(colour));
    if (first >= last) return;
    for (let y = Math.max(0, -top), end = Math.min(height, down - top); y < end; y++) {
      const from = (y + top) * across + left;
      pixels.set(below.subarray(from + first, from + last), y * width + first);
    }
  }

  /* A line of one device pixel over what is opaque; alpha of 128. */
  line(x0, y0, x1, y1, colour, alpha) {
    const { pixels, image: { width, height } } = this;
    const dx = x1 - x0, dy = y1 - y0;
    let from = 0, to = 1;
    for (const [p, q] of [[-dx, x0], [dx, width - 1 - x0], [-dy, y0], [dy, height - 1 - y0]]) {
      if (p === 0 ? q < 0 : false) return;
      if (p < 0) from = Math.max(from, q / p);
      else if (p > 0) to = Math.min(to, q / p);
    }
    if (from > to) return;
    const steps = Math.ceil(Math.max(Math.abs(dx), Math.abs(dy)) * (to - from)) || 1;
    const across = (dx * (to - from)) / steps, along = (dy * (to - from)) / steps;
    let x = x0 + from * dx, y = y0 + from * dy;
    const red = colour & 0xff00ff, green = colour & 0xff00;
    for (let i = 0; i <= steps; i++, x += across, y += along) {
      const at = (y + 0.5 | 0) * width + (x + 0.5 | 0);
      pixels[at] = mixed(pixels[at], red, green, alpha);
    }
  }

  circle(x, y, radius, colour, alpha) {
    const { pixels, image: { width, height } } = this;
    const red = colour & 0xff00ff, green = colour & 0xff00;
    const [cx, cy] = [Math.round(x), Math.round(y)];
    const dot = (px, py) => {
      if (px < 0 || py < 0 || px >= width || py >= height) return;
      const at = py * width + px;
      pixels[at] = mixed(pixels[at], red, green, alpha);
    };
    let b = Math.round(radius);
    for (let a = 0, error = 1 - b; a <= b; a++) {
      dot(cx + a, cy + b); dot(cx - a, cy - b);
      dot(cx + b, cy - a); dot(cx - b, cy + a);
      if (a && a !== b) {
        dot(cx - a, cy + b); dot(cx + a, cy - b);
        dot(cx + b, cy + a); dot(cx - b, cy - a);
      }
      error += error < 0 ? 2 * a + 3 : 2 * (a - b--) + 5;
    }
  }

  /* The stamp of that name; `paint` draws it around [0, 0], up to `reach` pixels of the page from there. */
  of(name, reach, paint) {
    let stamp = this.kept.get(name);
    if (!stamp) this.kept.set(name, (stamp = { half: Math.ceil(reach * this.ratio) + 1, paint, phases: [] }));
    return stamp;
  }

  put(stamp, x, y) {
    const left = Math.floor(x), top = Math.floor(y);
    const phase = Math.floor((y - top) * PHASES) * PHASES + Math.floor((x - left) * PHASES);
    const from = (stamp.phases[phase] ??= this.#painted(stamp, phase)), { half } = stamp;
    const { pixels, image: { width, height } } = this;
    const side = 2 * half + 1, x0 = left - half, y0 = top - half;
    const first = Math.max(0, -x0), last = Math.min(side, width - x0), low = Math.min(side, height - y0);
    for (let row = Math.max(0, -y0); row < low; row++) {
      for (let column = first, at = (y0 + row) * width + x0 + first; column < last; column++, at++) {
        const value = from[row * side + column], alpha = value >>> 24;
        if (!alpha) continue;
        const below = pixels[at];
        pixels[at] = alpha === 255 || !below ? value
          : below >>> 24 === 255 ? mixed(below, value & 0xff00ff, value & 0xff00, alpha >>> 1) : over(value, below);
      }
    }
  }

  #painted({ half, paint }, phase) {
    const side = 2 * half + 1, { table } = this;
    Object.assign(table.canvas, { width: side, height: side });
    const between = (part) => half + (part + 0.5) / PHASES;
    table.translate(between(phase % PHASES), between(Math.floor(phase / PHASES)));
    table.scale(this.ratio, this.ratio);
    table.beginPath();
    paint(table);
    return new Int32Array(table.getImageData(0, 0, side, side).data.buffer);
  }

  /* Puts the whole picture, where all of it is opaque. */
  onto(pen) {
    pen.putImageData(this.image, 0, 0);
  }

  picture() {
    this.pen.putImageData(this.image, 0, 0);
    return this.canvas;
  }
}

export const opaque = ([red, green, blue]) => (255 << 24) | (blue << 16) | (green << 8) | red;

/* A colour, red and blue apart from green, over an opaque pixel; alpha of 128, so that all stays within 32 bits. */
function mixed(below, red, green, alpha) {
  const rest = 128 - alpha;
  return (255 << 24) | ((Math.imul(below & 0xff00ff, rest) + Math.imul(red, alpha)) >>> 7 & 0xff00ff) |
    ((Math.imul(below & 0xff00, rest) + Math.imul(green, alpha)) >>> 7 & 0xff00);
}

/* One pixel over another: alpha in the top byte, colours not multiplied by it. */
function over(above, below) {
  const a = above >>> 24, b = ((below >>> 24) * (255 - a)) / 255, alpha = a + b;
  const part = (shift) => (((above >>> shift) & 255) * a + ((below >>> shift) & 255) * b) / alpha;
  return (Math.round(alpha) << 24) | (part(16) << 16) | (part(8) << 8) | part(0);
}
