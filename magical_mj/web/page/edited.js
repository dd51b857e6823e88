// @ts-check
/** Scenes that the visitor changed, and the way to the editor, which is loaded with its first use. */
import { addressOf } from "./address.js";
import { mjcfOf } from "./mjcf.js";
import { readScene } from "./scenefile.js";
import { effectsOf, fetchText, loadEnvironment } from "./scenes.js";
import { lack } from "./score.js";

/** @typedef {import("./scene.js").Scene} Scene @typedef {import("./address.js").SceneId} SceneId */

/** The scene in an address. @param {string} text @param {any} catalogue @returns {Scene} */
export function linkedScene(text, { look, solids }) {
  const scene = readScene(text, Object.keys(solids.robots));
  if (!look.arenas[scene.half_width ?? 1]) throw new Error(`This page has no arena of half width ${scene.half_width}`);
  return scene;
}

/**
 * The environment of an edited scene, with this scene only: with its body, and the shifts that any scene can have.
 * @param {any} catalogue @param {SceneId} sceneId @param {Scene} scene @returns {Promise<import("./scenes.js").Environment>}
 */
export async function editedEnvironment({ look, tasks }, { task, variant, seed, shifts }, scene) {
  const { body = "gripper" } = scene.robot, half = scene.half_width ?? 1;
  if (shifts && body !== "gripper") throw new Error("Changed scenes with another body have no shifts here");
  const [sample, environment, { dynamics, taken }] = await Promise.all([
    fetchText(`samples/${body}-${half}.xml`), loadEnvironment(task, variant, body === "gripper" ? "" : `body:${body}`), effectsOf(task, variant, seed, shifts)]);
  const horizon = environment.scenes[0].horizon ?? environment.horizon, changed = { ...scene, ...shifts && { dynamics: { ...scene.dynamics, ...dynamics } } };
  const model = mjcfOf(sample, changed, look.regions, lack(task, scene) ? {} : { task, horizon, speeds: tasks[task].speeds });
  return { ...environment, horizon, demonstrations: [], elements: [model], scenes: [{ seed, scene: changed, expert: "", mjcf: [0], taken }] };
}

/** The model of an edited scene, as MJCF. A scene of the task is an episode of it. @param {any} catalogue @param {SceneId} sceneId @param {Scene} scene */
export const editedModel = async (catalogue, sceneId, scene) => (await editedEnvironment(catalogue, sceneId, scene)).elements?.[0] ?? "";

/**
 * Opens the editor.
 * @param {any} catalogue @param {SceneId} sceneId  the goal, and what to name in addresses @param {Scene} scene
 * @param {string} action  the label of the button that ends editing @param {(scene: string | null) => void} done  called with JSON; null: unchanged
 */
export async function edit(catalogue, sceneId, scene, action, done) {
  const { task, intent } = sceneId, { Editor } = await import("./editor.js").catch(() => {  // browsers do not try it again
    throw new Error("The editor could not be loaded. Reload the page to try again");
  });
  const address = (/** @type {string} */ text) => new URL(`#${addressOf({ ...sceneId, scene: text })}`, location.href).href;
  new Editor({ catalogue, scene, task: intent ? "" : task, name: `${task}-edited`, action, address, model: (changed) => editedModel(catalogue, sceneId, changed), done });
}
