// @ts-check
/** Begins to inspect; where that has to wait, with a picture of the scene in the meantime. */
import { parseAddress } from "./address.js";
import { draw } from "./draw.js";
import { asked, waits } from "./patience.js";
import { fetchJson, loadEnvironment } from "./scenes.js";

async function drawPoster() {
  const catalogue = await fetchJson("catalogue.json"), { task, variant, seed } = parseAddress(location.hash, catalogue);
  const { scenes } = await loadEnvironment(task, variant), entry = scenes.find((one) => one.seed === seed) ?? scenes[0];
  const canvas = /** @type {HTMLCanvasElement} */ (document.getElementById("poster"));
  canvas.hidden = false;
  draw(canvas, catalogue.look, entry.scene, "allo");
}

const message = /** @type {HTMLElement} */ (document.getElementById("message")), loading = message.textContent;
if (waits) {
  message.textContent = "";
  drawPoster().catch(() => {});  // whoever starts is told
}
await asked;
message.textContent = loading;
await import("./inspect.js");
