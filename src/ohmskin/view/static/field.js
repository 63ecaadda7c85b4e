// One image on its raster: values at points, and a small bitmap that the maps enlarge.

import { paint } from "./colour.js";

export class Field {
  constructor(raster) {
    this.raster = raster;
    this.values = null;
    this._bitmap = document.createElement("canvas");
    this._bitmap.width = raster.nx;
    this._bitmap.height = raster.ny;
    this._context = this._bitmap.getContext("2d");
    this._pixels = this._context.createImageData(raster.nx, raster.ny);
    this._words = new Uint32Array(this._pixels.data.buffer);
    this._order = null;
    this._outside = "";
  }

  set(values) {
    this.values = values;
  }

  /** The painted bitmap, top row first; see `paint`. */
  bitmap(theme, limit, threshold) {
    paint(this.values, this._sources(), this._words, theme, limit, threshold);
    this._context.putImageData(this._pixels, 0, 0);
    return this._bitmap;
  }

  /** Least and largest value on the skin. */
  extremes() {
    let low = Infinity;
    let high = -Infinity;
    for (const v of this.values) {
      if (v < low) low = v;
      if (v > high) high = v;
    }
    return low <= high ? [low, high] : [0, 0];
  }

  /** Whether another field of the same raster has the same values. */
  equals(other) {
    return this.values.every((v, i) => Object.is(v, other.values[i]));
  }

  /** Value between pixel centres, NaN off the skin. */
  at(x, y) {
    const { x0, y0, pitch, nx, ny } = this.raster;
    const u = (x - x0) / pitch;
    const v = (y - y0) / pitch;
    if (u < -0.5 || v < -0.5 || u > nx - 0.5 || v > ny - 0.5) return NaN;
    const i = Math.max(0, Math.min(nx - 2, Math.floor(u)));
    const j = Math.max(0, Math.min(ny - 2, Math.floor(v)));
    const s = Math.max(0, Math.min(1, u - i));
    const t = Math.max(0, Math.min(1, v - j));
    let sum = 0;
    let weight = 0;
    for (const [column, row, w] of [
      [i, j, (1 - s) * (1 - t)],
      [i + 1, j, s * (1 - t)],
      [i, j + 1, (1 - s) * t],
      [i + 1, j + 1, s * t],
    ]) {
      const value = this.values[row * nx + column];
      if (column < nx && row < ny && !Number.isNaN(value)) {
        sum += w * value;
        weight += w;
      }
    }
    return weight > 0.25 ? sum / weight : NaN;
  }

  // For each pixel of the bitmap, which value it shows: its own, or off the skin the nearest on it, so that smoothing
  // has something to blend with up to the rim. The map cuts the rest off.
  _sources() {
    const { nx, ny } = this.raster;
    let outside = 0;
    for (const v of this.values) if (Number.isNaN(v)) outside++;
    if (this._order && this._outside === outside) return this._order;
    const source = Int32Array.from(this.values, (v, i) => (Number.isNaN(v) ? -1 : i));
    let edge = [...source].filter((i) => i >= 0);
    while (edge.length) {
      const next = [];
      for (const i of edge) {
        const x = i % nx;
        for (const [ok, j] of [
          [x > 0, i - 1],
          [x < nx - 1, i + 1],
          [i >= nx, i - nx],
          [i < nx * (ny - 1), i + nx],
        ]) {
          if (ok && source[j] < 0) {
            source[j] = source[i];
            next.push(j);
          }
        }
      }
      edge = next;
    }
    this._order = new Int32Array(nx * ny);
    for (let row = 0; row < ny; row++) {
      for (let column = 0; column < nx; column++) {
        this._order[(ny - 1 - row) * nx + column] = Math.max(0, source[row * nx + column]);
      }
    }
    this._outside = outside;
    return this._order;
  }
}
