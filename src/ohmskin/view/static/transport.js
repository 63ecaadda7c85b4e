// What a recording is led with: play, step, seek, speed, loop. There only while the device is one.

import { number } from "./colour.js";
import { setText } from "./figures.js";

const SPEEDS = [0.25, 0.5, 1, 2, 4, null]; // null: as fast as it can
const SEEK_EVERY = 60; // ms between places sent while the bar is dragged
const KEEP = 500; // ms for which a change stays as it was made, until the loop has followed

const byId = (id) => document.getElementById(id);
const tell = (speed) => (speed === null ? "fastest" : `${speed}×`);

export class Transport {
  constructor(send) {
    this._send = send;
    this._length = 0;
    this._held = false; // whether a finger is on the bar
    this._touched = {}; // when the reader changed what
    this._seekTimer = 0;
    byId("play").onclick = () => send({ type: "pause", paused: !this._paused });
    byId("back").onclick = () => send({ type: "step", cycles: -1 });
    byId("forward").onclick = () => send({ type: "step", cycles: 1 });
    byId("loop").onclick = () => send({ type: "loop", on: byId("loop").getAttribute("aria-pressed") !== "true" });
    byId("speed").onchange = () => {
      this._touched.speed = performance.now();
      send({ type: "speed", speed: JSON.parse(byId("speed").value) });
    };
    const bar = byId("seek");
    bar.oninput = () => this._seek();
    bar.onpointerdown = (event) => (this._held = event.button === 0);
    bar.onpointerup = bar.onpointercancel = bar.onchange = bar.onblur = () => (this._held = false);
    bar.onkeydown = (event) => this._key(event);
  }

  showSetup(recording) {
    document.documentElement.dataset.recording = Boolean(recording);
    this._length = recording?.length ?? 0;
    byId("seek").max = this._length;
    byId("seek").disabled = this._length === 0;
    byId("speed").replaceChildren(...SPEEDS.map(option));
  }

  showHeader({ state, recording }) {
    if (!recording) return;
    this._paused = state === "paused";
    setText("play", this._paused ? "Play" : "Pause");
    byId("loop").setAttribute("aria-pressed", recording.loop);
    if (!this._fresh("speed")) this._showSpeed(recording.speed);
    if (!this._held && !this._fresh("seek")) byId("seek").value = recording.position;
    this._showPosition();
  }

  _key(event) {
    const way = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1 }[event.key];
    if (!way || event.altKey || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    byId("seek").value = byId("seek").valueAsNumber + way * Math.min(event.shiftKey ? 10 : 1, this._length / 20);
    this._seek();
  }

  _seek() {
    this._touched.seek = performance.now();
    this._showPosition();
    this._seekTimer ||= setTimeout(() => {
      this._seekTimer = 0;
      this._send({ type: "seek", position: byId("seek").valueAsNumber });
    }, SEEK_EVERY);
  }

  _fresh(what) {
    return performance.now() - this._touched[what] < KEEP;
  }

  _showPosition() {
    const digits = this._length < 100 ? 2 : 1;
    const [position, length] = [byId("seek").valueAsNumber, this._length].map((seconds) => number(seconds, digits));
    setText("position", `${position} / ${length} s`);
    byId("seek").setAttribute("aria-valuetext", `${position} of ${length} seconds`);
  }

  _showSpeed(speed) {
    const value = JSON.stringify(speed);
    const choices = byId("speed");
    if (choices.value === value) return;
    const known = [...choices.options].some((choice) => choice.value === value);
    if (!known) choices.prepend(option(speed)); // set on the command line
    choices.value = value;
  }
}

function option(speed) {
  return new Option(tell(speed), JSON.stringify(speed));
}
