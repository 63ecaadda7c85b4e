// Guided calibration: the quiet skin, then ten presses where the page says, how far off they were felt, and newtons
// where the weights that press are known.

import { number } from "./colour.js";
import { strongest } from "./contacts.js";
import { bounds, contains } from "./frame.js";

const COUNT = 10;
const MARGIN = 0.12; // of the smaller side, that places stay away from the rim
const HOLD = 0.7; // s that a contact must stay where it is
const LIFTED = 0.4; // s without a contact, after which the next place is due
const STILL = 0.004; // m
const GRAVITY = 9.80665e-3; // N per gram
const [GOOD, FAIR] = [0.005, 0.01]; // m, mean error
const MIRRORS = {
  "mirrored left to right": ([x, y]) => [-x, y],
  "mirrored top to bottom": ([x, y]) => [x, -y],
  "rotated by 180°": ([x, y]) => [-x, -y],
  "rotated by 90°": ([x, y]) => [-y, x],
  "rotated by −90°": ([x, y]) => [y, -x],
  "mirrored across a diagonal": ([x, y]) => [y, x],
  "mirrored across the other diagonal": ([x, y]) => [-y, -x],
};

const byId = (id) => document.getElementById(id);
const mean = (values) => values.reduce((sum, value) => sum + value, 0) / values.length;
const millimetres = ([x, y]) => `${number(1e3 * x, 0)}, ${number(1e3 * y, 0)} mm`;

/** Places spread over a domain, away from its rim: a Halton sequence, bases 2 and 3. */
export function placesOn(domain, count = COUNT) {
  const [left, bottom, right, top] = bounds(domain);
  const [wide, high] = [right - left, top - bottom];
  const away = MARGIN * Math.min(wide, high);
  const free = (x, y) =>
    [...Array(8).keys()].every((k) =>
      contains(domain, x + away * Math.cos((k * Math.PI) / 4), y + away * Math.sin((k * Math.PI) / 4)),
    );
  const places = [];
  for (let k = 1; places.length < count && k < 100 * count; k++) {
    const [x, y] = [left + wide * halton(k, 2), bottom + high * halton(k, 3)];
    if (free(x, y)) places.push([x, y]);
  }
  return places;
}

function halton(k, base) {
  let [value, share] = [0, 1 / base];
  for (; k > 0; k = Math.floor(k / base), share /= base) value += share * (k % base);
  return value;
}

/** Weights in grams out of a text; null if it is none, or only one. */
export function weightsOf(text) {
  const grams = text.split(/[\s,;]+/).filter(Boolean).map(Number);
  if (!grams.length) return [];
  return grams.every((g) => g >= 1 && g <= 1e5) && new Set(grams).size > 1 ? grams : null;
}

/** What presses say: pairs [place, where it was felt or null]. Gives { verdict, text } in plain words. */
export function judge(pairs, domain) {
  const felt = pairs.filter(([, found]) => found);
  if (felt.length < pairs.length / 2) {
    const advice = "Press harder, or test the skin with “ohmskin self-test”.";
    return { verdict: "Poor", text: `${felt.length} of ${pairs.length} presses were detected. ${advice}` };
  }
  const [left, bottom, right, top] = bounds(domain);
  const middle = [(left + right) / 2, (bottom + top) / 2];
  const centred = ([x, y]) => [x - middle[0], y - middle[1]];
  const errorOf = (change) =>
    mean(
      felt.map(([place, found]) => {
        const [[x, y], [u, v]] = [centred(place), change(centred(found))];
        return Math.hypot(u - x, v - y);
      }),
    );
  const error = errorOf((at) => at);
  const [name, least] = Object.entries(MIRRORS)
    .map(([name, change]) => [name, errorOf(change)])
    .sort((a, b) => a[1] - b[1])[0];
  const worst = Math.max(...felt.map(([[x, y], [u, v]]) => Math.hypot(u - x, v - y)));
  const told =
    `${felt.length} of ${pairs.length} presses detected, ${number(1e3 * error, 1)} mm off on average, ` +
    `${number(1e3 * worst, 1)} mm at most.`;
  if (error > FAIR && least < error / 2) {
    const hint = `The map fits better ${name}: are the electrodes connected in that order?`;
    return { verdict: "Check the wiring", text: `${told} ${hint}` };
  }
  if (error > FAIR) return { verdict: "Poor", text: `${told} Test the wiring with “ohmskin self-test”.` };
  return { verdict: error > GOOD ? "Fair" : "Good", text: told };
}

export class Guide {
  /** page: { skin(), virtual(), send(command), settings() -> { radius, pressure }, changed() } */
  constructor(page) {
    this._page = page;
    this._step = null;
    this._weights = [];
    byId("guided").onclick = () => (this._step ? this.close() : this._open());
    byId("guide-close").onclick = () => this.close();
    byId("guide-on").onclick = () => this._go();
    byId("guide-other").onclick = () => this._other();
    byId("guide-grams").oninput = () => byId("guide-grams").setCustomValidity("");
    byId("guide").onkeydown = (event) => {
      if (event.key === "Escape") this.close();
    };
  }

  /** Where to press now, { at, number }; null if nowhere. */
  get target() {
    return this._step === "press" || this._step === "lift"
      ? { at: this._places[this._pairs.length - (this._step === "lift" ? 1 : 0)], number: this._number }
      : null;
  }

  get _number() {
    return this._pairs.length + (this._step === "press" ? 1 : 0);
  }

