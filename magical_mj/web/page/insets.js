// @ts-check
/** The places of the pictures of a model's cameras in the view. The visitor can drag them. */
const SHARE = 0.24, LARGEST = 200, GAP = 8;  // of the canvas's larger side; pixels

export class Insets {
  /** @type {{left: number, top: number}[]} where the visitor put them, as shares of the free width and height */ #moved = [];

  /** @param {HTMLCanvasElement} canvas @param {() => number} count  how many are shown @param {() => void} changed  called when they move */
  constructor(canvas, count, changed) {
    this.canvas = canvas;
    canvas.addEventListener("pointerdown", (event) => {
      const index = this.places(count()).findIndex(({ left, top, side }) =>
        left <= event.offsetX && event.offsetX <= left + side && top <= event.offsetY && event.offsetY <= top + side);
      if (index < 0) return;
      event.stopImmediatePropagation();  // the view stays
      canvas.setPointerCapture(event.pointerId);
      const { left, top, side } = this.places(count())[index];
      const move = (/** @type {PointerEvent} */ { offsetX, offsetY }) => {
        const share = (/** @type {number} */ value, /** @type {number} */ size) => Math.min(1, Math.max(0, value / (size - side)));
        this.#moved[index] = { left: share(left + offsetX - event.offsetX, canvas.clientWidth), top: share(top + offsetY - event.offsetY, canvas.clientHeight) };
        changed();
      };
      const end = (/** @type {Event} */ ended) => {
        ended.stopImmediatePropagation();
        canvas.removeEventListener("pointermove", move);
        for (const kind of ["pointerup", "pointercancel"]) canvas.removeEventListener(kind, end, true);
      };
      canvas.addEventListener("pointermove", move);
      for (const kind of ["pointerup", "pointercancel"]) canvas.addEventListener(kind, end, true);
    });
  }

  /** Squares, at first one below the other in the upper right corner, in pixels. @param {number} count */
  places(count) {
    const { clientWidth: width, clientHeight: height } = this.canvas, side = Math.min(LARGEST, SHARE * Math.max(width, height), 0.45 * width, 0.45 * height);
    return Array.from({ length: count }, (_, index) => {
      const moved = this.#moved[index];
      return moved ? { left: moved.left * (width - side), top: moved.top * (height - side), side } : { left: width - GAP - side, top: GAP + index * (side + GAP), side };
    });
  }
}
