// The page's buttons and sliders: what they say, what they send.

import { Expert } from "./expert.js";

const SCALE = [0.001, 10000]; // least and largest value of the colour scale

const byId = (id) => document.getElementById(id);

/** A range slider from `least` to `largest`, in equal ratios where the span is wide. */
class Slider {
  constructor(id, unit, factor, changed) {
    this._input = byId(id);
    this._output = byId(`${id}-value`);
    this._unit = unit;
    this._factor = factor;
    this._input.addEventListener("input", () => {
      this._show();
      changed();
    });
  }

  setLimits([least, largest, usual]) {
    const same = this._limits && this._limits[0] === least && this._limits[1] === largest;
    this._limits = [least, largest];
    this._ratio = least > 0 && largest / least >= 20;
    if (!same) this._input.value = Math.round(1000 * this._share(usual));
    this._show();
  }

  /** To two digits, as it is shown. */
  get value() {
    const [least, largest] = this._limits;
    const share = this._input.valueAsNumber / 1000;
    const value = this._ratio ? least * (largest / least) ** share : least + share * (largest - least);
    return Math.min(largest, Math.max(least, Number(value.toPrecision(2))));
  }

  _share(value) {
    const [least, largest] = this._limits;
    if (largest === least) return 0;
    return this._ratio ? Math.log(value / least) / Math.log(largest / least) : (value - least) / (largest - least);
  }

  _show() {
    const shown = this._factor * this.value;
    const text = `${shown.toFixed(shown < 10 ? 1 : 0)} ${this._unit}`;
    this._output.textContent = text;
    this._input.setAttribute("aria-valuetext", text);
  }
}

function element(kind, text) {
  const made = document.createElement(kind);
  made.textContent = text;
  return made;
}

export class Controls {
  /** page: { send(command), touch, range, header(), save(), changed(), refuse(text) } */
  constructor(page) {
    this._page = page;
    this._expert = new Expert(page.send);
    this._pressure = new Slider("pressure", "kPa", 1e-3, () => page.touch.applySettings());
    this._radius = new Slider("radius", "mm", 1e3, () => page.touch.applySettings());
    byId("calibrate").onclick = () => page.send({ type: "calibrate" });
    byId("pause").onclick = () => page.send({ type: "pause", paused: page.header()?.state !== "paused" });
    byId("demo").onclick = () => page.send({ type: "demo", on: !page.header()?.demo });
    byId("save").onclick = () => page.save();
    byId("clear").onclick = () => page.touch.liftAll();
    byId("hold").onclick = () => {
      page.touch.hold = !page.touch.hold;
      byId("hold").setAttribute("aria-pressed", page.touch.hold);
    };
    byId("injections").oninput = () => {
      this._showBudget(byId("injections").valueAsNumber);
      this._budgetSent = performance.now();
      page.send({ type: "injections", count: byId("injections").valueAsNumber });
    };
    byId("theme").onclick = () => this._switchTheme();
    byId("range-auto").onchange = () => {
      page.range.auto = byId("range-auto").checked;
      byId("range").disabled = page.range.auto;
      page.range.restart();
      page.changed();
    };
    const input = byId("range");
    const valid = () => input.valueAsNumber >= SCALE[0] && input.valueAsNumber <= SCALE[1];
    input.oninput = () => {
      input.setAttribute("aria-invalid", !valid());
      if (valid()) page.range.limit = input.valueAsNumber;
      page.changed();
    };
    input.onchange = () => {
      if (valid()) return;
      page.refuse(`not done: the scale must be from ${SCALE.join(" to ")} ${byId("range-unit").textContent}`);
      input.setAttribute("aria-invalid", false);
      input.value = Number(page.range.limit.toPrecision(6));
    };
  }

  get press() {
    return { radius: this._radius.value, pressure: this._pressure.value };
  }

  showSetup(setup) {
    const virtual = setup.press !== null;
    document.documentElement.dataset.virtual = virtual;
    byId("version").textContent = setup.version ?? "";
    byId("skin-name").textContent = setup.skin.name;
    byId("device").textContent = setup.device?.url ?? "";
    byId("range-unit").textContent = setup.unit;
    if (virtual) {
      this._pressure.setLimits(setup.press.pressure);
      this._radius.setLimits(setup.press.radius);
    }
    byId("modes").replaceChildren(...setup.modes.map((mode) => this._modeButton(mode)));
    // All sentences lie on each other and all but one are unseen: room for the longest, and nothing moves.
    byId("mode-summary").replaceChildren(...setup.modes.map((mode) => element("span", mode.summary ?? "")));
    this._titles = new Map(setup.modes.map((mode) => [mode.name, mode.title]));
    this._budgets = new Map(setup.modes.map((mode) => [mode.name, mode.injections]));
    document.documentElement.dataset.budget = setup.modes.some((mode) => mode.injections);
    this._shownMode = null;
    this._expert.showSetup(setup.choices);
  }

  title(mode) {
    return this._titles.get(mode) ?? "";
  }

  showHeader(header) {
    if (header.mode !== this._shownMode) {
      this._shownMode = header.mode;
      for (const [place, button] of [...byId("modes").children].entries()) {
        const shown = button.dataset.mode === header.mode;
        button.setAttribute("aria-pressed", shown);
        delete button.dataset.wanted;
        byId("mode-summary").children[place].toggleAttribute("data-shown", shown);
      }
    }
    this._expert.showHeader(header);
    const budget = this._budgets.get(header.mode);
    byId("injections").disabled = !budget;
    if (!budget) byId("injections-value").textContent = "fixed";
    // for a moment after a change the slider stays where the finger put it
    if (budget && !(performance.now() - this._budgetSent < 500)) {
      [byId("injections").min, byId("injections").max] = budget;
      byId("injections").value = header.n_injections ?? budget[0];
      this._showBudget(byId("injections").valueAsNumber);
    }
    const paused = header.state === "paused";
    byId("pause").setAttribute("aria-pressed", paused);
    byId("pause").textContent = paused ? "Resume" : "Pause";
    byId("demo").setAttribute("aria-pressed", Boolean(header.demo));
  }

  _showBudget(count) {
    byId("injections-value").textContent = `${count} / frame`;
  }

  showRange(range) {
    if (range.auto) byId("range").value = Number(range.limit.toPrecision(6));
  }

  _modeButton(mode) {
    const button = document.createElement("button");
    button.type = "button";
    button.dataset.mode = mode.name;
    button.append(element("span", mode.title), " ", ...(mode.title === mode.name ? [] : [element("small", mode.name)]));
    button.setAttribute("aria-pressed", "false");
    button.title = mode.summary ?? "";
    if (!mode.available) {
      // Not `disabled`: the reason must be reachable by keyboard and screen reader too.
      button.setAttribute("aria-disabled", "true");
      const why = mode.why_not || "not available";
      button.setAttribute("aria-description", why);
      button.title = why;
      button.onclick = () => this._page.refuse(`not done: ${mode.title} (${mode.name}) ${why}`); // for fingers
      return button;
    }
    button.onclick = () => {
      if (button.getAttribute("aria-pressed") === "true") return;
      for (const other of byId("modes").children) delete other.dataset.wanted;
      button.dataset.wanted = "";
      this._page.send({ type: "mode", mode: mode.name });
    };
    return button;
  }

  _switchTheme() {
    const theme = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
    document.documentElement.dataset.theme = theme;
    try {
      localStorage.setItem("ohmskin-theme", theme);
    } catch {
      // storage may be forbidden; the choice then holds until the page is left
    }
    this._page.changed();
  }
}
