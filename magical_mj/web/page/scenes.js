// @ts-check
/**
 * The scenes of an environment, and their simulation in the browser.
 * @typedef {import("./scene.js").Scene} Scene
 * @typedef {import("./game.js").Episode} Episode
 * @typedef {{seed: number, scene: Scene, expert: string | number[][], mjcf?: number[], shifts?: string, horizon?: number, taken?: number[][],
 *   goal?: import("./goal.js").Goal, rivals?: {sentence: string, goal: import("./goal.js").Goal}[]}} Entry
 *   a scene, an expert's actions in it (letters, or vectors of speeds), the indices of its model's elements,
 *   its shifts, its horizon if its body has another one, and the executed actions with slip or latency (see `taking`), a list for each;
 *   goal, rivals: of a puzzle
 * @typedef {{scenes: Entry[], horizon: number, elements?: string[], demonstrations: string[], puzzle?: import("./puzzles.js").Puzzle}} Environment
 *   horizon: actions of an episode; demonstrations: actions in its only scene
 * @typedef {(environment: Environment, entry: {seed: number, mjcf?: number[], scene: Scene | null, taken?: number[][]}, task: string, variant: string) => Promise<Episode>} Opener
 */
import { taking } from "./actions.js";
import { loadMujoco } from "./mujoco.js";
import { Simulation } from "./simulation.js";

/**
 * An environment's scenes.
 * @param {string} task
 * @param {string} variant
 * @param {string} [shifts]  shifts with their strengths, such as "clutter:3,friction:2", or another body, such as "body:longstick"
 * @returns {Promise<Environment>}
 */
export async function loadEnvironment(task, variant, shifts = "") {
  const names = shifts.split(",").filter(Boolean), placed = names.find((name) => !isChange(name)) ?? "";
  const others = names.filter((name) => name !== placed);
  const [all, changes] = await Promise.all([
    fetchJson(placed ? `shifted/${task}-${variant}-${placed.split(":")[0]}.json` : `${task.startsWith(PUZZLE) ? "puzzles" : "scenes"}/${task}-${variant}.json`),
    others.length ? fetchJson(`shifted/${task}-${variant}.json`) : null,
  ]);
  const scenes = placed ? all.scenes.filter((/** @type {Entry} */ entry) => entry.shifts === placed) : all.scenes;
  return changes ? changed({ ...all, scenes }, names.join("+"), others, changes) : { ...all, scenes };
}

/** The names of puzzles begin with this. */
const PUZZLE = "Intent";

/** Whether a shift changes numbers of the model, or the actions, so that any scene can have it. @param {string} shift  or its axis */
export const isChange = (shift) => ["latency", "slip", "friction"].includes(shift.split(":")[0]);

/**
 * The effects of such shifts in any scene: changed dynamics, and the executed actions, a list for each shift.
 * @param {string} task @param {string} variant @param {number} seed @param {string} shifts
 * @returns {Promise<{dynamics?: Record<string, number>, taken?: number[][]}>}
 */
export async function effectsOf(task, variant, seed, shifts) {
  if (!shifts) return {};
  const all = await fetchJson(`shifted/${task}-${variant}.json`), of = all[seed] ?? all[0], effects = shifts.split(",").map((name) => of[name]);
  return joined(effects);
}

/** @param {Change[]} effects */
const joined = (effects) => ({ dynamics: Object.assign({}, ...effects.map(({ dynamics }) => dynamics)), taken: effects.flatMap(({ taken }) => taken ? [taken] : []) });

/**
 * An environment with changed dynamics, or changed actions.
 * @param {Environment} environment @param {string} label  all its shifts
 * @param {string[]} names  those to apply, in order @param {Record<string, Record<string, Change>>} changes  seed -> shift -> its effects
 * @returns {Environment}
 * @typedef {{dynamics?: Record<string, number>, attributes?: Record<string, Record<string, string>>, taken?: number[]}} Change
 *   attributes: element of the model -> its changed attributes
 */
function changed(environment, label, names, changes) {
  const elements = [...environment.elements ?? []], all = environment.scenes;
  const scenes = Object.entries(changes).flatMap(([seed, of]) => {
    const entry = all.find((one) => one.seed === Number(seed)) ?? (all.length === 1 ? all[0] : null);  // Demo has one scene
    if (!entry) return [];
    const effects = names.map((name) => of[name]), { dynamics, taken } = joined(effects);
    const scene = /** @type {Scene} */ ({ ...entry.scene, dynamics: { ...entry.scene.dynamics, ...dynamics } });
    const attributes = effects.reduce((/** @type {Record<string, Record<string, string>>} */ sum, effect) => {
      for (const [name, values] of Object.entries(effect.attributes ?? {})) sum[name] = { ...sum[name], ...values };
      return sum;
    }, { "text seed": { data: seed }, "text shifts": { data: label } });
    const mjcf = entry.mjcf?.map((i) => elements.push(withAttributes(elements[i], attributes, scene, label)) - 1);
    return [{ ...entry, seed: Number(seed), shifts: label, scene, mjcf, expert: "", taken }];
  });
  return { ...environment, scenes, elements };
}

/**
 * An element of a model, as text, with other attributes.
 * @param {string} element @param {Record<string, Record<string, string>>} attributes @param {Scene} scene @param {string} label
 */
function withAttributes(element, attributes, scene, label) {
  const [, tag, name] = /<(\w+)\b[^>]*?\sname="([^"]*)"/.exec(element) ?? [];
  if (name === "scene") return element.replace(/"dynamics":\{[^}]*\}/, () => `"dynamics":${JSON.stringify(scene.dynamics)}`);
  const values = Object.entries(attributes[`${tag} ${name}`] ?? {});
  const text = values.reduce((text, [key, value]) => text.replace(new RegExp(`(\\s${key}=)"[^"]*"`), (_, start) => `${start}"${value}"`), element);
  return name === "seed" && !label.match(/pose|clutter|body/) ? `${text}\n    <text name="shifts" data="${label}"/>` : text;
}

/** @param {string} path  relative to the page */
export const fetchJson = async (path) => (await fetched(path)).json();

/** @param {string} path  relative to the page */
export const fetchText = async (path) => (await fetched(path)).text();

/** @param {string} path  relative to the page */
export const fetchFile = async (path) => new Uint8Array(await (await fetched(path)).arrayBuffer());

/** @param {string} path */
async function fetched(path) {
  const reply = await fetch(path).catch(() => null);
  if (!reply?.ok) throw new Error(`${path} could not be loaded${reply ? ` (${reply.status})` : ""}`);
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
    const steps = taken?.map(taking) ?? [];
    return { scene, act: (action) => simulation.act(steps.reduce((now, step) => step(Number(now)), action)), close: () => simulation.close(), simulation };
  };
}
