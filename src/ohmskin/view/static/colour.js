// Colours for signed values: zero is the quietest colour, lightness leads away from it in equal steps (OKLab), hue
// tells the sign. One table for dark pages, where zero is near black, and one for light pages, where it is near white.

const STEPS = 256; // per sign

// Each stop: OKLCH lightness, chroma, hue (degrees), at equal distances from zero to full scale.
const STOPS = {
  dark: {
    positive: [
      [0.19, 0.015, 285],
      [0.35, 0.12, 305],
      [0.51, 0.19, 350],
      [0.66, 0.19, 388],
      [0.81, 0.15, 427],
      [0.96, 0.09, 462],
    ],
    negative: [
      [0.19, 0.015, 285],
      [0.35, 0.08, 262],
      [0.51, 0.12, 245],
      [0.66, 0.115, 225],
      [0.81, 0.09, 205],
      [0.96, 0.04, 190],
    ],
  },
  light: {
    positive: [
      [0.975, 0.006, 95],
      [0.85, 0.11, 82],
      [0.72, 0.17, 56],
      [0.59, 0.2, 32],
      [0.46, 0.17, 8],
      [0.33, 0.13, -20],
    ],
    negative: [
      [0.975, 0.006, 95],
      [0.85, 0.055, 200],
      [0.72, 0.1, 222],
      [0.59, 0.13, 243],
      [0.46, 0.14, 262],
      [0.33, 0.12, 275],
    ],
  },
};

function linearRgb(lightness, chroma, hue) {
  const a = chroma * Math.cos((hue * Math.PI) / 180);
  const b = chroma * Math.sin((hue * Math.PI) / 180);
  const l = (lightness + 0.3963377774 * a + 0.2158037573 * b) ** 3;
  const m = (lightness - 0.1055613458 * a - 0.0638541728 * b) ** 3;
  const s = (lightness - 0.0894841775 * a - 1.291485548 * b) ** 3;
  return [
    4.0767416621 * l - 3.3077115913 * m + 0.2309699292 * s,
    -1.2684380046 * l + 2.6097574011 * m - 0.3413193965 * s,
    -0.0041960863 * l - 0.7034186147 * m + 1.707614701 * s,
  ];
}

function srgb(lightness, chroma, hue) {
  // Chroma gives way where the screen cannot show it; lightness, which carries the value, never does.
  let rgb = linearRgb(lightness, chroma, hue);
  while (chroma > 0.002 && rgb.some((v) => v < -0.001 || v > 1.001)) {
    chroma *= 0.95;
    rgb = linearRgb(lightness, chroma, hue);
  }
  return rgb.map((v) => {
    const c = Math.min(1, Math.max(0, v));
    return Math.round(255 * (c <= 0.0031308 ? 12.92 * c : 1.055 * c ** (1 / 2.4) - 0.055));
  });
}

function branch(stops) {
  const table = [];
  for (let i = 0; i < STEPS; i++) {
    const at = (i / (STEPS - 1)) * (stops.length - 1);
    const k = Math.min(stops.length - 2, Math.floor(at));
    table.push(srgb(...stops[k].map((v, j) => v + (at - k) * (stops[k + 1][j] - v))));
  }
  return table;
}

// Pixels as little-endian RGBA words from -full scale to +full scale.
function table(theme) {
  const rgb = [...branch(STOPS[theme].negative).reverse(), ...branch(STOPS[theme].positive)];
  return Uint32Array.from(rgb, ([r, g, b]) => ((255 << 24) | (b << 16) | (g << 8) | r) >>> 0);
}

const TABLES = { dark: table("dark"), light: table("light") };

// What is below the threshold may be noise: none below half of it has colour, all above one and a half.
function wordOf(value, colours, limit, threshold) {
  const size = Math.abs(value);
  const t = threshold > 0 ? Math.min(1, Math.max(0, size / threshold - 0.5)) : 1;
  const step = Math.min(STEPS - 1, Math.round((size / limit) * t * t * (3 - 2 * t) * (STEPS - 1))) || 0;
  return value < 0 ? colours[STEPS - 1 - step] : colours[STEPS + step];
}

/** Colour words for values; `limit` is full scale, `threshold` is what noise stays below. */
export function paint(values, order, words, theme, limit, threshold) {
  const colours = TABLES[theme];
  for (let i = 0; i < words.length; i++) words[i] = wordOf(values[order[i]], colours, limit, threshold);
}

/** CSS colour of one value. */
export function colourOf(value, theme, limit, threshold) {
  const word = wordOf(value, TABLES[theme], limit, threshold);
  return `rgb(${word & 255} ${(word >> 8) & 255} ${(word >> 16) & 255})`;
}

const NICE = [1, 1.5, 2, 3, 5, 7, 10];

function niceAbove(value) {
  const decade = 10 ** Math.floor(Math.log10(value));
  return decade * (NICE.find((n) => n * decade >= value * 0.9999) ?? 10);
}

const BELOW = [0.2, 0.5, 1]; // how far the scale may reach below zero, in full scales

/** Full scale that follows the data: up at once, down only after a quiet while, always a round number. */
export class Range {
  constructor() {
    this.auto = true;
    this.limit = 1;
    this._below = BELOW[0];
    this._threshold = 0;
    this._quietSince = 0;
    this._otherwiseSince = null; // since when the data have spoken for another `_below`
    this._fresh = true;
  }

  /** Lower end of the shown scale; it always contains zero, some of the other sign, and what may be noise. */
  get low() {
    return -Math.max(this._below * this.limit, this._threshold);
  }

  follow(low, high, threshold, now) {
    this._threshold = threshold;
    this._followLimit(low, high, threshold, now);
    const below = BELOW.find((share) => -low <= share * this.limit) ?? 1;
    if (below === this._below) this._otherwiseSince = null;
    else this._otherwiseSince ??= now;
    // An image undershoots for a moment when a press begins or ends; that is no reason to change the scale.
    const patience = below > this._below ? 700 : 6000;
    if (this._fresh || (this._otherwiseSince !== null && now - this._otherwiseSince > patience)) this._below = below;
    this._fresh = false;
  }

  /** Twice the threshold at least, so that a quiet skin is shown quiet. */
  _followLimit(low, high, threshold, now) {
    if (!this.auto) return;
    const largest = Math.max(Math.abs(low), Math.abs(high), 2 * threshold);
    if (!(largest > 0)) return;
    const wanted = niceAbove(largest);
    if (wanted > this.limit || this._fresh) [this.limit, this._quietSince] = [wanted, now];
    else if (largest > 0.55 * this.limit) this._quietSince = now;
    else if (now - this._quietSince > 4000) [this.limit, this._quietSince] = [wanted, now];
  }

  restart() {
    this._fresh = true;
  }
}

/** Round tick values from low to high, at most `count` or so. */
export function ticks(low, high, count) {
  const raw = (high - low) / count;
  const decade = 10 ** Math.floor(Math.log10(raw));
  const step = decade * [1, 2, 5, 10].find((n) => n * decade >= raw * 0.999);
  const values = [];
  for (let k = Math.ceil(low / step - 1e-6); k * step <= high + 1e-6 * step; k++) values.push(k * step);
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  return { values, text: values.map((v) => number(v, digits)) };
}

/** A number with a fixed count of decimals and a true minus sign. */
export function number(value, digits) {
  const text = value.toFixed(digits);
  return text.startsWith("-") ? (Number(text) === 0 ? text.slice(1) : `−${text.slice(1)}`) : text;
}
