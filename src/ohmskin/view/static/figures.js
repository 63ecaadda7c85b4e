// Numbers, table and sparkline: everything of the page that is text.

import { number } from "./colour.js";
import { doubtful, ellipse, force } from "./contacts.js";
import { INK } from "./ink.js";

const byId = (id) => document.getElementById(id);
let shownWords = "";

/** Change what an element says, unless it says that already. */
export function setText(id, text) {
  const place = byId(id);
  if (place.textContent !== text) place.textContent = text;
}

function put(id, value, digits, factor = 1) {
  setText(id, Number.isFinite(value) ? number(factor * value, digits) : "–");
}

export function showFigures(header) {
  const health = header.health ?? {};
  put("rate", health.rate, 0);
  put("p50", health.latency_p50, 1, 1e3);
  put("p99", health.latency_p99, 1, 1e3);
  put("waiting", health.waiting, 0, 100);
  put("noise", health.noise, 1, 1e6);
  put("dropped", health.dropped, 0);
  put("sequence", header.sequence, 0);
}

/** What is wrong with the data, in words. */
export function showFindings(findings) {
  const words = findings.map((finding) => finding.words);
  if (words.join() === shownWords) return;
  shownWords = words.join();
  byId("findings").hidden = words.length === 0;
  byId("findings").lastElementChild.replaceChildren(
    ...words.map((text) => {
      const item = document.createElement("li");
      item.textContent = text[0].toUpperCase() + text.slice(1);
      return item;
    }),
  );
}

export function counted(contacts) {
  return contacts === 1 ? "1 contact" : `${contacts || "no"} contacts`;
}

/** A share from 0 to 1, a bar that only says that something goes on (null), or no bar at all. */
export function showProgress(share) {
  const bar = byId("progress");
  bar.hidden = share === undefined;
  if (share === null) bar.removeAttribute("value");
  else if (share !== undefined) bar.value = share;
}

/**
 * Rows of the contact table, by id, are kept and refilled, so that nothing flickers and selections survive; `none`
 * stands there if it is empty. Beside their number stand the gesture and the force of all (N), where these are known.
 */
export function showContacts(contacts, none, gesture, total) {
  const body = byId("contacts").tBodies[0];
  while (body.rows.length > contacts.length) body.deleteRow(-1);
  while (body.rows.length < contacts.length) addRow(body);
  [...contacts].sort((a, b) => a.id - b.id).forEach((contact, i) => {
    const cells = body.rows[i].cells;
    const share = Math.min(1, Math.max(0, contact.confidence));
    const sure = contact.covariance ? number(1e3 * ellipse(contact.covariance).major, 1) : "–";
    const texts = [
      String(contact.id),
      number(1e3 * contact.x, 1),
      number(1e3 * contact.y, 1),
      sure,
      number(1e4 * contact.extent, 2),
      number(1e4 * contact.strength, 2),
      force(contact) || "–",
    ];
    texts.forEach((text, k) => {
      if (cells[k].textContent !== text) cells[k].textContent = text;
    });
    // a column that has come stays, so that nothing moves with the contacts
    if (force(contact)) document.documentElement.dataset.force = true;
    body.rows[i].dataset.doubtful = doubtful(contact);
    cells[7].firstChild.firstChild.style.width = `${100 * share}%`;
    cells[7].lastChild.textContent = `${number(100 * share, 0)} %`;
  });
  byId("no-contacts").hidden = contacts.length > 0;
  byId("no-contacts").textContent = none;
  const told = gesture && gesture.name !== "unknown";
  const doing = told ? `${gesture.name} ${Math.round(100 * gesture.confidence)} %` : "";
  const together = Number.isFinite(total) && contacts.length ? `${number(total, 1)} N in all` : "";
  byId("contact-count").textContent = [contacts.length || "", doing, together].filter(Boolean).join(" · ");
  byId("contact-count").dataset.doubtful = told && (doubtful(gesture) || contacts.some(doubtful));
}

function addRow(body) {
  const row = body.insertRow();
  for (const { className } of byId("contacts").tHead.rows[0].cells) row.insertCell().className = className;
  const track = document.createElement("span");
  track.className = "track";
  track.append(document.createElement("span"));
  const share = document.createElement("span");
  share.className = "share";
  row.cells[7].append(track, share);
}

const SPAN = 60; // seconds that the sparkline shows

export class Spark {
  constructor() {
    this._points = [];
  }

  add(now, value) {
    if (!Number.isFinite(value) || now - (this._points.at(-1)?.[0] ?? -SPAN) < SPAN / 200) return;
    this._points.push([now, value]);
    while (this._points.length && this._points[0][0] < now - SPAN) this._points.shift();
  }

  draw(c, width, height, theme) {
    c.clearRect(0, 0, width, height);
    if (this._points.length < 2) return;
    const now = this._points.at(-1)[0];
    const most = 1.1 * Math.max(...this._points.map(([, v]) => v), 1e-9);
    const at = ([t, v]) => [width - 2 - ((now - t) / SPAN) * (width - 4), height - 2 - (v / most) * (height - 6)];
    c.strokeStyle = INK[theme].grid;
    c.beginPath();
    c.moveTo(0, height - 1.5);
    c.lineTo(width, height - 1.5);
    c.stroke();
    c.strokeStyle = INK[theme].felt;
    c.lineWidth = 1.6;
    c.lineJoin = "round";
    c.beginPath();
    this._points.forEach((point, i) => (i ? c.lineTo(...at(point)) : c.moveTo(...at(point))));
    c.stroke();
  }
}
