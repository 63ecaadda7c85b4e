// Runs before the first paint, so that a dark page never flashes white. The style sheet knows only [data-theme].
"use strict";
(() => {
  let chosen = null;
  try {
    chosen = localStorage.getItem("ohmskin-theme");
  } catch {
    // storage may be forbidden; the system's preference then holds for this visit
  }
  const system = matchMedia("(prefers-color-scheme: dark)");
  const show = (dark) => {
    document.documentElement.dataset.theme = dark ? "dark" : "light";
  };
  show(chosen ? chosen === "dark" : system.matches);
  if (!chosen) system.addEventListener("change", () => show(system.matches));
})();
