// The live page: takes the newest frame, draws once per screen refresh, tells the server what it has drawn.

import { Range, number } from "./colour.js";
import { strongest } from "./contacts.js";
import { Controls } from "./controls.js";
import { Field } from "./field.js";
import { Spark, counted, setText, showContacts, showFigures, showFindings, showProgress } from "./figures.js";
import { Frame, bounds, clampTo, heightFor } from "./frame.js";
import { Guide } from "./guide.js";
import { showHelp } from "./help.js";
import { Link } from "./link.js";
import { drawMap, drawScale } from "./map.js";
import { noticeFor } from "./notice.js";
import { Past } from "./past.js";
import { savePicture } from "./picture.js";
import { drawSection } from "./section.js";
import { Surface } from "./surface.js";
import { Touch } from "./touch.js";
import { Transport } from "./transport.js";

const TEXT_EVERY = 100; // ms between changes of numbers, which nobody reads faster
const SUMMARY_EVERY = 2000;

const byId = (id) => document.getElementById(id);
const domainHeight = (width) => (setup ? heightFor(setup.skin.domain, width) : width);

let setup = null;
let starting = null; // what the loop does before there is a setup
let frame = null; // the newest: { header, base, image }
let unacknowledged = null; // sequence of the frame that the server waits for
let ready = false;
let asked = false;
let everConnected = false;
let refusal = { text: "", until: 0 };
let notice = {};
let frameTime = performance.now();
let [textTime, textDue] = [0, null]; // a moment, a timer
let summaryTime = 0;
let section = null; // where the cross-sections run, [x, y]
let through = null; // id of the contact that they run through
let drawnTimes = [];
const fields = { map: null, base: null };
const range = new Range();
const spark = new Spark();
const past = new Past();

const surfaces = {
  map: new Surface(byId("map"), requestDraw, domainHeight),
  base: new Surface(byId("base"), requestDraw, domainHeight),
  scale: new Surface(byId("scale"), requestDraw),
  x: new Surface(byId("section-x"), requestDraw),
  y: new Surface(byId("section-y"), requestDraw),
  spark: new Surface(byId("spark"), requestDraw),
  past: new Surface(byId("past"), requestDraw),
};

const touch = new Touch({
  skin: () => setup?.skin,
  virtual: () => Boolean(setup?.press),
  frame: (canvas) => new Frame(setup.skin.domain, canvas.clientWidth, canvas.clientHeight),
  settings: () => controls.press,
  send: (command) => link.send(command),
  changed: requestDraw,
  barred: () => notice.barred ?? "",
  refuse: (why) => refuse(`not pressed: ${why}`),
});
touch.attach(byId("map"));
touch.attach(byId("base"));

const controls = new Controls({
  send: (command) => link.send(command),
  touch,
  range,
  header: () => frame?.header,
  save,
  changed: requestDraw,
  refuse,
});

const guide = new Guide({
  skin: () => setup.skin,
  virtual: () => Boolean(setup.press),
  settings: () => controls.press,
  send: (command) => link.send(command),
  changed: requestDraw,
});

const transport = new Transport((command) => link.send(command));

const link = new Link({
  onOpen() {
    everConnected = true;
    frameTime = performance.now();
    requestDraw();
  },
  onLost() {
    unacknowledged = null;
    touch.forget();
    requestDraw();
  },
  onStarting(message) {
    starting = message;
    frameTime = performance.now();
    requestDraw();
  },
  onSetup(message) {
    setup = message;
    starting = null;
    frame = null;
    section = null;
    fields.map = new Field(setup.raster);
    fields.base = new Field(setup.raster);
    range.restart();
    controls.showSetup(setup);
    transport.showSetup(setup.recording);
    labelMaps();
    for (const surface of Object.values(surfaces)) surface.fit();
    requestDraw();
  },
  onFrame(message) {
    const size = setup ? setup.raster.nx * setup.raster.ny : -1;
    unacknowledged = message.header.sequence;
    if (message.image.length === size && message.base.length === size) frame = message;
    frameTime = performance.now();
    spark.add(frameTime / 1000, message.header.health?.rate);
    requestDraw();
  },
  onRefused: (text) => refuse(`not done: ${text}`),
});

