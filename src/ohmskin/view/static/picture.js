// "Save PNG": both maps, the colour bar and a caption, composed for a report.

import { heightFor } from "./frame.js";
import { FONT, INK } from "./ink.js";
import { drawMap, drawScale } from "./map.js";

const RESOLUTION = 2; // pixels of the picture per pixel of its layout
const [LARGE, SMALL, EDGE, HEAD, BAR] = [620, 420, 24, 84, 76];

/** Compose the picture; scenes as for drawMap (base may be null), scale as for drawScale. Gives a canvas. */
function compose({ felt, base, scale, title, caption, theme }) {
  const ink = INK[theme];
  const tall = heightFor(felt.skin.domain, LARGE);
  const [width, height] = [LARGE + BAR + 3 * EDGE + (base ? SMALL + EDGE : 0), HEAD + tall + EDGE];
  const canvas = document.createElement("canvas");
  canvas.width = RESOLUTION * width;
  canvas.height = RESOLUTION * height;
  const c = canvas.getContext("2d");
  c.scale(RESOLUTION, RESOLUTION);
  c.fillStyle = ink.paper;
  c.fillRect(0, 0, width, height);
  c.fillStyle = ink.text;
  c.font = `600 18px ${FONT}`;
  c.fillText(title, EDGE + 6, 34);
  c.fillStyle = ink.quiet;
  c.font = `13px ${FONT}`;
  c.fillText(caption, EDGE + 6, 56);
  const part = (x, y, w, h, draw) => {
    const layer = document.createElement("canvas");
    layer.width = RESOLUTION * w;
    layer.height = RESOLUTION * h;
    const inner = layer.getContext("2d");
    inner.scale(RESOLUTION, RESOLUTION);
    draw(inner, w, h);
    c.drawImage(layer, x, y, w, h);
  };
  const right = 3 * EDGE + LARGE + BAR;
  part(EDGE, HEAD, LARGE, tall, (inner, w, h) => drawMap(inner, w, h, felt));
  part(2 * EDGE + LARGE, HEAD, BAR, tall, (inner, w, h) => drawScale(inner, w, h, scale));
  if (!base) return canvas;
  part(right, HEAD + 24, SMALL, heightFor(base.skin.domain, SMALL), (inner, w, h) => drawMap(inner, w, h, base));
  c.fillStyle = ink.text;
  c.font = `600 13px ${FONT}`;
  c.fillText("Base scan", right + 30, HEAD + 16);
  return canvas;
}

/** Hand the picture to the reader as a file. */
function download(canvas, name) {
  canvas.toBlob((blob) => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(blob);
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  }, "image/png");
}

/** Save the maps of a frame as a picture; `unknown` says why nobody knows what touches the skin, if so. */
export function savePicture(setup, header, { felt, base, scale }, title, unknown) {
  const now = new Date();
  const stamp = new Date(now - 60000 * now.getTimezoneOffset()).toISOString().slice(0, 19);
  const { estimator, prior, rule } = header;
  const made = estimator ? `${estimator}, prior ${prior}, rule ${rule}    ` : "";
  const canvas = compose({
    felt: { ...felt, section: null, cursor: null },
    base: base && { ...base, section: null, cursor: null },
    scale,
    theme: felt.theme,
    title:
      `${setup.skin.name}: change of sheet conductivity (${setup.unit})` +
      (unknown ? `; contacts unknown: ${unknown}` : ""),
    caption:
      `${stamp.replace("T", "  ")}    ${header.mode}, ${title}    ` +
      `${made}frame ${header.sequence}    ohmskin ${setup.version}`,
  });
  download(canvas, `ohmskin-${header.mode}-${stamp.replaceAll(/[-:]/g, "").replace("T", "-")}.png`);
}
