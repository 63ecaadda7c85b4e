// A map of the skin: the image, and on it electrodes, driven pairs, presses and contacts. y points up.

import { colourOf, number, ticks } from "./colour.js";

const MARGIN = 30; // px around the skin, room for electrode numbers
const FOOT = 16; // px more below, room for the scale bar

export const INK = {
  dark: {
    paper: "#0e1116", text: "#e9edf3", quiet: "#9aa5b5", rim: "#55606f", halo: "rgb(6 8 12 / .85)", pill: "rgb(14 17 22 / .8)",
    pair: "rgb(110 231 214 / .5)", contact: "#ffffff", press: "#6fd3ff", other: "#c6b4ff", electrode: "#dbe3ee", hair: "rgb(255 255 255 / .16)",
    felt: "#ffa25c", base: "#7f9bc4", threshold: "#9aa5b5", grid: "#242b36", accent: "#6fd3ff",
  },
  light: {
    paper: "#ffffff", text: "#151a21", quiet: "#586474", rim: "#8c97a6", halo: "rgb(255 255 255 / .9)", pill: "rgb(255 255 255 / .86)",
    pair: "rgb(0 116 122 / .45)", contact: "#10151c", press: "#0057c2", other: "#6a35c9", electrode: "#2b3441", hair: "rgb(0 0 0 / .15)",
    felt: "#c2410c", base: "#5876a6", threshold: "#586474", grid: "#e6eaef", accent: "#0057c2",
  },
};

export const FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif';

/** Smallest box around a domain, [x_min, y_min, x_max, y_max] in metres. */
export function bounds(domain) {
  return domain.kind === "disc"
    ? [-domain.radius, -domain.radius, domain.radius, domain.radius]
    : [0, 0, domain.width, domain.height];
}

/** The point of the domain closest to (x, y). */
export function clampTo(domain, x, y) {
  if (domain.kind === "disc") {
    const shrink = Math.min(1, domain.radius / Math.max(1e-12, Math.hypot(x, y)));
    return [x * shrink, y * shrink];
  }
  return [Math.min(domain.width, Math.max(0, x)), Math.min(domain.height, Math.max(0, y))];
}

export function contains(domain, x, y) {
  const [u, v] = clampTo(domain, x, y);
  return Math.hypot(u - x, v - y) < 1e-9;
}

/** Metres to pixels of a canvas of this size, and back. */
export class Frame {
  constructor(domain, width, height) {
    const [left, bottom, right, top] = bounds(domain);
    this.scale = Math.max(1, Math.min((width - 2 * MARGIN) / (right - left), (height - 2 * MARGIN - FOOT) / (top - bottom)));
    this._x = width / 2 - (this.scale * (left + right)) / 2;
    this._y = (height - FOOT) / 2 + (this.scale * (bottom + top)) / 2;
  }

  x(metres) {
    return this._x + this.scale * metres;
  }

  y(metres) {
    return this._y - this.scale * metres;
  }

  back(x, y) {
    return [(x - this._x) / this.scale, (this._y - y) / this.scale];
  }
}

/** Height of a map that is `width` pixels wide. */
export function heightFor(domain, width) {
  const [left, bottom, right, top] = bounds(domain);
  return Math.round(((width - 2 * MARGIN) * (top - bottom)) / (right - left) + 2 * MARGIN + FOOT);
}

/**
 * Draw one map.
 * scene: { skin, field (or null), theme, limit, pairs, contacts, presses, section, cursor }
 */
export function drawMap(c, width, height, scene) {
  const ink = INK[scene.theme];
  const f = new Frame(scene.skin.domain, width, height);
  c.clearRect(0, 0, width, height);
  c.font = `11px ${FONT}`;
  c.save();
  outline(c, f, scene.skin.domain);
  c.clip();
  if (scene.field?.values) drawImage(c, f, scene);
  if (scene.section) drawHairs(c, f, scene, ink);
  c.restore();
  outline(c, f, scene.skin.domain);
  c.strokeStyle = ink.rim;
  c.lineWidth = 1;
  c.stroke();
  drawPairs(c, f, scene, ink);
  drawElectrodes(c, f, scene, ink);
  drawScaleBar(c, f, height, scene, ink);
  for (const press of scene.presses) drawPress(c, f, press, ink);
  drawContacts(c, f, width, height - FOOT, scene, ink);
  if (scene.cursor) drawCursor(c, f, scene.cursor, ink);
}

