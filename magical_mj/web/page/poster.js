// @ts-check
/** Starts the inspection. If it has to wait, shows a picture of the scene meanwhile, and lists to choose another one. */
import { addressOf, parseAddress } from "./address.js";
import { onChoice, showAddress, showChoice } from "./choice.js";
import { draw } from "./draw.js";
import { linkedScene } from "./edited.js";
import { asked, waits } from "./patience.js";
import { fetchJson, loadEnvironment } from "./scenes.js";

/** @typedef {import("./address.js").SceneId} SceneId */
const message = /** @type {HTMLElement} */ (document.getElementById("message")), loading = message.textContent;
const begun = new AbortController();

async function wait() {
  message.textContent = "";
  const catalogue = await fetchJson("catalogue.json");
  const show = async (/** @type {SceneId} */ sceneId, isNew = true, unknown = "") => {
    showAddress(`#${addressOf(sceneId)}`, isNew);
    showChoice(catalogue, sceneId);
    message.textContent = unknown;
    message.classList.toggle("wrong", unknown !== "");
    const { scenes } = await loadEnvironment(sceneId.task, sceneId.variant, sceneId.shifts);
    const scene = sceneId.scene ? linkedScene(sceneId.scene, catalogue) : (scenes.find(({ seed }) => seed === sceneId.seed) ?? scenes[0]).scene;
    if (!begun.signal.aborted) drawPoster(catalogue.look, scene);
  };
  const showHash = () => {
    const { unknown, ...sceneId } = parseAddress(location.hash, catalogue);
    return show(sceneId, false, unknown);
  };
  onChoice(catalogue, show);
  if (catalogue.model || location.hash === "#file") return;  // it is not a scene of the benchmark
  addEventListener("hashchange", showHash, begun);
  await showHash();
}

/** @param {import("./draw.js").Look} look @param {import("./scene.js").Scene} scene */
function drawPoster(look, scene) {
  const canvas = /** @type {HTMLCanvasElement} */ (document.getElementById("poster"));
  canvas.hidden = false;
  draw(canvas, look, scene, "allo");
}

if (waits) wait();
await asked;
begun.abort();
message.textContent = loading;
message.classList.remove("wrong");
await import("./inspect.js");
