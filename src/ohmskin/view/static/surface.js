// A canvas that is as sharp as the screen and knows its size in CSS pixels.

export class Surface {
  /** height(width) gives the height (px) that follows from a width; without it the style sheet decides. */
  constructor(canvas, changed, height = null) {
    this.canvas = canvas;
    this._height = height;
    this._context = canvas.getContext("2d");
    this.width = 0;
    this.height = 0;
    new ResizeObserver(() => {
      this.fit();
      changed();
    }).observe(canvas);
    this.fit();
  }

  fit() {
    if (this._height) this.canvas.style.height = `${this._height(this.canvas.clientWidth)}px`;
    this.width = this.canvas.clientWidth;
    this.height = this.canvas.clientHeight;
    const density = devicePixelRatio;
    const [w, h] = [Math.round(this.width * density), Math.round(this.height * density)];
    if (this.canvas.width !== w || this.canvas.height !== h) [this.canvas.width, this.canvas.height] = [w, h];
  }

  /** Call draw(context, width, height) unless the canvas has no room. */
  draw(draw) {
    if (!this.canvas.width || !this.canvas.height) return;
    this._context.setTransform(this.canvas.width / this.width, 0, 0, this.canvas.height / this.height, 0, 0);
    draw(this._context, this.width, this.height);
  }
}
