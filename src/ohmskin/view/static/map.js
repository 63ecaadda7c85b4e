// A map of the skin: the image, and on it electrodes, driven pairs, presses and contacts. y points up.

import { colourOf, number, ticks } from "./colour.js";
import { drawContacts } from "./contacts.js";
import { FOOT, Frame, MARGIN, bounds, linesBetween } from "./frame.js";
import { FONT, INK, strokeOver } from "./ink.js";

/**
 * Draw one map.
 * scene: { skin, field (or null), theme, limit, threshold, pairs, contacts, presses, bad and doubted (electrodes),
 *   doubtful (whether all of it is), section, cursor, target ({ at, number }, where to press) }
 */
export function drawMap(c, width, height, scene) {
  const ink = INK[scene.theme];
  const f = new Frame(scene.skin.domain, width, height);
  c.clearRect(0, 0, width, height);
  c.font = `11px ${FONT}`;
  c.save();
  outline(c, f, scene.skin.domain);
  c.clip("evenodd"); // not in holes
  if (scene.field?.values) drawImage(c, f, scene);
  if (scene.section) drawHairs(c, f, scene, ink);
  c.restore();
  outline(c, f, scene.skin.domain);
  c.strokeStyle = scene.doubtful ? ink.doubt : ink.rim;
  c.lineWidth = scene.doubtful ? 2.5 : 1;
  c.setLineDash(scene.doubtful ? [8, 5] : []);
  c.stroke();
  c.setLineDash([]);
  drawSeam(c, f, scene.skin.domain, ink);
  drawPairs(c, f, scene, ink);
  drawElectrodes(c, f, scene, ink);
  drawScaleBar(c, f, height, scene, ink);
  for (const press of scene.presses) drawPress(c, f, press, ink);
  drawContacts(c, f, width, height - FOOT, scene, electrodeBoxes(f, scene), ink);
  if (scene.target) drawTarget(c, f, scene.target, ink);
  if (scene.cursor) drawCursor(c, f, scene.cursor, ink);
}

function outline(c, f, domain) {
  c.beginPath();
  if (domain.kind === "disc") c.arc(f.x(0), f.y(0), f.scale * domain.radius, 0, 2 * Math.PI);
  else if (domain.kind !== "polygon") {
    c.rect(f.x(0), f.y(domain.height), f.scale * domain.width, f.scale * domain.height);
  }
  for (const corners of [...(domain.outline ? [domain.outline] : []), ...(domain.holes ?? [])]) {
    corners.forEach(([x, y], i) => (i ? c.lineTo(f.x(x), f.y(y)) : c.moveTo(f.x(x), f.y(y))));
    c.closePath();
  }
}

// Where a closed band meets itself its sides are no rim.
function drawSeam(c, f, domain, ink) {
  if (domain.kind !== "band") return;
  c.setLineDash([3, 5]);
  c.strokeStyle = ink.halo;
  c.lineWidth = 3;
  for (const x of [0, domain.width]) {
    c.beginPath();
    c.moveTo(f.x(x), f.y(0));
    c.lineTo(f.x(x), f.y(domain.height));
    c.stroke();
  }
  c.setLineDash([]);
}

function drawImage(c, f, scene) {
  const { x0, y0, pitch, nx, ny } = scene.field.raster;
  c.fillStyle = colourOf(0, scene.theme, 1, 0);
  c.fill("evenodd");
  c.imageSmoothingEnabled = true;
  c.imageSmoothingQuality = "high";
  c.drawImage(
    scene.field.bitmap(scene.theme, scene.limit, scene.threshold),
    f.x(x0 - pitch / 2),
    f.y(y0 + (ny - 0.5) * pitch),
    nx * pitch * f.scale,
    ny * pitch * f.scale,
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
    for (const [x, y, u, v] of linesBetween(scene.skin.domain, at[a], at[b])) {
      c.moveTo(f.x(x), f.y(y));
      c.lineTo(f.x(u), f.y(v));
    }
  }
  c.stroke();
}