  _open() {
    this._pairs = [];
    this._outcome = "";
    this._places = placesOn(this._page.skin().domain);
    this._helped = false;
    this._enter("quiet");
    byId("guide-on").focus();
    if (matchMedia("(max-width: 760px)").matches) byId("map").scrollIntoView(); // the guide covers the rest
  }

  close() {
    if (this._helped) this._page.send({ type: "lift", id: "guide" });
    if (this._weights.length) this._weigh(0);
    this._enter(null);
    byId("guided").focus();
  }

  _enter(step) {
    this._step = step;
    this._since = null;
    this._reference = null;
    this._show();
    if (step === "press" && this._helped) this._press();
    if (step === "press" && this._weights.length) this._weigh(this._force);
    if (step === "done" && this._weights.length) this._page.send({ type: "save" });
    this._page.changed();
  }

  _press() {
    const [x, y] = this._places[this._pairs.length];
    const { radius, pressure } = this._page.settings();
    if (this._weights.length) this._page.send({ type: "push", id: "guide", x, y, radius, force: this._force });
    else this._page.send({ type: "press", id: "guide", x, y, radius, pressure });
  }

  /** Force of the press that is due (N). */
  get _force() {
    return GRAVITY * this._weights[this._pairs.length % this._weights.length];
  }

  _weigh(force) {
    this._page.send({ type: "weigh", force });
  }

  _go() {
    if (this._step === "quiet") {
      const grams = weightsOf(byId("guide-grams").value);
      if (!grams) {
        byId("guide-grams").setCustomValidity("Give two weights or more of 1 to 100000 g, such as 200 500, or none.");
        byId("guide-grams").reportValidity();
        return;
      }
      this._weights = grams;
      if (grams.length) this._page.send({ type: "begin" });
      this._page.send({ type: "calibrate" });
      this._began = performance.now();
      this._seen = false;
      this._enter("measure");
    } else if (this._step === "press") this._note(null);
    else if (this._step === "done") this._open();
  }

  _other() {
    if (this._step !== "press") return;
    this._helped = true;
    this._press();
    this._show();
  }

  _note(found) {
    if (this._weights.length) this._weigh(0);
    if (this._helped) this._page.send({ type: "lift", id: "guide" });
    this._pairs.push([this._places[this._pairs.length], found]);
    this._enter("lift");
  }

  /** Look at what is felt now (s); `unknown` if nobody knows. */
  update(now, header, contacts, unknown) {
    if (this._step === "done" && header.guided !== this._outcome) {
      this._outcome = header.guided;
      this._show();
    }
    if (this._step === "measure") {
      this._seen ||= header.state === "calibrating";
      byId("guide-progress").value = (header.progress ?? 0) * COUNT;
      if (header.state === "running" && (this._seen || performance.now() - this._began > 4000)) this._enter("press");
    } else if (this._step === "press" && !unknown) this._watch(now, contacts);
    else if (this._step === "lift" && !unknown) {
      this._since = contacts.length ? null : (this._since ?? now);
      if (this._since !== null && now - this._since > LIFTED)
        this._enter(this._pairs.length < this._places.length ? "press" : "done");
    }
  }

  _watch(now, contacts) {
    const best = strongest(contacts);
    if (!best) {
      this._since = null;
      return;
    }
    const still = this._reference && Math.hypot(best.x - this._reference[0], best.y - this._reference[1]) < STILL;
    if (this._since === null || !still) [this._since, this._reference] = [now, [best.x, best.y]];
    else if (now - this._since > HOLD) this._note([best.x, best.y]);
  }

  _show() {
    const step = this._step;
    byId("guide").hidden = !step;
    byId("guided").setAttribute("aria-expanded", Boolean(step));
    if (!step) return;
    byId("guide").dataset.step = step;
    const focused = byId("guide").contains(document.activeElement);
    const { title, text, on, other } = this._words();
    byId("guide-step").textContent = title;
    byId("guide-text").textContent = text;
    for (const [id, label] of [
      ["guide-on", on],
      ["guide-other", other],
    ]) {
      byId(id).hidden = !label;
      byId(id).textContent = label ?? "";
    }
    byId("guide-weights").hidden = step !== "quiet";
    byId("guide-progress").value = this._pairs.length;
    const now = document.activeElement; // a button that has gone loses the keyboard
    if (focused && (now.hidden || !byId("guide").contains(now))) byId("guide").focus();
  }

  _words() {
    if (this._step === "quiet")
      return { title: "1. Quiet", text: "Take everything off the skin.", on: "Measure the quiet skin" };
    if (this._step === "measure") return { title: "1. Quiet", text: "Measuring. Do not touch the skin." };
    if (this._step === "done") {
      const { verdict, text } = judge(this._pairs, this._page.skin().domain);
      const saved = this._weights.length ? this._outcome || "Fitting forces." : "Nothing is saved.";
      const more = "Electrodes and sheet are measured by “ohmskin calibrate”.";
      return { title: verdict, text: `${text} ${saved} ${more}`, on: "Again" };
    }
    const title = `2. Press ${this._number} of ${this._places.length}`;
    if (this._step === "lift") return { title, text: this._pairs.at(-1)[1] ? "Detected. Lift." : "Skipped. Lift." };
    const grams = this._weights[this._pairs.length % this._weights.length];
    const how = this._weights.length ? `Put ${grams} g` : "Press";
    const at = `${how} at ${millimetres(this._places[this._pairs.length])}, where the map shows the target, and hold.`;
    const help = this._page.virtual() && !this._helped;
    return { title, text: at, on: "Not detected: skip it", other: help ? "Press for me" : null };
  }
}
