// What the marks on the page mean: a line under the map, and the whole of it in a dialog.

const byId = (id) => document.getElementById(id);

// Name, shape in 28 x 20, what it is, more, and whether it is there on virtual skins only. Its colour is in the style.
const MARKS = [
  ["contact", '<circle cx="14" cy="10" r="7.5"/>', "Contact.", "The circle has the area of the contact’s extent."],
  [
    "unsure",
    '<circle cx="14" cy="10" r="7.5" stroke-dasharray="2 3"/>',
    "Doubtful contact:",
    "confidence below 90\u00a0%.",
  ],
  [
    "place",
    '<ellipse cx="14" cy="10" rx="9" ry="5.5" transform="rotate(-25 14 10)"/><path d="M10 10h8M14 6v8"/>',
    "Position.",
    "The ellipse is the 95\u00a0% confidence region of the position; “±” is its longer half axis. " +
      "Centroid modes have none.",
  ],
  [
    "press",
    '<circle cx="14" cy="10" r="7.5" stroke-dasharray="5 3.5"/>',
    "Press",
    "on the virtual skin, with its true radius; violet: by someone else, or by the demonstration finger.",
    true,
  ],
  ["driven", '<path d="M3 16L25 4"/>', "Driven now:", "current flows between these two electrodes."],
  [
    "hairs",
    '<path d="M2 10h24M14 1v18"/>',
    "Crosshair:",
    "where the cross-sections run, through the strongest contact.",
  ],
  [
    "target",
    '<circle cx="14" cy="10" r="8"/><circle cx="14" cy="10" r="4"/>',
    "Target",
    "of the guided calibration: press there.",
  ],
  ["cursor", '<path d="M4 10h6M18 10h6M14 1v6M14 13v6"/>', "Keyboard cursor.", "", true],
  ["electrode", '<circle cx="10" cy="12" r="3.4"/><text x="16" y="9">7</text>', "Electrode", "and its number."],
  [
    "out",
    '<path d="M9 5l10 10M19 5L9 15"/>',
    "Electrode left out:",
    "its data are not used. “Doubts”, below the contacts, gives the reason.",
  ],
  [
    "doubted",
    '<circle cx="14" cy="10" r="7"/><circle cx="14" cy="10" r="1.5"/>',
    "Electrode with a fault:",
    "“Doubts” gives the reason.",
  ],
  [
    "doubtful",
    '<path d="M3 17V4h22v13" stroke-dasharray="5 3"/>',
    "Dashed rim:",
    "all data are affected, such as by hum.",
  ],
];
const LEGEND = {
  contact: "contact",
  press: "press",
  place: "position (95\u00a0%)",
  driven: "driven now",
  out: "left out",
};
const FIGURES = [
  ["colour", "Change of sheet conductivity. Warm: it rises; blue: it falls. Most skins rise where they are pressed."],
  ["γ₀", "The threshold. Values below it may be noise, and have almost no colour."],
  ["extent", "Area where the image exceeds half the contact’s peak."],
  [
    "strength",
    "Relative change of conductivity (Δσ/σ), integrated over the extent. It grows with force, but is not a force.",
  ],
  ["force", "In newtons, with its standard deviation; on skins that are calibrated to newtons."],
  [
    "gesture",
    "Next to the number of contacts: tap, stroke, push or grasp, with its probability; empty while unknown.",
  ],
  ["last minute", "A bar for each contact; amber: doubtful. Grey: unknown. Amber line below: faulty data."],
  ["confidence", "Probability that this is a contact, given the noise and the unexplained share of the data."],
];
const KEYS = [
  ["?", "Open this help; Escape closes it."],
  ["arrows", "On a map: move a cursor by 2 mm, with Shift by 10 mm.", true],
  ["Space", "On a map: press at the cursor; again: lift. Escape lifts all.", true],
];

function element(kind, content, className = "") {
  const made = document.createElement(kind);
  made.className = className;
  made.append(...content);
  return made;
}

function swatch([name, shape]) {
  const text = `<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 28 20" aria-hidden="true">${shape}</svg>`;
  const made = document.importNode(new DOMParser().parseFromString(text, "image/svg+xml").documentElement, true);
  made.setAttribute("class", `swatch ${name}`);
  return made;
}

function list(title, rows) {
  const entries = rows.map(([term, text, virtual]) =>
    element("div", [element("dt", [term]), element("dd", [text].flat())], virtual ? "virtual" : ""),
  );
  return [element("h3", [title]), element("dl", entries)];
}

/** Fill the line and the dialog; open it at the button and at "?". */
export function showHelp() {
  const dialog = byId("marks");
  for (const mark of MARKS.filter(([name]) => name in LEGEND))
    byId("legend").append(element("span", [swatch(mark), LEGEND[mark[0]]], mark[4] ? "virtual" : ""));
  const marks = MARKS.map((mark) => [swatch(mark), [element("b", [mark[2]]), ` ${mark[3]}`], mark[4]]);
  dialog.append(...list("On the map", marks), ...list("Colours and figures", FIGURES), ...list("Keys", KEYS));
  byId("help").onclick = () => dialog.showModal();
  byId("close-marks").onclick = () => dialog.close();
  dialog.onclick = (event) => event.target === dialog && dialog.close(); // a click beside it
  addEventListener("keydown", (event) => {
    if (event.key === "?" && !event.target.closest("input, select, dialog")) dialog.showModal();
  });
}