function outline(c, f, domain) {
  c.beginPath();
  if (domain.kind === "disc") c.arc(f.x(0), f.y(0), f.scale * domain.radius, 0, 2 * Math.PI);
  else c.rect(f.x(0), f.y(domain.height), f.scale * domain.width, f.scale * domain.height);
}

function drawImage(c, f, scene) {
  const { x0, y0, pitch, nx, ny } = scene.field.raster;
  c.fillStyle = colourOf(0, scene.theme, 1);
  c.fill();
  c.imageSmoothingEnabled = true;
  c.imageSmoothingQuality = "high";
  c.drawImage(
    scene.field.bitmap(scene.theme, scene.limit),
    f.x(x0 - pitch / 2), f.y(y0 + (ny - 0.5) * pitch), nx * pitch * f.scale, ny * pitch * f.scale,
  );
}

function drawHairs(c, f, scene, ink) {
  const [left, bottom, right, top] = bounds(scene.skin.domain);
  const [x, y] = scene.section;
  c.strokeStyle = ink.hair;
  c.lineWidth = 1;
  c.beginPath();
  c.moveTo(f.x(left), f.y(y));
  c.lineTo(f.x(right), f.y(y));
  c.moveTo(f.x(x), f.y(bottom));
  c.lineTo(f.x(x), f.y(top));
  c.stroke();
}

function drawPairs(c, f, scene, ink) {
  const at = scene.skin.electrodes;
  c.strokeStyle = ink.pair;
  c.lineWidth = 1.2;
  c.beginPath();
  for (const [a, b] of scene.pairs) {
    if (!at[a] || !at[b]) continue;
    c.moveTo(f.x(at[a].x), f.y(at[a].y));
    c.lineTo(f.x(at[b].x), f.y(at[b].y));
  }
  c.stroke();
}

function drawElectrodes(c, f, scene, ink) {
  const [left, bottom, right, top] = bounds(scene.skin.domain);
  const middle = [(left + right) / 2, (bottom + top) / 2];
  c.textAlign = "center";
  c.textBaseline = "middle";
  scene.skin.electrodes.forEach((electrode, number) => {
    const x = f.x(electrode.x);
    const y = f.y(electrode.y);
    c.beginPath();
    c.arc(x, y, 3.4, 0, 2 * Math.PI);
    c.fillStyle = ink.electrode;
    c.fill();
    c.lineWidth = 1.4;
    c.strokeStyle = ink.halo;
    c.stroke();
    const [dx, dy] = labelSide(scene.skin.domain, electrode, middle);
    c.lineWidth = 3;
    c.strokeText(number, x + 14 * dx, y - 14 * dy);
    c.fillStyle = ink.quiet;
    c.fillText(number, x + 14 * dx, y - 14 * dy);
  });
}

// Numbers stand outside the skin where there is an outside next to them, else up and right of the electrode.
function labelSide(domain, electrode, middle) {
  const away = [electrode.x - middle[0], electrode.y - middle[1]];
  if (domain.kind === "disc") {
    const length = Math.hypot(...away);
    return length > 0.8 * domain.radius ? [away[0] / length, away[1] / length] : [0.7, 0.7];
  }
  const side = (v, size) => (Math.abs(v) > 0.4 * size ? Math.sign(v) : 0);
  const [dx, dy] = [side(away[0], domain.width), side(away[1], domain.height)];
  if (!dx && !dy) return [0.7, 0.7];
  return dx && dy ? [0.85 * dx, 0.85 * dy] : [dx, dy];
}

