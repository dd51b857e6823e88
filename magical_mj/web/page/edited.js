// @ts-check
/** Scenes that the visitor changed, and the way to the editor, which is loaded with its first use. */
import { addressOf } from "./address.js";
import { mjcfOf } from "./mjcf.js";
import { readScene } from "./scenefile.js";
import { fetchText, loadEnvironment } from "./scenes.js";
import { lack } from "./score.js";

/** @typedef {import("./scene.js").Scene} Scene @typedef {import("./address.js").SceneId} SceneId */

/** The scene in an address. @param {string} text @param {any} catalogue @returns {Scene} */
export function linkedScene(text, { look, solids }) {
  const scene = readScene(text, Object.keys(solids.robots));
  if (!look.arenas[scene.half_width ?? 1]) throw new Error(`This page has no arena of half width ${scene.half_width}`);
  return scene;
}

/** The environment whose horizon and policies an edited scene has: with the same body. @param {SceneId} sceneId @param {Scene} scene */
export async function environmentOf({ task, variant }, { robot }) {
  const environment = await loadEnvironment(task, variant, (robot.body ?? "gripper") === "gripper" ? "" : `body:${robot.body}`);
  return { ...environment, horizon: environment.scenes[0].horizon ?? environment.horizon };
}

/** The model of an edited scene, as MJCF. A scene of the task is an episode of it. @param {any} catalogue @param {SceneId} sceneId @param {Scene} scene */
export async function editedModel({ look, tasks }, sceneId, scene) {
  const { task } = sceneId, { robot, half_width: half = 1 } = scene;
  const [sample, { horizon }] = await Promise.all([fetchText(`samples/${robot.body ?? "gripper"}-${half}.xml`), environmentOf(sceneId, scene)]);
  return mjcfOf(sample, scene, look.regions, lack(task, scene) ? {} : { task, horizon, speeds: tasks[task].speeds });
}

/**
 * Opens the editor.
 * @param {any} catalogue @param {SceneId} sceneId  the task, and what to name in addresses @param {Scene} scene
 * @param {string} action  the label of the button that ends editing @param {(scene: string | null) => void} done  called with JSON; null: unchanged
 */
export async function edit(catalogue, sceneId, scene, action, done) {
  const { task } = sceneId, { Editor } = await import("./editor.js").catch(() => {  // browsers do not try it again
    throw new Error("The editor could not be loaded. Reload the page to try again");
  });
  const address = (/** @type {string} */ text) => new URL(`#${addressOf({ ...sceneId, scene: text })}`, location.href).href;
  new Editor({ catalogue, scene, task, name: `${task}-edited`, action, address, model: (changed) => editedModel(catalogue, sceneId, changed), done });
}
