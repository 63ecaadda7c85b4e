// All patches of a robot: on the robot in space, where its shape is known, and a small map of each, with its contacts
// and how fresh they are; or the map of one of them, large (#NAME).

import { Range, number } from "./colour.js";
import { force, unsure } from "./contacts.js";
import { Field } from "./field.js";
import { heightFor } from "./frame.js";
import { openShownSocket, readHeader } from "./link.js";
import { drawMap, drawScale } from "./map.js";
import { Surface } from "./surface.js";

const STALE = 0.5; // seconds after which a patch counts as silent
const THRESHOLD = 0.15; // relative change that noise stays below
const LINES = 3; // contacts that a small card tells
const MAPS_EVERY = 80; // ms, beside a robot in space, which is drawn with every frame

const byId = (id) => document.getElementById(id);
const cards = new Map();
const range = new Range();
window.ohmskin = { frame: null, frames: 0, body: null };
let [mapsDue, lastHash, connected] = [0, "", false];
const scale = new Surface(byId("scale"), redraw);

/** A message as { name, patches }, each patch with its pixels. */
function read(buffer) {
  let [frame, at] = readHeader(buffer);
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

class Card {
  constructor(name) {
    this._card = element("section", "card patch", byId("patches"));
    const link = element("a", "", element("h2", "", this._card));
    link.textContent = name;
    link.onclick = () => {
      if (this._card.dataset.one === "true") location.hash = ""; // back to all
      return this._card.dataset.one !== "true";
    };
    link.href = `#${encodeURIComponent(name)}`;
    this._where = element("p", "where", this._card);
    const canvas = element("canvas", "map", this._card);
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `Image of ${name}`);
    this._told = element("p", "told", this._card);
    this._domain = null;
    this._surface = new Surface(
      canvas,
      redraw,
      (width) => (this._domain ? heightFor(this._domain, width) : width),
    );
    this._field = null;
  }

  show(patch, theme, known, one) {
    const { card, fresh } = { card: this._card, fresh: known && patch.age !== null && patch.age <= STALE };
    card.hidden = one !== "" && one !== patch.name;
    card.dataset.one = one === patch.name;
    card.dataset.fresh = fresh;
    card.dataset.touched = fresh && patch.contacts.length > 0;
    const silent = patch.age === null ? "no data yet" : `unknown: silent for ${number(patch.age, 1)} s`;
    this._where.textContent = "";
    element("span", "age", this._where).textContent = fresh ? "live" : known ? silent : "unknown";
    this._where.append(` · ${patch.link}${patch.mode ? ` · ${patch.mode}` : ""}`);
    this._told.textContent = fresh ? this._lines(patch, card.dataset.one === "true") : "";
    if (card.hidden || !patch.domain) return;
    if (!this._domain) [this._domain, this._field] = [patch.domain, new Field(patch.raster)];
    this._surface.fit();
    this._field.set(Float32Array.from(patch.pixels, (code) => (code * patch.peak) / 127));
    const marks = { pairs: [], presses: [], bad: [], doubted: [], contacts: fresh ? patch.contacts : [] };
    const skin = { domain: patch.domain, electrodes: [] };
    const scene = { ...marks, skin, field: this._field, theme, limit: range.limit, threshold: THRESHOLD };
    this._surface.draw((c, w, h) => drawMap(c, w, h, scene));
  }

  _lines({ contacts }, all) {
    const lines = contacts.map((contact) => {
      const place = contact.in.map((v) => number(1000 * v, 0)).join(", ");
      const size = force(contact) ? `${force(contact)} N` : `${number(1e4 * contact.extent, 1)}\u00a0cm²`;
      return [`#${contact.id}: (${place}) mm`, size, unsure(contact)].filter(Boolean).join(" · ");
    });
    const left = lines.length - LINES + 1;
    return (all || left < 2 ? lines : [...lines.slice(0, LINES - 1), `and ${left} more`]).join("\n") || "No contact";
  }
}

