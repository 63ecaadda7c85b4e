// Electrodes that are placed by clicking on the skin in space; the server keeps and numbers them, and writes the file.

import { BodyView } from "./body.js";
import { number } from "./colour.js";
import { openShownSocket } from "./link.js";

const byId = (id) => document.getElementById(id);
window.ohmskin = { body: null, state: null };
let [skin, socket] = [null, null];

const say = (...words) => socket?.readyState === WebSocket.OPEN && socket.send(words.join(" "));
const metres = (place) => place.map((v) => v.toFixed(6));

function draw() {
  const { electrodes } = window.ohmskin.state;
  const marks = electrodes.map(({ at, normal }, which) => ({ at, normal, text: String(which), radius: skin.radius }));
  const patch = { ...skin, link: "skin", virtual: true, age: 0, peak: 0, contacts: [], marks };
  patch.pixels = new Int8Array(skin.count);
  window.ohmskin.body?.show([patch], true, 1, document.documentElement.dataset.theme, 1, 0.5);
  skin.points = undefined; // told once
}

function list({ electrodes, note, savable, saved }) {
  byId("summary").textContent = `${electrodes.length} electrodes`;
  byId("electrodes").replaceChildren(
    ...electrodes.map(({ x, y }, which) => {
      const line = document.createElement("li");
      const remove = document.createElement("button");
      remove.textContent = "Remove";
      remove.setAttribute("aria-label", `Remove electrode ${which}`);
      remove.onclick = () => say("remove", which);
      line.append(`${number(1000 * x, 1)}, ${number(1000 * y, 1)} mm `, remove);
      return line;
    }),
  );
  byId("save").disabled = !savable;
  byId("note").hidden = !note && !saved;
  byId("note").dataset.kind = saved ? "hint" : "warn";
  byId("note").textContent = saved ? `Saved ${saved}` : note;
}

function begin(told) {
  byId("name").textContent = told.name;
  byId("save").textContent = `Save ${told.target.split("/").pop()}`;
  skin = { ...told, count: told.points.length };
  const remove = (_, which) => which && say("remove", which);
  const pick = (at) => say("click", ...metres(at));
  try {
    window.ohmskin.body ??= new BodyView(byId("space"), byId("labels"), told.robot, remove, pick);
  } catch (error) {
    console.warn(error); // a browser without WebGL has the list
  }
}

function connect() {
  socket = openShownSocket(connect);
  socket.onmessage = (event) => {
    const told = JSON.parse(event.data);
    if (told.points) begin(told);
    window.ohmskin.state = told;
    list(told);
    draw();
  };
}

byId("add").onsubmit = (event) => {
  event.preventDefault();
  say("place", ...metres([byId("x").value / 1000, byId("y").value / 1000]));
};
byId("clear").onclick = () => say("clear");
byId("save").onclick = () => say("save");
connect();
