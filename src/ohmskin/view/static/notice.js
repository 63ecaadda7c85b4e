// The line under the controls: what the reader must know now, else what they could do. It is always there, so that the
// page never jumps when it changes.

const HINTS = {
  touch: "Touch the map, with several fingers if you like. “Hold presses” leaves them in place.",
  virtual: "Press the map with mouse or finger. Shift-click leaves a press in place; drag it, or double-click it away.",
  real: "Press the skin. This page shows what it feels.",
  recording: "A recording: this page shows what the skin felt.",
};

const finger = matchMedia("(pointer: coarse)").matches ? "touch" : "virtual";

/** The notice { kind, text } for what is known; the gravest first. */
export function noticeFor({ connected, everConnected, setup, header, silence, refusal }) {
  if (!connected) {
    return everConnected
      ? { kind: "lost", text: "The page has lost its program: it has ended or the network is down. Reconnecting…" }
      : { kind: "wait", text: "Connecting…" };
  }
  if (!header || !setup) return { kind: "wait", text: "Waiting for the first frame…" };
  if (header.state === "lost") return { kind: "lost", text: header.message || "The device is lost. Reconnecting…" };
  if (refusal) return { kind: "warn", text: refusal };
  if (header.preparing) {
    const waited = silence > 3 ? ` (${Math.floor(silence)} s)` : "";
    return { kind: "wait", text: `Preparing ${header.preparing}${waited}` };
  }
  if (silence > 3)
    return { kind: "warn", text: `No new frame for ${Math.floor(silence)} s: the loop is busy or has stopped.` };
  if (header.state === "calibrating")
    return { kind: "warn", text: header.message || "Calibrating: keep the skin untouched." };
  if (header.state === "paused" && !header.message) {
    return {
      kind: "wait",
      text: setup.recording ? "Paused. The maps show this place." : "Paused. The maps show the last frame.",
    };
  }
  if (header.message) return { kind: "warn", text: header.message };
  if (header.demo) return { kind: "demo", text: "Demonstration finger: press anywhere to take over." };
  return { kind: "hint", text: HINTS[setup.recording ? "recording" : setup.press ? finger : "real"] };
}
