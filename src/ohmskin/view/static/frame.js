// Where a place on the skin is on a canvas.

export const MARGIN = 30; // px around the skin, room for electrode numbers
export const FOOT = 16; // px more below, room for the scale bar

/** Smallest box around a domain, [x_min, y_min, x_max, y_max] in metres. */
export function bounds(domain) {
  if (domain.kind === "polygon") {
    const [xs, ys] = [0, 1].map((axis) => domain.outline.map((corner) => corner[axis]));
    return [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)];
  }
  return domain.kind === "disc"
    ? [-domain.radius, -domain.radius, domain.radius, domain.radius]
    : [0, 0, domain.width, domain.height];
}

// The point of a closed line closest to (x, y).
function closestOn(corners, x, y) {
  let [best, least] = [corners[0], Infinity];
  corners.forEach(([x0, y0], i) => {
    const [x1, y1] = corners[(i + 1) % corners.length];
    const along = ((x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)) / ((x1 - x0) ** 2 + (y1 - y0) ** 2);
    const share = Math.min(1, Math.max(0, along));
    const at = [x0 + share * (x1 - x0), y0 + share * (y1 - y0)];
    const away = Math.hypot(at[0] - x, at[1] - y);
    if (away < least) [best, least] = [at, away];
  });
  return best;
}

function within(corners, x, y) {
  return corners.reduce((inside, [x0, y0], i) => {
    const [x1, y1] = corners[(i + 1) % corners.length];
    const crossed = y0 <= y !== y1 <= y && x < x0 + ((y - y0) * (x1 - x0)) / (y1 - y0);
    return crossed ? !inside : inside;
  }, false);
}

/** The point of the domain closest to (x, y). */
export function clampTo(domain, x, y) {
  const turn = domain.kind === "band" ? x - domain.width * Math.floor(x / domain.width) : x;
  const hole = domain.holes?.find((corners) => within(corners, turn, y));
  if (hole) return closestOn(hole, turn, y);
  if (domain.kind === "polygon") {
    return within(domain.outline, x, y) ? [x, y] : closestOn(domain.outline, x, y);
  }
  if (domain.kind === "disc") {
    const shrink = Math.min(1, domain.radius / Math.max(1e-12, Math.hypot(x, y)));
    return [x * shrink, y * shrink];
  }
  return [Math.min(domain.width, Math.max(0, turn)), Math.min(domain.height, Math.max(0, y))];
}

/** Lines [x, y, x, y] from one place to another, round a closed band the short way: across its seam, two. */
export function linesBetween(domain, from, to) {
  if (domain.kind !== "band" || Math.abs(to.x - from.x) * 2 <= domain.width) return [[from.x, from.y, to.x, to.y]];
  const [near, far] = to.x > from.x ? [0, domain.width] : [domain.width, 0];
  const share = (near - from.x) / (to.x - from.x + near - far);
  const y = from.y + share * (to.y - from.y);
  return [
    [from.x, from.y, near, y],
    [far, y, to.x, to.y],
  ];
}

export function contains(domain, x, y) {
  const [u, v] = clampTo(domain, x, y);
  return Math.hypot(u - x, v - y) < 1e-9;
}

/** Metres to pixels of a canvas of this size, and back. */
export class Frame {
  constructor(domain, width, height) {
    const [left, bottom, right, top] = bounds(domain);
    const room = [(width - 2 * MARGIN) / (right - left), (height - 2 * MARGIN - FOOT) / (top - bottom)];
    this.scale = Math.max(1, Math.min(...room));
    this._x = width / 2 - (this.scale * (left + right)) / 2;
    this._y = (height - FOOT) / 2 + (this.scale * (bottom + top)) / 2;
  }

  x(metres) {
    return this._x + this.scale * metres;
  }

  y(metres) {
    return this._y - this.scale * metres;
  }

  back(x, y) {
    return [(x - this._x) / this.scale, (this._y - y) / this.scale];
  }
}

/** Height of a map that is `width` pixels wide. */
export function heightFor(domain, width) {
  const [left, bottom, right, top] = bounds(domain);
  return Math.round(((width - 2 * MARGIN) * (top - bottom)) / (right - left) + 2 * MARGIN + FOOT);
}
