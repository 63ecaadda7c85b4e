// All patches of a robot: a small map of each, its contacts, and how fresh they are.

import { number, paint } from "./colour.js";
import { bounds } from "./frame.js";
import { INK } from "./ink.js";

const STALE = 0.5; // seconds after which a patch counts as silent
const MARGIN = 8; // px around a skin
const LEAST_SCALE = 0.15; // relative change at full colour at least, so that noise stays quiet

const cards = new Map();
const state = document.getElementById("state");
window.ohmskin = { frame: null };

/** A message as { name, patches }, each patch with its pixels. */
function read(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const frame = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  let at = 4 + length;
  for (const patch of frame.patches) {
    patch.pixels = new Int8Array(buffer, at, patch.size ?? 0);
    at += patch.size ?? 0;
  }
  return frame;
}

function element(kind, className, parent) {
  const made = document.createElement(kind);
  made.className = className;
  parent.append(made);
  return made;
}

function cardOf(patch) {
  if (!cards.has(patch.name)) {
    const card = element("section", "card patch", document.getElementById("patches"));
    const title = element("h2", "", card);
    title.textContent = patch.name;
    const where = element("p", "where", card);
    const canvas = element("canvas", "", card);
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `Image of ${patch.name}`);
    cards.set(patch.name, {
      card,
      where,
      canvas,
      told: element("p", "told", card),
      small: document.createElement("canvas"),
    });
  }
  return cards.get(patch.name);
}

function drawSkin(canvas, small, patch, theme) {
  const side = Math.round(canvas.clientWidth * devicePixelRatio);
  if (canvas.width !== side) canvas.width = canvas.height = side;
  const pen = canvas.getContext("2d");
  pen.clearRect(0, 0, side, side);
  if (!patch.domain) return;
  const [left, bottom, right, top] = bounds(patch.domain);
  const scale = (side - 2 * MARGIN * devicePixelRatio) / Math.max(right - left, top - bottom);
  const x = (metres) => side / 2 + scale * (metres - (left + right) / 2);
  const y = (metres) => side / 2 - scale * (metres - (bottom + top) / 2);
  const outline = new Path2D();
  if (patch.domain.kind === "disc") outline.arc(x(0), y(0), scale * patch.domain.radius, 0, 2 * Math.PI);
  else outline.rect(x(left), y(top), scale * (right - left), scale * (top - bottom));
  const { nx, ny, pitch, x0, y0 } = patch.raster;
  small.width = nx;
  small.height = ny;
  const image = new ImageData(nx, ny);
  const order = Uint32Array.from({ length: nx * ny }, (_, k) => (ny - 1 - Math.floor(k / nx)) * nx + (k % nx));
  const values = Float32Array.from(patch.pixels, (code) => (code * patch.peak) / 127);
  paint(values, order, new Uint32Array(image.data.buffer), theme, Math.max(LEAST_SCALE, patch.peak));
  small.getContext("2d").putImageData(image, 0, 0);
  pen.save();
  pen.clip(outline);
  pen.drawImage(small, x(x0 - pitch / 2), y(y0 + (ny - 0.5) * pitch), scale * nx * pitch, scale * ny * pitch);
  pen.restore();
  pen.lineWidth = 1.5 * devicePixelRatio;
  pen.strokeStyle = INK[theme].rim;
  pen.stroke(outline);
  for (const contact of patch.contacts) {
    pen.beginPath();
    pen.arc(
      x(contact.at[0]),
      y(contact.at[1]),
      Math.max(4 * devicePixelRatio, scale * Math.sqrt(contact.extent / Math.PI)),
      0,
      2 * Math.PI,
    );
    pen.strokeStyle = INK[theme].halo;
    pen.lineWidth = 4 * devicePixelRatio;
    pen.stroke();
    pen.strokeStyle = INK[theme].contact;
    pen.lineWidth = 2 * devicePixelRatio;
    pen.stroke();
  }
}

function show(frame) {
  window.ohmskin.frame = frame;
  const theme = document.documentElement.dataset.theme;
  document.getElementById("none").hidden = frame.patches.some((patch) => patch.age !== null);
  document.getElementById("name").textContent = frame.name;
  const touched = frame.patches.reduce((sum, patch) => sum + patch.contacts.length, 0);
  const silent = frame.patches.filter((patch) => patch.age === null || patch.age > STALE).length;
  document.getElementById("summary").textContent =
    `${frame.patches.length} patches, ${touched} contact${touched === 1 ? "" : "s"}` +
    (silent ? `, ${silent} silent` : "");
  for (const patch of frame.patches) {
    const { card, where, canvas, told, small } = cardOf(patch);
    const fresh = patch.age !== null && patch.age <= STALE;
    card.dataset.fresh = fresh;
    card.dataset.touched = fresh && patch.contacts.length > 0;
    where.textContent = `${patch.link} ${patch.mode ? `· ${patch.mode} ` : ""}· `;
    element("span", "age", where).textContent =
      patch.age === null ? "not heard of" : fresh ? "live" : `silent for ${number(patch.age, 1)} s`;
    const lines = patch.contacts
      .slice(0, 3)
      .map(
        (c) => `${c.id}: (${c.in.map((v) => number(1000 * v, 0)).join(", ")}) mm · ${number(1e4 * c.extent, 1)} cm²`,
      );
    if (patch.contacts.length > 3) lines[2] = `and ${patch.contacts.length - 2} more`;
    told.textContent = lines.join("\n") || "–";
    drawSkin(canvas, small, patch, theme);
  }
}

function connect() {
  const address = new URL("socket", location.href);
  address.protocol = address.protocol.replace("http", "ws");
  address.search = location.search;
  address.hash = "";
  const socket = new WebSocket(address);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => {
    [state.dataset.state, state.textContent] = ["running", "connected"];
  };
  socket.onmessage = (event) => {
    const frame = read(event.data);
    requestAnimationFrame(() => {
      show(frame);
      if (socket.readyState === WebSocket.OPEN) socket.send("drawn");
    });
  };
  socket.onclose = () => {
    [state.dataset.state, state.textContent] = ["lost", "no connection"];
    setTimeout(connect, 1000);
  };
}

connect();
