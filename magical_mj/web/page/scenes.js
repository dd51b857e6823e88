// @ts-check
/**
 * The scenes of an environment, and who simulates them.
 * @typedef {import("./scene.js").Scene} Scene
 * @typedef {import("./game.js").Episode} Episode
 * @typedef {{seed: number, scene: Scene, expert: string, mjcf?: number[]}} Entry
 *   a scene, the actions of an expert in it, and the numbers of the elements of which its model is made
 * @typedef {{scenes: Entry[], elements?: string[], demonstrations: string[]}} Environment
 *   demonstrations: actions in its only scene
 * @typedef {(environment: Environment, entry: {seed: number, mjcf?: number[], scene: Scene | null}, task: string, variant: string) => Promise<Episode>} Opener
 */
import { loadMujoco } from "./mujoco.js";
import { Simulation } from "./simulation.js";

/**
 * An environment's scenes.
 * @param {string} task
 * @param {string} variant
 * @returns {Promise<Environment>}
 */
export async function loadEnvironment(task, variant) {
  return fetchJson(`scenes/${task}-${variant}.json`);
}

/** @param {string} path  beside the page */
export async function fetchJson(path) {
  const reply = await fetch(path).catch(() => null);
  if (!reply?.ok) throw new Error(`${path} could not be loaded${reply ? ` (${reply.status})` : ""}: try again`);
  return reply.json();
}

/**
 * Simulates in the browser, with MuJoCo's WebAssembly build.
 * @param {Promise<void>} asked  when that may be loaded
 * @returns {Opener}
 */
export function inBrowser(asked) {
  asked.then(loadMujoco).catch(() => {});  // whoever opens a scene is told
  return async ({ elements = [] }, { scene, mjcf = [] }) => {
    if (!scene) throw new Error("there is no such scene here");
    const simulation = new Simulation(await loadMujoco(), mjcf.map((i) => elements[i]).join(""), scene);
    return { scene, act: (action) => simulation.act(action), close: () => simulation.close(), state: () => simulation.state() };
  };
}
