/* Small pictures, put by the thousand as pixels into one picture of the view. Canvas calls for each of 10,000 dots would
   take many times as long where no GPU draws them. */

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
    this.pixels = new Uint32Array(this.image.data.buffer);
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
        if (alpha) pixels[at] = alpha === 255 || !pixels[at] ? value : over(value, pixels[at]);
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
    return new Uint32Array(table.getImageData(0, 0, side, side).data.buffer);
  }

  picture() {
    this.pen.putImageData(this.image, 0, 0);
    return this.canvas;
  }
}

/* One pixel over another: alpha in the top byte, colours not multiplied by it. */
function over(above, below) {
  const a = above >>> 24, b = ((below >>> 24) * (255 - a)) / 255, alpha = a + b;
  const mixed = (shift) => (((above >>> shift) & 255) * a + ((below >>> shift) & 255) * b) / alpha;
  return ((Math.round(alpha) << 24) | (mixed(16) << 16) | (mixed(8) << 8) | mixed(0)) >>> 0;
}