function refuse(text) {
  refusal = { text: `${text[0].toUpperCase()}${text.slice(1)}.`, until: performance.now() + 4000 };
  requestDraw();
}

function requestDraw() {
  if (asked) return;
  asked = true;
  requestAnimationFrame(draw);
}

function draw(now) {
  asked = false;
  touch.flush();
  if (setup) drawPicture(now);
  if (now - textTime > TEXT_EVERY || !ready) showText(now);
  else textDue ??= setTimeout(requestDraw, 1.1 * TEXT_EVERY); // the last change must not stay unsaid
  if (unacknowledged !== null) {
    link.send({ type: "ack", sequence: unacknowledged });
    unacknowledged = null;
    ready ||= frame !== null;
    drawnTimes.push(now);
  }
}

function drawPicture(now) {
  const theme = document.documentElement.dataset.theme;
  if (frame) {
    fields.map.set(frame.image);
    fields.base.set(frame.base);
    const [[a, b], [c, d]] = [fields.map.extremes(), fields.base.extremes()];
    const { threshold = 0, base_threshold = 0 } = frame.header;
    range.follow(Math.min(a, c), Math.max(b, d), Math.max(threshold, base_threshold), now);
    placeSection();
  }
  const scene = scenes(theme, Boolean(notice.unknown));
  document.documentElement.dataset.single = Boolean(frame) && fields.base.equals(fields.map);
  surfaces.map.draw((c, w, h) => drawMap(c, w, h, scene.felt));
  surfaces.base.draw((c, w, h) => drawMap(c, w, h, scene.base));
  surfaces.scale.draw((c, w, h) => drawScale(c, w, h, scene.scale));
  if (!frame) return;
  for (const axis of ["x", "y"]) {
    surfaces[axis].draw((c, w, h) =>
      drawSection(c, w, h, {
        ...scene.scale,
        skin: setup.skin,
        felt: fields.map,
        base: single() ? null : fields.base,
        at: section,
        axis,
      }),
    );
  }
  surfaces.spark.draw((c, w, h) => spark.draw(c, w, h, theme));
  surfaces.past.draw((c, w, h) => past.draw(c, w, h, theme, now / 1000));
}

/** Whether the base image is all that there is. */
function single() {
  return document.documentElement.dataset.single === "true";
}

function scenes(theme, unknown = false) {
  const header = frame?.header ?? {};
  const findings = header.findings ?? [];
  const common = {
    skin: setup.skin,
    theme,
    limit: range.limit,
    presses: shownPresses(header),
    bad: header.bad_electrodes ?? [],
    doubted: findings.flatMap((finding) => finding.electrodes),
    doubtful: findings.some((finding) => !finding.electrodes.length),
    section: frame && section,
  };
  const threshold = header.threshold ?? 0;
  return {
    felt: {
      ...common,
      field: fields.map,
      threshold,
      pairs: (!unknown && header.injections) || [],
      contacts: (!unknown && header.contacts) || [],
      cursor: touch.cursors.get(byId("map")),
      target: guide.target,
    },
    base: {
      ...common,
      field: fields.base,
      threshold: header.base_threshold ?? threshold,
      pairs: (!unknown && header.base_injections) || [],
      contacts: [],
      cursor: touch.cursors.get(byId("base")),
    },
    scale: { theme, range, unit: setup.unit, threshold },
  };
}

// This page's own presses are drawn where the finger is now, not where the loop last saw them.
function shownPresses(header) {
  const own = `${setup.client}:`;
  const others = (header.presses ?? []).filter((press) => !press.id.startsWith(own));
  return [...others, ...[...touch.presses.values()].map((press) => ({ ...press, own: true }))];
}

function placeSection() {
  const contact = strongest(frame.header.contacts ?? [], through);
  through = contact?.id ?? null;
  const [left, bottom, right, top] = bounds(setup.skin.domain);
  if (contact) section = clampTo(setup.skin.domain, contact.x, contact.y);
  else section ??= [(left + right) / 2, (bottom + top) / 2];
}

