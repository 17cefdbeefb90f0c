"use strict";
// The film of the particles: unpacked once, then drawn into the pixels of a canvas, near particles over far ones.

const bytesOf = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));

async function unpack(movie) {
  const packed = new Blob([bytesOf(movie.film)]).stream();
  const film = new Uint8Array(await new Response(packed.pipeThrough(new DecompressionStream("deflate"))).arrayBuffer());
  const { slots, dimension } = movie, frames = [];
  let at = 0, before = null;
  for (let k = 0; k < movie.times.length; k++) {
    const places = [];
    for (let d = 0; d < dimension; d++) {
      const now = new Uint16Array(slots);
      for (let a = 0; a < slots; a++) now[a] = (before ? before[d][a] : 0) + film[at + a] + 256 * film[at + slots + a];
      places.push(now);
      at += 2 * slots;
    }
    const colors = [film.subarray(at, at + slots), film.subarray(at + slots, at + 2 * slots)];
    at += 2 * slots;
    frames.push({ places, colors });
    before = places;
  }
  return frames;
}

class Player {
  constructor(movie, frames, canvas) {
    Object.assign(this, { movie, frames, canvas, index: 0, color: 0, yaw: -0.5, pitch: 0.3 });
    this.palettes = movie.colors.map((c) => {
      const rgb = bytesOf(c.palette);
      return Uint32Array.from({ length: 256 }, (_, k) =>
        (255 << 24 | rgb[3 * k + 2] << 16 | rgb[3 * k + 1] << 8 | rgb[3 * k]) >>> 0);
    });
    this.bounds();
  }

  // What is shown: the tank, whose spray may fly far above it; without one, as far as particles get.
  bounds() {
    const { movie, frames } = this, { dimension, slots, origin, unit } = movie;
    this.low = []; this.high = [];
    for (let d = 0; d < dimension; d++) {
      let low = 65535, high = 0;
      for (const frame of frames) {
        for (let a = 0; a < slots; a++) {
          if (frame.places[0][a] === 65535) continue;
          const x = frame.places[d][a];
          if (x < low) low = x;
          if (x > high) high = x;
        }
      }
      const tank = movie.tank;
      this.low[d] = tank ? tank[0][d] - movie.diameter : origin[d] + unit * low;
      this.high[d] = tank ? tank[1][d] + movie.diameter : origin[d] + unit * high;
    }
    this.middle = this.low.map((low, d) => 0.5 * (low + this.high[d]));
    this.size = Math.hypot(...this.low.map((low, d) => this.high[d] - low));
  }

  resize() {
    const dots = Math.min(2, window.devicePixelRatio || 1), width = this.canvas.clientWidth || 300;
    const flat = this.movie.dimension === 2;
    const ratio = flat ? (this.high[1] - this.low[1] + this.movie.diameter) / (this.high[0] - this.low[0] + this.movie.diameter) : 0.62;
    const height = Math.min(width * ratio, Math.max(300, 0.7 * window.innerHeight));
    this.canvas.style.height = height + "px";
    this.canvas.width = Math.round(width * dots);
    this.canvas.height = Math.round(height * dots);
    const margin = 1.5 * this.movie.diameter;
    this.scale = flat
      ? Math.min(this.canvas.width / (this.high[0] - this.low[0] + margin), this.canvas.height / (this.high[1] - this.low[1] + margin))
      : 1.02 * Math.min(this.canvas.width / this.size, 1.5 * this.canvas.height / this.size);
    this.draw();
  }

  // Rows of the view: right, up, towards the eye.
  view() {
    if (this.movie.dimension === 2) return [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
    const [c, s, cp, sp] = [Math.cos(this.yaw), Math.sin(this.yaw), Math.cos(this.pitch), Math.sin(this.pitch)];
    return [[c, s, 0], [-s * sp, c * sp, cp], [s * cp, -c * cp, sp]];
  }

  draw() {
    const { movie, canvas } = this, { width, height } = canvas, context = canvas.getContext("2d");
    const image = context.createImageData(width, height);
    const pixels = new Uint32Array(image.data.buffer), depth = new Float32Array(width * height).fill(-Infinity);
    const { places, colors } = this.frames[this.index], rows = this.view();
    const palette = this.palettes[this.color], values = colors[this.color];
    const wall = matchMedia("(prefers-color-scheme: dark)").matches ? 0xff7a7168 : 0xffa5a5a5;
    const radius = Math.max(1, 0.55 * movie.diameter * this.scale);
    const flat = movie.dimension === 2;
    for (let a = 0; a < movie.slots; a++) {
      if (places[0][a] === 65535) continue;
      const r = [0, 1, 2].map((d) => d < movie.dimension ? movie.origin[d] + movie.unit * places[d][a] - this.middle[d] : 0);
      const [x, y, z] = rows.map((row) => row[0] * r[0] + row[1] * r[1] + row[2] * r[2]);
      const color = a < movie.fluid ? palette[values[a]] : wall;
      this.disc(pixels, depth, 0.5 * width + this.scale * x, 0.5 * height - this.scale * y, radius, z * this.scale, color, flat);
    }
    context.putImageData(image, 0, 0);
    if (!flat && movie.tank) this.glass(context, rows);
  }

  // A disc; in space with the depth and a darker rim of a ball.
  disc(pixels, depth, cx, cy, radius, z, color, flat) {
    const { width, height } = this.canvas, rr = radius * radius;
    const dark = (255 << 24 | (color >> 16 & 255) * 0.72 << 16 | (color >> 8 & 255) * 0.72 << 8 | (color & 255) * 0.72) >>> 0;
    for (let y = Math.max(0, Math.ceil(cy - radius)); y <= Math.min(height - 1, cy + radius); y++) {
      for (let x = Math.max(0, Math.ceil(cx - radius)); x <= Math.min(width - 1, cx + radius); x++) {
        const off = (x - cx) ** 2 + (y - cy) ** 2;
        if (off > rr) continue;
        const k = y * width + x, near = flat ? -off : z + Math.sqrt(rr - off);
        if (near < depth[k]) continue;
        depth[k] = near;
        pixels[k] = !flat && off > 0.6 * rr ? dark : color;
      }
    }
  }

  glass(context, rows) {
    const dot = (corner) => {
      const r = corner.map((side, d) => this.movie.tank[side][d] - this.middle[d]);
      const [x, y] = rows.map((row) => row[0] * r[0] + row[1] * r[1] + row[2] * r[2]);
      return [0.5 * this.canvas.width + this.scale * x, 0.5 * this.canvas.height - this.scale * y];
    };
    context.strokeStyle = "#8896a4aa";
    context.lineWidth = 1.5;
    for (let k = 0; k < 8; k++) {
      const corner = [k & 1, k >> 1 & 1, k >> 2 & 1];
      corner.forEach((side, d) => {
        if (side) return;
        const other = corner.slice();
        other[d] = 1;
        context.beginPath();
        context.moveTo(...dot(corner));
        context.lineTo(...dot(other));
        context.stroke();
      });
    }
  }
}
