// @ts-check
/** The buttons of an environment's scenes. Their pictures are drawn when they become visible. */
import { draw } from "./draw.js";

/** @typedef {import("./scene.js").Scene} Scene @typedef {Parameters<typeof draw>[1]} Look */

/** @type {WeakMap<Element, {look: Look, scene: Scene}>} */
const undrawn = new WeakMap();
const drawer = new IntersectionObserver((canvases) => {
  for (const { target, isIntersecting } of canvases) {
    const what = undrawn.get(target);
    if (!isIntersecting || !what) continue;
    drawer.unobserve(target);
    draw(/** @type {HTMLCanvasElement} */ (target), what.look, what.scene, "allo");
  }
}, { rootMargin: "200px" });

/** @param {{seed: number, scene: Scene}} entry @param {Look} look @param {() => void} onclick */
export function sceneButton({ seed, scene }, look, onclick) {
  const button = document.createElement("button"), canvas = document.createElement("canvas");
  canvas.width = canvas.height = 144;
  undrawn.set(canvas, { look, scene });
  drawer.observe(canvas);
  button.dataset.seed = String(seed);
  button.ariaLabel = `Scene ${seed}`;
  button.append(canvas, String(seed));
  button.onclick = onclick;
  return button;
}
