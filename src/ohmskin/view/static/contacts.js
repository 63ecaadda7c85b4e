// Contacts on a map.

import { number } from "./colour.js";
import { FONT, strokeOver } from "./ink.js";

const SURE = 0.9; // confidence below which a contact looks doubtful
const KEPT = 1.2; // how much stronger another contact must be to count as the strongest in its place
const SMALL = 260; // px of width, below which a map has no room for labels of two lines
const COVERED = 0.1; // px that a label may be farther away for each px² less of the image that it covers
const CROSSED = 30; // px that a label may be farther away where its line would cross something taken
const STAYS = 20; // px by which another place must be better than the one where a label is
const REACH = 3; // radii of a contact within which its colour is kept free

const labelled = new WeakMap(); // of each canvas, where the label of each contact is

/** Contacts with their uncertainty, and labels that avoid each other and the boxes that are `taken`. */
export function drawContacts(c, f, width, height, scene, taken, ink) {
  c.textBaseline = "alphabetic";
  c.textAlign = "left";
  const circles = scene.contacts.map((contact) => {
    const radius = f.scale * Math.sqrt(contact.extent / Math.PI);
    c.save();
    c.globalAlpha = doubtful(contact) ? 0.55 : 1;
    c.beginPath();
    c.arc(f.x(contact.x), f.y(contact.y), radius, 0, 2 * Math.PI);
    if (doubtful(contact)) strokeOver(c, ink.halo, 4, ink.doubt, 2, [2, 3]);
    else strokeOver(c, ink.halo, 4, ink.contact, 2);
    c.restore();
    if (contact.covariance) drawUncertainty(c, f, contact, ink);
    return [f.x(contact.x) - radius, f.y(contact.y) - radius, 2 * radius, 2 * radius];
  });
  taken.push(...circles);
  const shown = scene.contacts.map((contact, i) => visible(f, scene, contact, circles[i][2] / (2 * f.scale)));
  const [before, room] = [labelled.get(c), { taken, shown, right: width, bottom: height }];
  const places = scene.contacts.map((contact, i) => {
    const place = (size) => freePlace(circles[i], size, room, before?.get(contact.id));
    return [contact.id, drawLabel(c, contact, circles[i], place, taken, width, ink)];
  });
  labelled.set(c, new Map(places));
}

// The box [x, y, width, height] within which a contact of a radius (m) colours the map.
function visible(f, { field, threshold }, { x, y }, radius) {
  const step = field?.values ? radius / 8 : Infinity;
  const [right, left, up, down] = [
    [1, 0],
    [-1, 0],
    [0, 1],
    [0, -1],
  ].map(([dx, dy]) => {
    const coloured = (at) => Math.abs(field.at(x + dx * at, y + dy * at)) > threshold;
    let to = radius;
    while (to + step < REACH * radius && coloured(to + step)) to += step;
    return to;
  });
  return [f.x(x - left), f.y(y + up), f.scale * (left + right), f.scale * (up + down)];
}

/** The contact that changed most, or the one of id `kept` while it is nearly as strong; null if there is none. */
export function strongest(contacts, kept = null) {
  const size = ({ id, strength }) => Math.abs(strength) * (id === kept ? KEPT : 1);
  return contacts.reduce((best, next) => (best && size(best) >= size(next) ? best : next), null);
}

/** Whether a contact, or a gesture, is to look doubtful. */
export function doubtful({ confidence }) {
  return confidence < SURE;
}

// The ellipse that holds the true place 95 times in 100; with a cross, so that a very sure one is seen too.
function drawUncertainty(c, f, contact, ink) {
  const { major, minor, angle } = ellipse(contact.covariance);
  const [x, y] = [f.x(contact.x), f.y(contact.y)];
  c.beginPath();
  c.ellipse(x, y, Math.max(1, f.scale * major), Math.max(1, f.scale * minor), -angle, 0, 2 * Math.PI);
  for (const [dx, dy] of [
    [4, 0],
    [0, 4],
  ]) {
    c.moveTo(x - dx, y - dy);
    c.lineTo(x + dx, y + dy);
  }
  strokeOver(c, ink.halo, 3.5, ink.accent, 1.6);
}

/** Half axes (m) and direction (rad) of the 95 % ellipse of a covariance [xx, xy, yy] (m2). */
export function ellipse([xx, xy, yy]) {
  const middle = (xx + yy) / 2;
  const spread = Math.hypot((xx - yy) / 2, xy);
  const axis = (variance) => 2.4477 * Math.sqrt(Math.max(0, variance));
  return { major: axis(middle + spread), minor: axis(middle - spread), angle: Math.atan2(2 * xy, xx - yy) / 2 };
}

/** How sure a doubtful contact is, in words; else "". */
export function unsure(contact) {
  return doubtful(contact) ? `${number(100 * contact.confidence, 0)} % sure` : "";
}

/** Force in newtons with its standard deviation, if it is known; else "". */
export function force(contact) {
  if (!Number.isFinite(contact.force)) return "";
  const sure = Number.isFinite(contact.force_std) ? ` ±${number(contact.force_std, 1)}` : "";
  return `${number(contact.force, 1)}${sure}`;
}