function drawElectrodes(c, f, scene, ink) {
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
    const [dx, dy] = labelSide(scene.skin.domain, electrode);
    c.lineWidth = 3;
    c.strokeText(number, x + 14 * dx, y - 14 * dy);
    c.fillStyle = ink.quiet;
    c.fillText(number, x + 14 * dx, y - 14 * dy);
    if (scene.bad.includes(number)) drawCross(c, x, y, ink);
    else if (scene.doubted.includes(number)) drawRing(c, x, y, ink);
  });
}

/** Boxes [x, y, width, height] of electrodes and their numbers, which labels are to leave free. */
function electrodeBoxes(f, scene) {
  return scene.skin.electrodes.flatMap((electrode) => {
    const [x, y] = [f.x(electrode.x), f.y(electrode.y)];
    const [dx, dy] = labelSide(scene.skin.domain, electrode);
    return [
      [x - 6, y - 6, 12, 12],
      [x + 14 * dx - 9, y - 14 * dy - 7, 18, 14],
    ];
  });
}

// An electrode that something is wrong with.
function drawRing(c, x, y, ink) {
  c.beginPath();
  c.arc(x, y, 7.5, 0, 2 * Math.PI);
  strokeOver(c, ink.halo, 4.5, ink.doubt, 2.2);
}

// An electrode that is left out.
function drawCross(c, x, y, ink) {
  c.beginPath();
  for (const side of [-1, 1]) {
    c.moveTo(x - 6, y - 6 * side);
    c.lineTo(x + 6, y + 6 * side);
  }
  strokeOver(c, ink.halo, 4, ink.bad, 2);
}

// Numbers stand outside the skin where there is an outside next to them, else up and right of the electrode.
function labelSide(domain, electrode) {
  const [left, bottom, right, top] = bounds(domain);
  const away = [electrode.x - (left + right) / 2, electrode.y - (bottom + top) / 2];
  if (domain.kind === "disc") {
    const length = Math.hypot(...away);
    return length > 0.8 * domain.radius ? [away[0] / length, away[1] / length] : [0.7, 0.7];
  }
  const side = (v, size) => (Math.abs(v) > 0.4 * size ? Math.sign(v) : 0);
  const [dx, dy] = [side(away[0], right - left), side(away[1], top - bottom)];
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
  strokeOver(c, ink.halo, 4, press.own ? ink.press : ink.other, 2, [5, 4]);
  if (press.held) {
    c.beginPath();
    c.arc(f.x(press.x), f.y(press.y), 2.5, 0, 2 * Math.PI);
    c.fillStyle = ink.press;
    c.fill();
  }
  c.restore();
}

function drawTarget(c, f, { at, number: place }, ink) {
  const [x, y] = [f.x(at[0]), f.y(at[1])];
  c.beginPath();
  for (const radius of [8, 16]) {
    c.moveTo(x + radius, y);
    c.arc(x, y, radius, 0, 2 * Math.PI);
  }
  strokeOver(c, ink.halo, 5, ink.other, 2.2);
  c.textAlign = "center";
  c.textBaseline = "middle";
  c.fillStyle = ink.other;
  c.fillText(place, x, y + 0.5);
}

function drawCursor(c, f, [x, y], ink) {
  c.beginPath();
  for (const [dx, dy] of [
    [1, 0],
    [-1, 0],
    [0, 1],
    [0, -1],
  ]) {
    c.moveTo(f.x(x) + 4 * dx, f.y(y) + 4 * dy);
    c.lineTo(f.x(x) + 12 * dx, f.y(y) + 12 * dy);
  }
  strokeOver(c, ink.halo, 4, ink.press, 1.6);
}

/** The colour bar with its ticks, unit and threshold, by its name; vertical. */
export function drawScale(c, width, height, { theme, range, unit, threshold, named = "γ₀" }) {
  const ink = INK[theme];
  const [top, bottom, bar] = [MARGIN, height - MARGIN - FOOT, 14]; // level with the skin beside it
  const y = (v) => bottom - ((v - range.low) / (range.limit - range.low)) * (bottom - top);
  c.clearRect(0, 0, width, height);
  for (let row = top; row < bottom; row++) {
    const value = range.low + ((bottom - row - 0.5) / (bottom - top)) * (range.limit - range.low);
    c.fillStyle = colourOf(value, theme, range.limit, threshold);
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
    c.fillText(named, bar + 8, y(threshold));
  }
}
