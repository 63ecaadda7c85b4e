// Runs before the first paint, so that a dark page never flashes white. The style sheet knows only [data-theme].
"use strict";
(() => {
  let chosen = null;
  try {
    chosen = localStorage.getItem("ohmskin-theme");
  } catch {
    // storage may be forbidden; the system's preference then holds for this visit
  }
  const dark = chosen ? chosen === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  document.documentElement.dataset.theme = dark ? "dark" : "light";
})();
