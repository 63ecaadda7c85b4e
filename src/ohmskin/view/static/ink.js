// Colours and font of all that is drawn, for either theme, and how lines stand out from an image.

export const INK = {
  dark: {
    paper: "#0e1116",
    text: "#e9edf3",
    quiet: "#9aa5b5",
    rim: "#55606f",
    halo: "rgb(6 8 12 / .85)",
    pill: "rgb(14 17 22 / .8)",
    pair: "rgb(110 231 214 / .5)",
    contact: "#ffffff",
    press: "#6fd3ff",
    other: "#c6b4ff",
    electrode: "#dbe3ee",
    bad: "#ff6b6b",
    doubt: "#ffc247",
    hair: "rgb(255 255 255 / .16)",
    felt: "#ffa25c",
    base: "#7f9bc4",
    threshold: "#9aa5b5",
    grid: "#242b36",
    accent: "#6fd3ff",
  },
  light: {
    paper: "#ffffff",
    text: "#151a21",
    quiet: "#586474",
    rim: "#8c97a6",
    halo: "rgb(255 255 255 / .9)",
    pill: "rgb(255 255 255 / .86)",
    pair: "rgb(0 116 122 / .45)",
    contact: "#10151c",
    press: "#0057c2",
    other: "#6a35c9",
    electrode: "#2b3441",
    bad: "#c81e1e",
    doubt: "#b45f00",
    hair: "rgb(0 0 0 / .15)",
    felt: "#c2410c",
    base: "#5876a6",
    threshold: "#586474",
    grid: "#e6eaef",
    accent: "#0057c2",
  },
};

export const FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif';

/** Stroke the path in a colour, perhaps dashed, over a wider halo. */
export function strokeOver(c, halo, wide, colour, width, dash = []) {
  c.lineWidth = wide;
  c.strokeStyle = halo;
  c.stroke();
  c.setLineDash(dash);
  c.lineWidth = width;
  c.strokeStyle = colour;
  c.stroke();
  c.setLineDash([]);
}
