// The line under the controls: what the reader must know now, else what they could do. It is always there, so that the
// page never jumps when it changes.

const HINTS = {
  touch: "Touch the map, with several fingers if you like. “Hold presses” leaves them in place.",
  virtual:
    "Press the map with mouse or finger. Shift-click leaves a press in place; drag it, or double-click to remove.",
  real: "Press the skin. This page shows the contacts.",
  recording: "A recording: this page shows the recorded contacts.",
};
const SILENCE = 3; // s without a frame, from which on nothing is known any more

const finger = matchMedia("(pointer: coarse)").matches ? "touch" : "virtual";

/**
 * The notice { kind, text } for what is known, the gravest first. Where nobody knows what touches the skin, also why
 * (`unknown`), what to do (`todo`), how far it is (`progress`), and why a press is refused (`barred`).
 */
export function noticeFor(known) {
  const { connected, starting, setup, header, silence, refusal } = known;
  if (connected && !header && !starting) return { kind: "wait", text: "Waiting for the first frame…" };
  const without = withoutFrames(known);
  if (without) return refusal ? { ...without, text: refusal } : without;
  if (refusal) return { kind: "warn", text: refusal };
  if (header.preparing) {
    const waited = silence > 3 ? ` (${Math.floor(silence)} s)` : "";
    return { kind: "wait", text: `Preparing ${header.preparing}${waited}` };
  }
  if (header.recording?.ended && header.state === "paused")
    return { kind: "wait", text: "End of the recording. “Play” starts it again." };
  if (header.state === "paused" && !header.message) {
    const { position, length } = header.recording ?? {};
    const place = setup.recording
      ? `Showing ${position.toFixed(2)} s of ${length.toFixed(2)} s.`
      : "Showing the last frame.";
    return { kind: "wait", text: `Paused. ${place}` };
  }
  if (header.message) return { kind: "warn", text: sentence(header.message) };
  if (header.demo) return { kind: "demo", text: "Demonstration finger: press anywhere to take over." };
  return { kind: "hint", text: HINTS[setup.recording ? "recording" : setup.press ? finger : "real"] };
}

function withoutFrames({ connected, everConnected, starting, setup, header, silence }) {
  if (!connected && !everConnected) return { kind: "wait", text: "Connecting…" };
  if (!connected) {
    return {
      kind: "lost",
      text: "Connection to ohmskin lost. Is it still running? Reconnecting…",
      unknown: "the connection to ohmskin is lost",
      todo: "If ohmskin has ended, start it again, such as with “ohmskin live”. This page reconnects by itself.",
      barred: "the connection to ohmskin is lost",
    };
  }
  if (starting) {
    return {
      kind: "wait",
      text: "Starting. This page continues by itself.",
      title: "Starting",
      unknown: "the loop is starting",
      todo: sentence(starting.message),
      progress: starting.share,
      barred: "the loop is starting",
    };
  }
  if (header.state === "lost") {
    return {
      kind: "lost",
      text: sentence(header.message) || "Device lost; reconnecting.",
      unknown: "the device is lost",
      todo: setup.press
        ? "Start the virtual skin again. The loop reconnects by itself."
        : "Check the device’s power and cable. The loop reconnects by itself.",
      barred: "the device is lost; press again when it is back",
    };
  }
  if (header.state === "calibrating") {
    const text = setup.recording
      ? "Reading the calibration of the recording."
      : "Calibrating: keep the skin untouched.";
    return {
      kind: "warn",
      text: header.message ? sentence(header.message) : text,
      unknown: "the skin is being calibrated",
      progress: header.progress,
      todo: setup.recording ? "" : "Keep the skin untouched.",
      barred: "the skin is being calibrated; press when it is done",
    };
  }
  if (silence > SILENCE && !header.preparing) {
    const text = `No new frame for ${Math.floor(silence)} s: the loop is busy or has stopped.`;
    return {
      kind: "warn",
      text,
      unknown: `no new frame for ${Math.floor(silence)} s`,
      todo: "Wait, or look at the terminal.",
    };
  }
  return null;
}

/** A message of the loop as a sentence, with commands in quotation marks. */
function sentence(text) {
  const quoted = text?.replace(/`([^`]*)`/g, "“$1”");
  return quoted && `${quoted[0].toUpperCase()}${quoted.slice(1)}${/[.…!?]$/.test(quoted) ? "" : "."}`;
}
