// Line plots of both images along one straight line, with axes.

import { number, ticks } from "./colour.js";
import { bounds } from "./frame.js";
import { FONT, INK } from "./ink.js";

const SAMPLES = 160;
const [LEFT, RIGHT, TOP, BOTTOM] = [44, 12, 20, 30];

/**
 * scene: { skin, felt, base (fields; base null where it says nothing else), at [x, y], axis "x" or "y", range, unit,
 *   threshold, theme }
 */
export function drawSection(c, width, height, scene) {
  const ink = INK[scene.theme];
  const [left, bottom, right, top] = bounds(scene.skin.domain);
  const along = scene.axis === "x";
  const [from, to] = along ? [left, right] : [bottom, top];
  const px = (s) => LEFT + ((s - from) / (to - from)) * (width - LEFT - RIGHT);
  const py = (v) =>
    height - BOTTOM - ((v - scene.range.low) / (scene.range.limit - scene.range.low)) * (height - TOP - BOTTOM);
  c.clearRect(0, 0, width, height);
  c.font = `11px ${FONT}`;
  drawAxes(c, width, height, scene, { px, py, from, to }, ink);
  if (scene.threshold > 0) {
    c.strokeStyle = ink.threshold;
    c.setLineDash([4, 3]);
    c.lineWidth = 1;
    line(c, [
      [LEFT, py(scene.threshold)],
      [width - RIGHT, py(scene.threshold)],
    ]);
    c.setLineDash([]);
  }
  c.save();
  c.beginPath();
  c.rect(LEFT, TOP - 6, width - LEFT - RIGHT, height - TOP - BOTTOM + 12);
  c.clip();
  const [x, y] = scene.at;
  for (const [field, colour, weight] of [
    [scene.base, ink.base, 1.4],
    [scene.felt, ink.felt, 2],
  ]) {
    if (!field) continue;
    const points = [];
    for (let k = 0; k <= SAMPLES; k++) {
      const s = from + (k / SAMPLES) * (to - from);
      const value = along ? field.at(s, y) : field.at(x, s);
      if (!Number.isNaN(value)) points.push([px(s), py(value)]);
    }
    c.strokeStyle = colour;
    c.lineWidth = weight;
    c.lineJoin = "round";
    line(c, points);
  }
  c.restore();
  const here = along ? x : y;
  c.fillStyle = ink.text;
  c.beginPath(); // where the other plot crosses
  c.moveTo(px(here), height - BOTTOM);
  c.lineTo(px(here) - 4, height - BOTTOM + 6);
  c.lineTo(px(here) + 4, height - BOTTOM + 6);
  c.fill();
}

function drawAxes(c, width, height, scene, { px, py, from, to }, ink) {
  const along = scene.axis === "x";
  c.lineWidth = 1;
  c.textBaseline = "middle";
  c.textAlign = "right";
  const value = ticks(scene.range.low, scene.range.limit, Math.max(3, Math.round(height / 45)));
  value.values.forEach((v, i) => {
    c.strokeStyle = Math.abs(v) < 1e-12 ? ink.rim : ink.grid;
    line(c, [
      [LEFT, Math.round(py(v)) + 0.5],
      [width - RIGHT, Math.round(py(v)) + 0.5],
    ]);
    c.fillStyle = ink.quiet;
    c.fillText(value.text[i], LEFT - 6, py(v));
  });
  c.textBaseline = "alphabetic";
  const place = ticks(1000 * from, 1000 * to, Math.max(3, Math.round(width / 80)));
  place.values.forEach((mm, i) => {
    c.strokeStyle = ink.grid;
    line(c, [
      [px(mm / 1000), height - BOTTOM],
      [px(mm / 1000), height - BOTTOM + 4],
    ]);
    c.fillStyle = ink.quiet;
    const last = i === place.values.length - 1;
    c.textAlign = last ? "right" : "center";
    c.fillText(last ? `${place.text[i]} mm` : place.text[i], last ? width - 2 : px(mm / 1000), height - BOTTOM + 17);
  });
  c.textAlign = "left";
  c.fillStyle = ink.quiet;
  c.fillText(scene.unit, 4, 12);
  const [x, y] = scene.at.map((v) => number(1000 * v, 0));
  c.fillStyle = ink.text;
  c.fillText(along ? `along x, at y = ${y} mm` : `along y, at x = ${x} mm`, LEFT, 12);
}

function line(c, points) {
  c.beginPath();
  points.forEach(([x, y], i) => (i ? c.lineTo(x, y) : c.moveTo(x, y)));
  c.stroke();
}
