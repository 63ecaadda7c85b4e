// Labels over a picture of a body: inside it, off each other and off contacts.

const [CHARACTER, LINE, PAD, EDGE, MARK] = [7, 17, 12, 2, 9]; // px

/**
 * Where the anchors [x, y] of labels { x, y, text, begins } go in a picture of [width, height] px, so that all is seen:
 * the middle of the left side of a label that `begins` there, else its middle. A label moves down where it would cover
 * one of the `contacts` { x, y } or an earlier label.
 */
export function placed(labels, [width, height], contacts = []) {
  const boxes = contacts.map(({ x, y }) => ({ left: x - MARK, top: y - MARK, w: 2 * MARK, h: 2 * MARK }));
  return labels.map(({ x, y, text, begins }) => {
    const lines = text.split("\n");
    const [w, h] = [CHARACTER * Math.max(...lines.map((line) => line.length)) + PAD, LINE * lines.length];
    const within = (at, size, all) => Math.max(EDGE, Math.min(at, all - size - EDGE));
    const left = within(begins ? x : x - w / 2, w, width);
    let top = within(y - h / 2, h, height);
    for (const box of boxes.sort((a, b) => a.top - b.top))
      if (left < box.left + box.w && box.left < left + w && top < box.top + box.h && box.top < top + h)
        top = box.top + box.h;
    boxes.push({ left, top, w, h });
    return [begins ? left : left + w / 2, top + h / 2];
  });
}
