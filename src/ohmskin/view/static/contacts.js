// Contacts on a map.

import { number } from "./colour.js";
import { FONT } from "./ink.js";

/** Contacts with their uncertainty, and labels that avoid each other. */
export function drawContacts(c, f, width, height, scene, ink) {
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
  for (const [dx, dy] of [
    [4, 0],
    [0, 4],
  ]) {
    c.moveTo(x - dx, y - dy);
    c.lineTo(x + dx, y + dy);
  }
  for (const [colour, weight] of [
    [ink.halo, 3.5],
    [ink.accent, 1.6],
  ]) {
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
  const newtons = () => `${number(contact.force, 1)} ±${number(contact.force_std, 1)} N`;
  const strength = contact.force == null ? `${number(1e4 * contact.strength, 2)} cm²` : newtons();
  c.font = `600 11px ${FONT}`;
  const lead = c.measureText(id).width + 6;
  c.font = `11px ${FONT}`;
  const w = lead + Math.max(c.measureText(where).width, c.measureText(strength).width) + 12;
  const h = 34;
  const middle = y + size / 2 - h / 2;
  const centre = x + size / 2 - w / 2;
  const places = [
    [x + size + 6, middle],
    [x - w - 6, middle],
    [centre, y - h - 6],
    [centre, y + size + 6],
  ];
  const cost = ([px, py]) => {
    const across = Math.max(0, 2 - px) + Math.max(0, px + w + 2 - width);
    const off = across + Math.max(0, 2 - py) + Math.max(0, py + h + 2 - height);
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