// The longest label that covers nothing taken: place and effect, place alone, or the number alone. Where it is.
function drawLabel(c, contact, circle, place, taken, width, ink) {
  const id = `#${contact.id}`;
  const sure = contact.covariance ? ` ±${number(1000 * ellipse(contact.covariance).major, 1)}` : "";
  const where = `${number(1000 * contact.x, 0)}, ${number(1000 * contact.y, 0)}${sure} mm`;
  const doubt = unsure(contact);
  const effect = force(contact) ? `${force(contact)} N` : `strength ${number(1e4 * contact.strength, 2)} Δσ/σ·cm²`;
  const below = doubt ? `${effect} · ` : effect;
  c.font = `600 11px ${FONT}`;
  const lead = c.measureText(id).width + 6;
  c.font = `11px ${FONT}`;
  const [wide, second] = [where, below].map((text) => c.measureText(text).width);
  const forms = [
    ...(width < SMALL && !doubt ? [] : [[where, below, Math.max(wide, second + c.measureText(doubt).width)]]),
    ...(doubt ? [] : [[where, "", wide]]),
    ["", "", -6],
  ].map(([first, rest, across]) => ({ first, rest, w: lead + across + 12, h: rest ? 34 : 20 }));
  const places = forms.map(({ w, h }) => place([w, h]));
  const free = places.findIndex(({ covered }) => !covered);
  const k = free < 0 ? forms.length - 1 : free;
  const { first, rest, w, h } = forms[k];
  const [px, py] = places[k].at;
  taken.push([px, py, w, h]);
  drawLeader(c, circle, [px, py, w, h], ink);
  c.fillStyle = ink.pill;
  c.beginPath();
  c.roundRect(px, py, w, h, 5);
  c.fill();
  c.fillStyle = ink.text;
  c.font = `600 11px ${FONT}`;
  c.fillText(id, px + 6, py + 14);
  c.font = `11px ${FONT}`;
  c.fillText(first, px + 6 + lead, py + 14);
  if (!rest) return places[k].side;
  c.fillStyle = ink.quiet;
  c.fillText(rest, px + 6 + lead, py + 28);
  c.fillStyle = ink.doubt;
  c.fillText(doubt, px + 6 + lead + second, py + 28);
  return places[k].side;
}

// A line from a circle in the box [x, y, size, size] to its label, if that is some way off.
function drawLeader(c, [x, y, size], [px, py, w, h], ink) {
  const [cx, cy] = [x + size / 2, y + size / 2];
  const [dx, dy] = [Math.max(px, Math.min(px + w, cx)) - cx, Math.max(py, Math.min(py + h, cy)) - cy];
  const [far, from] = [Math.hypot(dx, dy), size / 2 + 2];
  if (far < from + 8) return;
  c.beginPath();
  c.moveTo(cx + (dx * from) / far, cy + (dy * from) / far);
  c.lineTo(cx + dx, cy + dy);
  strokeOver(c, ink.halo, 3, ink.contact, 1);
}

// Where beside a box a label of [w, h] covers least of what is taken, and how much; near the box rather than far, off
// the colour of contacts, and where it was before.
function freePlace([x, y, width, height], [w, h], { taken, shown, right, bottom }, before) {
  const [cx, cy] = [x + width / 2, y + height / 2];
  let [best, least] = [null, Infinity];
  for (const gap of [6, 18, 32]) {
    const [rx, ry] = [width / 2 + gap, height / 2 + gap];
    for (const [dx, dy] of [
      [1, 0],
      [-1, 0],
      [0, -1],
      [0, 1],
      [1, -1],
      [1, 1],
      [-1, -1],
      [-1, 1],
    ]) {
      const px = cx + dx * rx - ((1 - dx) * w) / 2;
      const py = cy + dy * ry - ((1 - dy) * h) / 2;
      const across = Math.max(0, 2 - px) + Math.max(0, px + w + 2 - right);
      const off = across + Math.max(0, 2 - py) + Math.max(0, py + h + 2 - bottom);
      const over = (boxes) => boxes.reduce((sum, other) => sum + overlap([px, py, w, h], other), 0);
      const [covered, side] = [50 * off + over(taken), `${gap} ${dx} ${dy}`];
      const stays = side === before ? -STAYS : 0;
      const crossed = CROSSED * crossings([cx, cy, rx - gap, ry - gap], [px, py, w, h], taken);
      const cost = gap * Math.hypot(dx, dy) + COVERED * over(shown) + crossed + (covered ? 1e3 + covered : stays);
      if (cost < least) [best, least] = [{ at: [px, py], covered, side }, cost];
    }
  }
  return best;
}

// How many boxes the line from an ellipse about (cx, cy) to a label crosses.
function crossings([cx, cy, rx, ry], [px, py, w, h], boxes) {
  const [dx, dy] = [Math.max(px, Math.min(px + w, cx)) - cx, Math.max(py, Math.min(py + h, cy)) - cy];
  const from = Math.min(1, (Math.max(rx, ry) + 3) / (Math.hypot(dx, dy) || 1));
  const points = [0.1, 0.3, 0.5, 0.7, 0.9].map((part) => from + part * (1 - from));
  return boxes.filter(([bx, by, bw, bh]) =>
    points.some((t) => overlap([cx + t * dx - 1, cy + t * dy - 1, 2, 2], [bx, by, bw, bh])),
  ).length;
}

function overlap([ax, ay, aw, ah], [bx, by, bw, bh]) {
  const w = Math.min(ax + aw, bx + bw) - Math.max(ax, bx);
  const h = Math.min(ay + ah, by + bh) - Math.max(ay, by);
  return w > 0 && h > 0 ? w * h : 0;
}
