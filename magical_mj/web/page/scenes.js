// @ts-check
/**
 * The scenes of an environment, and their simulation in the browser.
 * @typedef {import("./scene.js").Scene} Scene
 * @typedef {import("./game.js").Episode} Episode
 * @typedef {{seed: number, scene: Scene, expert: string | number[][], mjcf?: number[], shifts?: string, horizon?: number, taken?: number[]}} Entry
 *   a scene, an expert's actions in it (letters, or vectors of speeds), the indices of its model's elements,
 *   its shifts, its horizon if its body has another one, and the executed actions with slip or latency (see `taking`)
 * @typedef {{scenes: Entry[], horizon: number, elements?: string[], demonstrations: string[]}} Environment
 *   horizon: actions of an episode; demonstrations: actions in its only scene
 * @typedef {(environment: Environment, entry: {seed: number, mjcf?: number[], scene: Scene | null, taken?: number[]}, task: string, variant: string) => Promise<Episode>} Opener
 */
import { taking } from "./actions.js";
import { loadMujoco } from "./mujoco.js";
import { Simulation } from "./simulation.js";

/**
 * An environment's scenes.
 * @param {string} task
 * @param {string} variant
 * @param {string} [shifts]  a shift with its strength, such as "clutter:3", or another body, such as "body:longstick"
 * @returns {Promise<Environment>}
 */
export async function loadEnvironment(task, variant, shifts = "") {
  if (!shifts) return fetchJson(`scenes/${task}-${variant}.json`);
  const all = await fetchJson(`shifted/${task}-${variant}-${shifts.split(":")[0]}.json`);
  return { ...all, scenes: all.scenes.filter((/** @type {Entry} */ entry) => entry.shifts === shifts) };
}

/** @param {string} path  relative to the page */
export const fetchJson = async (path) => (await fetched(path)).json();

/** @param {string} path  relative to the page */
export const fetchFile = async (path) => new Uint8Array(await (await fetched(path)).arrayBuffer());

/** @param {string} path */
async function fetched(path) {
  const reply = await fetch(path).catch(() => null);
  if (!reply?.ok) throw new Error(`${path} could not be loaded${reply ? ` (${reply.status})` : ""}: try again`);
  return reply;
}

/**
 * Simulates in the browser, with MuJoCo's WebAssembly build.
 * @param {Promise<void>} asked  resolves when it may be loaded
 * @returns {Opener}
 */
export function inBrowser(asked) {
  asked.then(loadMujoco).catch(() => {});  // the error is shown when a scene is opened
  return async ({ elements = [] }, { scene, mjcf = [], taken }) => {
    if (!scene) throw new Error("this scene is not available here");
    const simulation = new Simulation(await loadMujoco(), mjcf.map((i) => elements[i]).join(""), scene);
    const done = taken && taking(taken);
    return { scene, act: (action) => simulation.act(done ? done(Number(action)) : action), close: () => simulation.close(), simulation };
  };
}