function drawScaleBar(c, f, height, scene, ink) {
  const [left, bottom, right] = bounds(scene.skin.domain);
  const length = ticks(0, right - left, 4).values[1];
  const x = f.x(left);
  const y = Math.min(height - 8, f.y(bottom) + 33);
  c.strokeStyle = c.fillStyle = ink.quiet;
  c.lineWidth = 1.5;
  c.beginPath();
  c.moveTo(x, y - 3);
  c.lineTo(x, y);
  c.lineTo(x + length * f.scale, y);
  c.lineTo(x + length * f.scale, y - 3);
  c.stroke();
  c.textAlign = "left";
  c.fillText(`${number(1000 * length, 0)} mm`, x + length * f.scale + 7, y - 2);
}

function drawPress(c, f, press, ink) {
  c.save();
  c.beginPath();
  c.arc(f.x(press.x), f.y(press.y), Math.max(4, f.scale * press.radius), 0, 2 * Math.PI);
  c.lineWidth = 4;
  c.strokeStyle = ink.halo;
  c.stroke();
  c.setLineDash([5, 4]);
  c.lineWidth = 2;
  c.strokeStyle = press.own ? ink.press : ink.other;
  c.stroke();
  if (press.held) {
    c.beginPath();
    c.arc(f.x(press.x), f.y(press.y), 2.5, 0, 2 * Math.PI);
    c.fillStyle = ink.press;
    c.fill();
  }
  c.restore();
}

function drawContacts(c, f, width, height, scene, ink) {
  const taken = [];
  c.textBaseline = "alphabetic";
  c.textAlign = "left";
  for (const contact of scene.contacts) {
    const radius = f.scale * Math.sqrt(contact.extent / Math.PI);
    c.beginPath();
    c.arc(f.x(contact.x), f.y(contact.y), radius, 0, 2 * Math.PI);
    c.lineWidth = 4;
    c.strokeStyle = ink.halo;
    c.stroke();
    c.lineWidth = 2;
    c.strokeStyle = ink.contact;
    c.stroke();
    if (contact.covariance) drawUncertainty(c, f, contact, ink);
    taken.push([f.x(contact.x) - radius, f.y(contact.y) - radius, 2 * radius, 2 * radius]);
  }
  scene.contacts.forEach((contact, i) => drawLabel(c, contact, taken[i], taken, width, height, ink));
}

// The ellipse that holds the true place 95 times in 100; with a cross, so that a very sure one is seen too.
function drawUncertainty(c, f, contact, ink) {
  const { major, minor, angle } = ellipse(contact.covariance);
  const [x, y] = [f.x(contact.x), f.y(contact.y)];
  c.beginPath();
  c.ellipse(x, y, Math.max(1, f.scale * major), Math.max(1, f.scale * minor), -angle, 0, 2 * Math.PI);
  for (const [dx, dy] of [[4, 0], [0, 4]]) {
    c.moveTo(x - dx, y - dy);
    c.lineTo(x + dx, y + dy);
  }
  for (const [colour, weight] of [[ink.halo, 3.5], [ink.accent, 1.6]]) {
    c.lineWidth = weight;
    c.strokeStyle = colour;
    c.stroke();
  }
}

/** Half axes (m) and direction (rad) of the 95 % ellipse of a covariance [xx, xy, yy] (m2). */
export function ellipse([xx, xy, yy]) {
  const middle = (xx + yy) / 2;
  const spread = Math.hypot((xx - yy) / 2, xy);
  const axis = (variance) => 2.4477 * Math.sqrt(Math.max(0, variance));
  return { major: axis(middle + spread), minor: axis(middle - spread), angle: Math.atan2(2 * xy, xx - yy) / 2 };
}

