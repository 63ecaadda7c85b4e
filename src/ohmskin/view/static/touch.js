// Fingers on the maps: mouse, touch and keyboard become presses. Owns the presses of this page and says what to send.

import { bounds, clampTo, contains } from "./frame.js";

const REACH = 16; // px, how near a held press must be to be grabbed
const DOUBLE = 350; // ms
const STEP = 0.002; // m
const BIG_STEP = 0.01;

export class Touch {
  /**
   * page: { skin(), virtual(), frame(canvas), settings() -> { radius, pressure }, send(command), changed(),
   *   barred() -> why nothing can be pressed now, or "", refuse(why) }
   */
  constructor(page) {
    this._page = page;
    this.presses = new Map(); // id -> { x, y, radius, pressure, held, moved }
    this.hold = false;
    this.hover = new Map(); // canvas -> [x, y]
    this.cursors = new Map(); // canvas -> [x, y], while it has the keyboard
    this._drags = new Map(); // pointer -> { id, offset }
    this._keyPress = null;
    this._newest = null;
    this._lastTap = { id: null, time: 0 };
    this._next = 1;
    addEventListener("blur", () => this._liftDragged());
  }

  attach(canvas) {
    canvas.addEventListener("pointerdown", (event) => this._down(canvas, event));
    canvas.addEventListener("pointermove", (event) => this._move(canvas, event));
    canvas.addEventListener("pointerup", (event) => this._up(event.pointerId));
    canvas.addEventListener("pointercancel", (event) => this._up(event.pointerId));
    canvas.addEventListener("pointerleave", () => {
      this.hover.delete(canvas);
      this._page.changed();
    });
    canvas.addEventListener("keydown", (event) => this._key(canvas, event));
    canvas.addEventListener("focus", () => {
      if (canvas.matches(":focus-visible")) this._showCursor(canvas);
    });
    canvas.addEventListener("blur", () => {
      this.cursors.delete(canvas);
      this._page.changed();
    });
  }

  /** Send presses that moved since the last call; called once per drawn picture. */
  flush() {
    for (const [id, press] of this.presses) if (press.moved) this._send(id, press);
  }

  /** New radius or pressure: also for the press that was touched last. */
  applySettings() {
    const press = this.presses.get(this._newest);
    if (press) Object.assign(press, this._page.settings(), { moved: true });
    this._page.changed();
  }

  liftAll() {
    this.forget();
    this._page.send({ type: "lift_all" });
    this._page.changed();
  }

  /** Forget presses without a word: the server lifts those of a page that has gone. */
  forget() {
    this.presses.clear();
    this._drags.clear();
    this._keyPress = null;
  }

  _refused() {
    const why = this._page.barred();
    if (why) this._page.refuse(why);
    return Boolean(why);
  }

  _send(id, press) {
    press.moved = false;
    const { x, y, radius, pressure } = press;
    this._page.send({ type: "press", id, x, y, radius, pressure });
  }

  _start(x, y, held) {
    const id = `p${this._next++}`;
    const press = { x, y, ...this._page.settings(), held, moved: false };
    this.presses.set(id, press);
    this._newest = id;
    this._send(id, press); // at once, so that even a tap shorter than a picture is felt
    return id;
  }

  _lift(id) {
    const press = this.presses.get(id);
    if (!press) return;
    if (press.moved) this._send(id, press);
    this.presses.delete(id);
    if (this._keyPress === id) this._keyPress = null;
    this._page.send({ type: "lift", id });
    this._page.changed();
  }

  _liftDragged() {
    for (const pointer of [...this._drags.keys()]) this._up(pointer);
  }

  _place(canvas, event) {
    const box = canvas.getBoundingClientRect();
    return this._page.frame(canvas).back(event.clientX - box.left, event.clientY - box.top);
  }

  _down(canvas, event) {
    if (event.button !== 0 || !this._page.virtual()) return;
    const [x, y] = this._place(canvas, event);
    const reach = REACH / this._page.frame(canvas).scale;
    const near = this._near(x, y, reach);
    if (near === null && (!contains(this._page.skin().domain, x, y) || this._refused())) return;
    canvas.setPointerCapture(event.pointerId);
    const twice = near !== null && this._lastTap.id === near && event.timeStamp - this._lastTap.time < DOUBLE;
    if (twice) {
      this._lift(near);
      return;
    }
    const id = near ?? this._start(x, y, event.shiftKey || this.hold);
    const press = this.presses.get(id);
    this._newest = id;
    this._lastTap = { id, time: event.timeStamp };
    this._drags.set(event.pointerId, { id, offset: [press.x - x, press.y - y] });
    this._page.changed();
  }

  _move(canvas, event) {
    const [x, y] = this._place(canvas, event);
    this.hover.set(canvas, [x, y]);
    const drag = this._drags.get(event.pointerId);
    const press = drag && this.presses.get(drag.id);
    if (press) {
      [press.x, press.y] = clampTo(this._page.skin().domain, x + drag.offset[0], y + drag.offset[1]);
      press.moved = true;
    }
    this._page.changed();
  }

  _up(pointer) {
    const drag = this._drags.get(pointer);
    this._drags.delete(pointer);
    const press = drag && this.presses.get(drag.id);
    if (press && !press.held) this._lift(drag.id);
  }

  _near(x, y, reach) {
    const dragged = new Set([...this._drags.values()].map((drag) => drag.id));
    let best = null;
    let least = Infinity;
    for (const [id, press] of this.presses) {
      const distance = Math.hypot(press.x - x, press.y - y);
      if (press.held && !dragged.has(id) && distance < Math.max(reach, press.radius) && distance < least)
        [best, least] = [id, distance];
    }
    return best;
  }

  _showCursor(canvas) {
    if (!this._page.skin() || !this._page.virtual() || this.cursors.has(canvas)) return;
    const domain = this._page.skin().domain;
    const [left, bottom, right, top] = bounds(domain);
    this.cursors.set(canvas, clampTo(domain, (left + right) / 2, (bottom + top) / 2));
    this._page.changed();
  }

  _key(canvas, event) {
    if (!this._page.skin() || !this._page.virtual() || event.ctrlKey || event.metaKey || event.altKey) return;
    const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    if (!way && event.key !== " " && event.key !== "Escape") return;
    event.preventDefault();
    if (event.key === "Escape") {
      this.liftAll();
      return;
    }
    this._showCursor(canvas);
    const [x, y] = this.cursors.get(canvas);
    if (way) {
      const step = event.shiftKey ? BIG_STEP : STEP;
      const to = clampTo(this._page.skin().domain, x + step * way[0], y + step * way[1]);
      this.cursors.set(canvas, to);
      const press = this.presses.get(this._keyPress);
      if (press) [press.x, press.y, press.moved] = [...to, true];
    } else if (!event.repeat) {
      if (this._keyPress) this._lift(this._keyPress);
      else if (!this._refused()) this._keyPress = this._start(x, y, true);
    }
    this._page.changed();
  }
}