function showText(now) {
  textTime = now;
  textDue = clearTimeout(textDue) ?? null;
  const silence = (now - frameTime) / 1000;
  if (now > refusal.until) refusal = { text: "", until: 0 };
  const header = frame?.header;
  notice = noticeFor({
    connected: link.connected,
    everConnected,
    starting,
    setup,
    header,
    silence,
    refusal: refusal.text,
  });
  setText("notice", notice.text);
  byId("notice").dataset.kind = notice.kind;
  const ended = header?.recording?.ended && header.state === "paused";
  const shown = starting ? "starting" : ended ? "end" : (header?.state ?? "connecting");
  const state = link.connected ? shown : everConnected ? "disconnected" : "connecting";
  setText("state", state);
  byId("state").dataset.state = state;
  document.documentElement.dataset.stale = Boolean(notice.unknown);
  byId("unknown").hidden = !notice.unknown;
  byId("unknown").dataset.kind = notice.kind;
  setText("unknown-why", notice.unknown ? (notice.title ?? `Unknown: ${notice.unknown}.`) : "");
  showProgress(notice.progress);
  setText("unknown-todo", notice.todo ?? "");
  if (!header) return;
  controls.showHeader(header);
  transport.showHeader(header);
  controls.showRange(range);
  const known = notice.unknown ? {} : header;
  const { contacts = [], findings = [], gesture, total_force: total } = known;
  showFigures(known);
  showContacts(contacts, notice.unknown ? "Unknown" : "No contact", gesture, total);
  showFindings(findings);
  guide.update(now / 1000, header, contacts, Boolean(notice.unknown));
  past.add(now / 1000, contacts, Boolean(notice.unknown), findings.length > 0);
  showReadouts();
  setText("section-of", notice.unknown ? "unknown" : contacts.length ? `through contact ${through}` : "no contact");
  drawnTimes = drawnTimes.filter((time) => time > now - 1000);
  setText("drawn", `${drawnTimes.length} displayed fps`);
  if (now - summaryTime > SUMMARY_EVERY) {
    summaryTime = now;
    byId("past").setAttribute("aria-label", `The last minute: ${counted(past.contacts)}`);
    setText("summary", notice.unknown ? `contacts unknown: ${notice.unknown}` : counted(contacts.length));
  }
}

function showReadouts() {
  for (const name of ["map", "base"]) {
    const place = touch.hover.get(byId(name)) ?? touch.cursors.get(byId(name));
    const value = place && fields[name].values && !notice.unknown ? fields[name].at(...place) : NaN;
    const text = Number.isNaN(value)
      ? ""
      : `${number(1e3 * place[0], 0)}, ${number(1e3 * place[1], 0)} mm: ` +
        `${number(value, digitsFor(range.limit))} ${setup.unit}`;
    setText(`${name}-readout`, text);
  }
}

function digitsFor(limit) {
  return Math.max(0, 2 - Math.floor(Math.log10(limit)));
}

function labelMaps() {
  const keys = setup.press ? " Arrow keys move a cursor, Space presses and lifts, Escape lifts all." : "";
  byId("map").setAttribute("aria-label", `Map of what the robot feels.${keys}`);
  byId("base").setAttribute("aria-label", `Map of the base scan.${keys}`);
}

function save() {
  if (!frame) return;
  const theme = document.documentElement.dataset.theme;
  const scene = scenes(theme, Boolean(notice.unknown));
  if (single()) scene.base = null;
  savePicture(setup, frame.header, scene, controls.title(frame.header.mode), notice.unknown);
}

setInterval(() => {
  if (performance.now() - frameTime > 1000) requestDraw(); // so that silence shows
}, 500);
document.addEventListener("visibilitychange", () => {
  frameTime = performance.now(); // a hidden page asks for no frames
});

Object.defineProperty(window, "ohmskin", {
  value: Object.freeze({
    get ready() {
      return ready && link.connected;
    },
    get frame() {
      return frame?.header ?? null;
    },
    get setup() {
      return setup;
    },
  }),
});
showHelp();
requestDraw();
