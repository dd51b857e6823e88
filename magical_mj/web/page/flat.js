// @ts-check
/** Draws scenes of the benchmark from above, for browsers without WebGL. It has the methods of `Stage`. */
import { readTexts } from "./comments.js";
import { draw } from "./draw.js";
import { addressesOf, sceneAt } from "./simulation.js";

export class FlatStage {
  slow = false;
  insets = false;
  /** @type {Record<string, boolean>} */ shown = {};
  /** @type {(() => import("./scene.js").Scene) | null} */ #now = null;

  /** @param {HTMLCanvasElement} canvas @param {import("./draw.js").Look} look */
  constructor(canvas, look) {
    this.canvas = canvas;
    this.look = look;
  }

  /** @param {import("./inspected.js").InspectedModel} inspected @param {string} text  its file */
  open({ mujoco, model, data }, text) {
    this.#now = null;
    const { scene } = readTexts(text);
    if (!scene) throw new Error("Without WebGL 2, this browser can draw only scenes of the benchmark.");
    const initial = JSON.parse(scene), addresses = addressesOf(mujoco, model, initial);
    this.#now = () => sceneAt(initial, addresses, data.qpos);
  }

  draw() {
    const { canvas } = this, side = Math.floor(Math.min(canvas.clientWidth, canvas.clientHeight) * devicePixelRatio);
    canvas.width = canvas.height = side;
    if (this.#now) draw(canvas, this.look, this.#now(), "allo");
  }

  /** Bodies cannot be highlighted in this picture. */
  select() {}

  /** Bodies are selected in the list. */
  bodyAt() {
    return -1;
  }

  /** The picture as a PNG. @returns {Promise<Blob>} */
  picture() {
    return new Promise((resolve, reject) => this.canvas.toBlob((blob) => blob ? resolve(blob) : reject(new Error("this browser cannot save the picture"))));
  }
}
