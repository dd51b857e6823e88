// @ts-check
/** The page: choosing a scene, playing in it, watching, saving. */
import { fromLetters } from "./actions.js";
import { Controls } from "./controls.js";
import { draw } from "./draw.js";
import { Game } from "./game.js";
import { recording, save } from "./recording.js";
import { fetchJson, inBrowser, loadEnvironment } from "./scenes.js";
import { score } from "./score.js";

/** @typedef {import("./scenes.js").Entry} Entry */

/** @param {string} id */
const element = (id) => /** @type {any} */ (document.getElementById(id));
const RATE = 8;  // actions a second
const arena = element("arena");
const controls = new Controls(arena, document.querySelectorAll("[data-command]"));
const catalogue = await fetchJson("catalogue.json");
const open = inBrowser(catalogue.controls);

/** What is on the page now. */
const shown = {
  task: "", variant: "", seed: -1, watching: false, frames: 0,
  /** @type {import("./scenes.js").Environment} */ environment: { scenes: [], demonstrations: [] },
  /** @type {Game | null} */ game: null,
};
let choices = 0;  // the last one wins, whatever was loaded in between

/**
 * Shows a scene and makes it ready to play.
 * @param {string} task
 * @param {string} variant
 * @param {number} seed
 * @param {string | null} script  actions to watch; null: the player's
 */
async function choose(task, variant, seed, script = null) {
  const choice = ++choices;
  const isOther = task !== shown.task || variant !== shown.variant;
  const environment = isOther ? await loadEnvironment(task, variant) : shown.environment;
  if (choice !== choices) return;
  const entry = environment.scenes.find((entry) => entry.seed === seed) ?? environment.scenes[0];
  Object.assign(shown, { task, variant, seed: entry.seed, environment, watching: script !== null });
  history.replaceState(null, "", `#${task}-${variant}-${entry.seed}`);
  showChoice(isOther);
  shown.game?.episode.close();
  shown.game = null;
  show(entry.scene, entry.scene);
  const actions = script === null ? null : fromLetters(script);
  let started = false;
  const next = () => actions ? actions[game.actions.length] ?? 0 : (started ||= controls.touched) ? controls.next() : null;
  const episode = await open(environment, entry, task, variant);
  if (choice !== choices) return episode.close();
  const game = new Game(episode, catalogue.tasks[task].horizon, next);
  shown.game = game;
}

/** @param {boolean} isOther  whether another environment is shown than before */
function showChoice(isOther) {
  const { task, variant, seed, environment } = shown;
  const { summary, goal, solved } = catalogue.tasks[task];
  element("task").value = task;
  const variants = catalogue.environments.filter((/** @type {any} */ one) => one.task === task);
  element("variant").replaceChildren(...variants.map(({ variant }) => new Option(variant)));
  element("variant").value = variant;
  element("summary").textContent = `${summary[0].toUpperCase()}${summary.slice(1)}.`;
  element("words").textContent = goal;
  element("demo").disabled = variant !== "Demo" || !environment.demonstrations.length;
  if (isOther) {
    draw(element("solved"), catalogue.look, solved, "allo");
    element("scenes").replaceChildren(...environment.scenes.map(sceneButton));
  }
  for (const button of element("scenes").children) button.ariaCurrent = String(Number(button.dataset.seed) === seed);
}

/** @param {Entry} entry */
function sceneButton({ seed, scene }) {
  const button = document.createElement("button"), canvas = document.createElement("canvas");
  canvas.width = canvas.height = 144;
  draw(canvas, catalogue.look, scene, "allo");
  button.dataset.seed = String(seed);
  button.ariaLabel = `Scene ${seed}`;
  button.append(canvas, String(seed));
  button.onclick = () => play(seed);
  return button;
}

/**
 * @param {import("./scene.js").Scene} initial
 * @param {import("./scene.js").Scene} scene
 */