/** The robot in space, from the first frame on that tells its shape. */
async function embody(robot) {
  const { BodyView } = await import("./body.js"); // pages without a robot do without it
  const open = (name) => (location.hash = encodeURIComponent(name));
  byId("robot").hidden = false;
  try {
    window.ohmskin.body = new BodyView(byId("space"), byId("labels"), robot, open);
    byId("body").dataset.robot = true;
  } catch (error) {
    byId("robot").hidden = true; // a browser without WebGL shows the maps
    console.warn(error);
  }
}

function show(frame, known) {
  [window.ohmskin.frame, connected] = [frame, known];
  const theme = document.documentElement.dataset.theme;
  byId("none").hidden = frame.patches.some((patch) => patch.age !== null);
  byId("name").textContent = frame.name;
  const heard = frame.patches.filter((patch) => known && patch.age !== null && patch.age <= STALE);
  const touched = heard.reduce((sum, patch) => sum + patch.contacts.length, 0);
  const silent = frame.patches.length - heard.length;
  const contacts = known ? `${touched} contact${touched === 1 ? "" : "s"}` : "contacts unknown";
  byId("note").textContent = frame.note ?? "";
  byId("note").hidden = !frame.note;
  byId("summary").textContent =
    `${frame.patches.length} patches, ${contacts}` + (silent && known ? `, ${silent} silent` : "");
  const values = frame.patches.flatMap((patch) => [...patch.pixels].map((code) => (code * patch.peak) / 127));
  range.follow(Math.min(0, ...values), Math.max(0, ...values), THRESHOLD, performance.now());
  byId("body").style.setProperty("--patches", frame.patches.length);
  window.ohmskin.body?.pose(frame.links ?? {});
  window.ohmskin.body?.show(frame.patches, known, STALE, theme, range.limit, THRESHOLD);
  const forces = heard.flatMap((patch) => patch.contacts.map((contact) => contact.force ?? null));
  byId("newtons").hidden = !forces.some((force) => force !== null);
  byId("fixed").hidden = !forces.includes(null);
  if (window.ohmskin.body && location.hash === lastHash && performance.now() < mapsDue) return;
  [mapsDue, lastHash] = [performance.now() + MAPS_EVERY, location.hash];
  scale.fit();
  scale.draw((c, w, h) => drawScale(c, w, h, { theme, range, unit: "Δσ/σ", threshold: THRESHOLD, named: "noise" }));
  const wanted = decodeURIComponent(location.hash.slice(1));
  const one = frame.patches.some((patch) => patch.name === wanted) ? wanted : "";
  byId("all").hidden = one === "";
  for (const patch of frame.patches) {
    if (!cards.has(patch.name)) cards.set(patch.name, new Card(patch.name));
    cards.get(patch.name).show(patch, theme, known, one);
  }
}

/** What was shown last, at the sizes of now: a canvas that changes its size is blank, and no frame may follow. */
function redraw() {
  mapsDue = 0;
  if (window.ohmskin.frame) show(window.ohmskin.frame, connected);
}

function connect() {
  const socket = openShownSocket(connect);
  let [newest, owed] = [null, 0]; // frames that are not answered yet
  const shapes = new Map(); // told once, and perhaps with a frame that is not drawn
  const take = async (frame) => {
    if (frame.robot && !window.ohmskin.body) await embody(frame.robot);
    window.ohmskin.frames += 1;
    owed += 1;
    frame.patches.forEach(({ points }, number) => points && shapes.set(number, points));
    if (!newest) {
      requestAnimationFrame(() => {
        for (const [number, points] of shapes) newest.patches[number].points = points;
        shapes.clear();
        show(newest, true);
        newest = null;
        if (!window.ohmskin.body) answer();
      });
    }
    newest = frame;
    if (window.ohmskin.body) answer(); // drawing in space takes longer than a frame where no GPU helps
  };
  let taken = Promise.resolve(); // one frame after the other: the first waits for the robot
  socket.onmessage = (event) => (taken = taken.then(() => take(read(event.data))));
  const answer = () => {
    for (; owed > 0; owed -= 1) {
      if (socket.readyState === WebSocket.OPEN) socket.send(window.ohmskin.body?.pressed ?? "drawn");
    }
  };
  socket.onclose = () => {
    if (window.ohmskin.frame) show(window.ohmskin.frame, false);
  };
}

connect();