function drawLabel(c, contact, [x, y, size], taken, width, height, ink) {
  const id = `#${contact.id}`;
  const sure = contact.covariance ? ` ±${number(1000 * ellipse(contact.covariance).major, 1)}` : "";
  const where = `${number(1000 * contact.x, 0)}, ${number(1000 * contact.y, 0)}${sure} mm`;
  const strength = `${number(1e4 * contact.strength, 2)} cm²`;
  c.font = `600 11px ${FONT}`;
  const lead = c.measureText(id).width + 6;
  c.font = `11px ${FONT}`;
  const w = lead + Math.max(c.measureText(where).width, c.measureText(strength).width) + 12;
  const h = 34;
  const middle = y + size / 2 - h / 2;
  const centre = x + size / 2 - w / 2;
  const places = [[x + size + 6, middle], [x - w - 6, middle], [centre, y - h - 6], [centre, y + size + 6]];
  const cost = ([px, py]) => {
    const off = Math.max(0, 2 - px) + Math.max(0, px + w + 2 - width) + Math.max(0, 2 - py) + Math.max(0, py + h + 2 - height);
    return 50 * off + taken.reduce((sum, other) => sum + overlap([px, py, w, h], other), 0);
  };
  const [px, py] = places.reduce((best, place) => (cost(place) < cost(best) ? place : best));
  taken.push([px, py, w, h]);
  c.fillStyle = ink.pill;
  c.beginPath();
  c.roundRect(px, py, w, h, 5);
  c.fill();
  c.fillStyle = ink.text;
  c.font = `600 11px ${FONT}`;
  c.fillText(id, px + 6, py + 14);
  c.font = `11px ${FONT}`;
  c.fillText(where, px + 6 + lead, py + 14);
  c.fillStyle = ink.quiet;
  c.fillText(strength, px + 6 + lead, py + 28);
}

function overlap([ax, ay, aw, ah], [bx, by, bw, bh]) {
  const w = Math.min(ax + aw, bx + bw) - Math.max(ax, bx);
  const h = Math.min(ay + ah, by + bh) - Math.max(ay, by);
  return w > 0 && h > 0 ? w * h : 0;
}

function drawCursor(c, f, [x, y], ink) {
  for (const [colour, weight] of [[ink.halo, 4], [ink.press, 1.6]]) {
    c.strokeStyle = colour;
    c.lineWidth = weight;
    c.beginPath();
    for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
      c.moveTo(f.x(x) + 4 * dx, f.y(y) + 4 * dy);
      c.lineTo(f.x(x) + 12 * dx, f.y(y) + 12 * dy);
    }
    c.stroke();
  }
}

/** The colour bar with its ticks, unit and threshold; vertical. */
export function drawScale(c, width, height, { theme, range, unit, threshold }) {
  const ink = INK[theme];
  const [top, bottom, bar] = [MARGIN, height - MARGIN - FOOT, 14]; // level with the skin beside it
  const y = (v) => bottom - ((v - range.low) / (range.limit - range.low)) * (bottom - top);
  c.clearRect(0, 0, width, height);
  for (let row = top; row < bottom; row++) {
    const value = range.low + ((bottom - row - 0.5) / (bottom - top)) * (range.limit - range.low);
    c.fillStyle = colourOf(value, theme, range.limit);
    c.fillRect(1, row, bar, 1.5);
  }
  c.strokeStyle = ink.rim;
  c.lineWidth = 1;
  c.strokeRect(0.5, top - 0.5, bar + 1, bottom - top + 1);
  c.font = `11px ${FONT}`;
  c.textBaseline = "middle";
  c.textAlign = "left";
  const { values, text } = ticks(range.low, range.limit, Math.max(3, Math.round((bottom - top) / 60)));
  values.forEach((v, i) => {
    const zero = Math.abs(v) < 1e-12;
    c.strokeStyle = zero ? ink.text : ink.rim;
    c.fillStyle = zero ? ink.text : ink.quiet;
    c.beginPath();
    c.moveTo(zero ? 0 : bar + 1, y(v));
    c.lineTo(bar + 5, y(v));
    c.stroke();
    if (!threshold || Math.abs(y(v) - y(threshold)) > 11 || zero) c.fillText(text[i], bar + 8, y(v) + 0.5);
  });
  c.fillStyle = ink.text;
  c.fillText(unit, 1, top - 15);
  if (threshold > 0 && threshold < range.limit && y(0) - y(threshold) > 11) {
    c.strokeStyle = c.fillStyle = ink.accent;
    c.setLineDash([3, 2]);
    c.beginPath();
    c.moveTo(0, y(threshold));
    c.lineTo(bar + 5, y(threshold));
    c.stroke();
    c.setLineDash([]);
    c.fillText("γ₀", bar + 8, y(threshold));
  }
}