function show(initial, scene) {
  const { task, game, watching } = shown, { horizon } = catalogue.tasks[task];
  const done = game?.actions.length ?? 0, now = score(task, initial, scene);
  for (const view of /** @type {const} */ (["allo", "ego"])) {
    const canvas = element(view);
    canvas.ariaLabel = `${view === "allo" ? "From above" : "As the robot sees it"}: ${scene.blocks.length} blocks, ${scene.regions.length} goal regions`;
    draw(canvas, catalogue.look, scene, view);
  }
  element("time").value = done / horizon;
  element("left").textContent = `${((horizon - done) / RATE).toFixed(0)} s left`;
  element("score").textContent = now.toFixed(2);
  element("save").disabled = !game?.over || watching;
  const status = game?.failure ? game.failure.message : !game ? "Loading MuJoCo …" : game.over ? `Over: score ${now.toFixed(2)}`
    : watching ? "Watching" : done ? "Playing" : "Press a key to start";
  if (element("status").textContent !== status) element("status").textContent = status;
}

/** @param {number} time */
function frame(time) {
  const game = shown.game;
  if (game) {
    game.advance(time);
    show(game.initial, game.shown(time));
    shown.frames += 1;
  }
  requestAnimationFrame(frame);
}

/** Plays this scene of the present environment, from its start. @param {number} seed @param {string | null} script */
function play(seed, script = null) {
  arena.focus({ preventScroll: true });
  controls.tapped.clear();
  return choose(shown.task, shown.variant, seed, script);
}

function next() {
  const seeds = shown.environment.scenes.map(({ seed }) => seed);
  return play(seeds[(seeds.indexOf(shown.seed) + 1) % seeds.length]);
}

const again = () => play(shown.seed);
const expert = () => play(shown.seed, shown.environment.scenes.find(({ seed }) => seed === shown.seed)?.expert);

let demonstration = 0;  // they are shown one after the other
function demo() {
  const list = shown.environment.demonstrations;
  return play(shown.seed, list[demonstration++ % list.length]);
}

/** `#FindDupe-All-3`; what is missing or unknown is replaced by the first there is. */
function chooseByAddress() {
  const [task, variant, seed] = location.hash.slice(1).split("-");
  const tasks = Object.keys(catalogue.tasks), known = tasks.includes(task) ? task : tasks[0];
  const variants = catalogue.environments.filter((/** @type {any} */ one) => one.task === known).map(({ variant }) => variant);
  return choose(known, variants.includes(variant) ? variant : variants[0], Number(seed ?? 0));
}

/** Selects keep the focus while they are used by keyboard, and give it to the arena when used by pointer. */
for (const id of ["task", "variant"]) {
  let byPointer = false;
  element(id).addEventListener("pointerdown", () => { byPointer = true; });
  element(id).addEventListener("keydown", () => { byPointer = false; });
  element(id).addEventListener("change", async () => {
    if (byPointer) arena.focus({ preventScroll: true });
    const task = element("task").value, variant = element("variant").value;
    const exists = catalogue.environments.some((/** @type {any} */ one) => one.task === task && one.variant === variant);
    await choose(task, exists ? variant : "Demo", 0);
  });
}
Object.assign(element("again"), { onclick: again });
Object.assign(element("next"), { onclick: next });
Object.assign(element("expert"), { onclick: expert });
Object.assign(element("demo"), { onclick: demo });
element("save").onclick = () => save(recording(shown));
addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || /** @type {any} */ (event.target).matches("select, input")) return;
  ({ KeyR: again, KeyN: next, KeyE: expert })[event.code]?.();
});
addEventListener("hashchange", chooseByAddress);

/** Canvases have as many pixels as the screen. */
const resized = new ResizeObserver((entries) => {
  for (const { target, contentRect } of entries) {
    const canvas = /** @type {HTMLCanvasElement} */ (target);
    canvas.width = canvas.height = Math.max(1, Math.round(contentRect.width * devicePixelRatio));
  }
});
for (const view of ["allo", "ego"]) resized.observe(element(view));
element("task").replaceChildren(...Object.keys(catalogue.tasks).map((name) => new Option(name)));
await chooseByAddress();
requestAnimationFrame(frame);
