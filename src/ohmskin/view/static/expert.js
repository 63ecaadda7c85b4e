// The expert's choices: estimator, prior and rule for the regularisation parameter.

const NAMES = ["estimator", "prior", "rule"];
const HOLD = 500; // ms after a choice in which older frames do not take it back

const byId = (id) => document.getElementById(id);

export class Expert {
  constructor(send) {
    for (const name of NAMES) {
      byId(name).onchange = () => {
        this._chosen = performance.now();
        send({ type: "estimator", ...Object.fromEntries(NAMES.map((each) => [each, byId(each).value])) });
      };
    }
  }

  showSetup(choices) {
    byId("expert").hidden = !choices;
    for (const name of NAMES) {
      byId(name).replaceChildren(
        ...(choices?.[name] ?? []).map((choice) => {
          const option = new Option(choice.name);
          option.title = choice.title;
          return option;
        }),
      );
    }
  }

  showHeader(header) {
    if (header.preparing || performance.now() - this._chosen < HOLD) return;
    for (const name of NAMES) {
      const select = byId(name);
      if (header[name] && select.value !== header[name]) select.value = header[name];
      select.title = select.selectedOptions[0]?.title ?? "";
    }
  }
}
