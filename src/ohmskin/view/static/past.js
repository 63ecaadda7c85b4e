// The last minute: a bar for each contact while it was felt, grey where nobody knew, amber below where data were in
// doubt.

import { doubtful } from "./contacts.js";
import { FONT, INK } from "./ink.js";

const SPAN = 60; // s
const GAP = 0.6; // s without news, after which another bar begins
const [LANE, BAR, FOOT, LEFT] = [13, 11, 17, 2]; // px

export class Past {
  constructor() {
    this.bars = []; // { kind, id, lane, from, to }, of times in s
  }

  /** What is known now (s): contacts, whether nobody knows what touches the skin, whether something is in doubt. */
  add(now, contacts, unknown, doubt) {
    this.bars = this.bars.filter((bar) => bar.to > now - SPAN);
    if (unknown) this._extend(now, "unknown", 0);
    else if (doubt) this._extend(now, "doubt", 0);
    for (const contact of unknown ? [] : contacts)
      this._extend(now, doubtful(contact) ? "unsure" : "contact", contact.id);
  }

  get contacts() {
    return new Set(this.bars.filter(({ lane }) => lane !== null).map(({ id }) => id)).size;
  }

  _extend(now, kind, id) {
    const bar = this.bars.findLast((bar) => bar.id === id && bar.kind === kind && now - bar.to < GAP);
    if (bar) {
      bar.to = now;
      return;
    }
    const lane = kind === "contact" || kind === "unsure" ? this._laneFor(now, id) : null;
    this.bars.push({ kind, id, lane, from: now, to: now });
  }

  // The one that this contact has, else the highest that has been free for a while.
  _laneFor(now, id) {
    const others = this.bars.filter((bar) => bar.lane !== null && bar.to > now - 3);
    const own = others.find((bar) => bar.id === id);
    const used = new Set(others.map((bar) => bar.lane));
    return own ? own.lane : [...Array(used.size + 1).keys()].find((lane) => !used.has(lane));
  }

  draw(c, width, height, theme, now) {
    const ink = INK[theme];
    const x = (time) => Math.max(LEFT, LEFT + (1 - (now - time) / SPAN) * (width - 2 * LEFT));
    const bottom = height - FOOT;
    c.clearRect(0, 0, width, height);
    c.font = `11px ${FONT}`;
    for (const { kind, from, to } of this.bars.filter(({ lane }) => lane === null)) {
      c.fillStyle = kind === "unknown" ? ink.grid : ink.doubt;
      if (kind === "unknown") c.fillRect(x(from), 0, Math.max(1, x(to) - x(from)), bottom);
      else c.fillRect(x(from), bottom - 3, Math.max(1, x(to) - x(from)), 3);
    }
    c.textBaseline = "middle";
    c.textAlign = "left";
    for (const { kind, id, lane, from, to } of this.bars) {
      const y = (lane + 0.5) * LANE;
      if (lane === null || y + LANE / 2 > bottom) continue;
      const [left, wide] = [x(from), Math.max(3, x(to) - x(from))];
      c.fillStyle = kind === "unsure" ? ink.doubt : ink.accent;
      c.beginPath();
      c.roundRect(left, y - BAR / 2, wide, BAR, 3);
      c.fill();
      if (wide < 24) continue;
      c.fillStyle = ink.paper;
      c.font = `600 9px ${FONT}`;
      c.fillText(`#${id}`, left + 4, y + 0.5);
      c.font = `11px ${FONT}`;
    }
    this._drawAxis(c, width, bottom, x, now, ink);
  }

  _drawAxis(c, width, bottom, x, now, ink) {
    c.strokeStyle = ink.rim;
    c.lineWidth = 1;
    c.beginPath();
    c.moveTo(LEFT, bottom + 0.5);
    c.lineTo(width - LEFT, bottom + 0.5);
    c.stroke();
    c.fillStyle = ink.quiet;
    for (const [ago, text, align] of [
      [SPAN, "60 s ago", "left"],
      [SPAN / 2, "30", "center"],
      [0, "now", "right"],
    ]) {
      c.textAlign = align;
      c.fillText(text, x(now - ago), bottom + 10);
    }
  }
}
