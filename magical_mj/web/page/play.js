// @ts-check
/** The page for playing: choosing a scene, playing, watching, saving and sending. */
import { fromLetters } from "./actions.js";
import { addressOf, parseAddress, shiftsOf } from "./address.js";
import { agreement } from "./agreement.js";
import { showAddress } from "./choice.js";
import { Controls } from "./controls.js";
import { draw, fitToScreen } from "./draw.js";
import { edit, editedEnvironment, linkedScene } from "./edited.js";
import { pursuedIn, share, showEnd, tell } from "./ended.js";
import { Game } from "./game.js";
import { goalScore } from "./goal.js";
import { onProgress } from "./mujoco.js";
import { asked } from "./patience.js";
import { loadPolicy } from "./policy.js";
import { described, drawn, isSecret, puzzleNames } from "./puzzles.js";
import { recording, save } from "./recording.js";
import { sceneButton } from "./scenelist.js";
import { fetchFile, inBrowser, isChange, loadEnvironment } from "./scenes.js";
import { lack, score } from "./score.js";
import { remembered, Seat } from "./server.js";
import { chosenShifts, showShifts } from "./shiftmenu.js";
import { catalogue, element, isServed, may, policies, shown } from "./shown.js";
import { actionsOf, BC, EXPERT, NO_EXPERT, OWN, showWatchable, watchable, watchedWords } from "./watching.js";

/** @typedef {{task: string, variant: string}} Name */

const arena = element("arena");
const puzzleButtons = /** @type {HTMLElement[]} */ ([...element("puzzle").querySelectorAll("button")]);
const controls = new Controls(arena, document.querySelectorAll("[data-command]"));
/** @type {import("./address.js").Environment[]} those of tasks, and those of puzzles */
const environments = [...catalogue.environments, ...catalogue.puzzles];
const wish = Number(new URLSearchParams(location.search).get("speed")) || 1;
const speed = may("speed") ? Math.min(40, Math.max(0.1, wish)) : 1;  // times real time
const seat = isServed ? new Seat(sayConnection) : null;
const PUZZLE = "#puzzle";  // the address of a random puzzle
const INTENT = "intent";  // in the list of tasks: the goal is a visitor's
/** @type {Uint8Array | null} the visitor's policy */
let own = null;
onProgress((share) => {
  if (shown.game) return;
  element("time").value = share;
  if (!shown.note) element("status").textContent = `${pending} ${Math.floor(100 * share)} %`;
});
if (seat) element("start").remove();  // the server simulates, so nothing is loaded
let pending = seat ? "Waiting for the server …" : element("start").hidden ? "Loading MuJoCo …" : "Tap the picture to play";
const ready = seat ? Promise.resolve() : asked.then(() => {
  pending = "Loading MuJoCo …";
  shown.again?.();
});
const open = seat?.open ?? inBrowser(ready);

let choices = 0;  // only the last choice is shown, in whatever order they are loaded

/**
 * Shows a scene and prepares it for playing. Returns whether this succeeded.
 * @param {string} task
 * @param {string} variant
 * @param {number} seed
 * @param {{shifts?: string, method?: string, isAddress?: boolean, unknown?: string, scene?: string, intent?: string}} [how]
 *   method: what to watch, or "" for playing. unknown: the error in the address. scene: a changed scene, as JSON. intent: the goal, if it is not the task's
 */
async function choose(task, variant, seed, how = {}) {
  const { method = "", isAddress = false, scene = "", intent = "" } = how, shifts = (how.shifts ?? "").split(",").filter((one) => !scene || isChange(one)).join(",");
  let { unknown = "" } = how;
  if (unsent() && !confirm("This episode was not sent. Leave it?")) return showNames();
  const choice = ++choices;
  const failed = (/** @type {Error} */ error) => choice === choices ? say(error, () => choose(task, variant, seed, how)) : undefined;
  shown.note = "";  // messages that appear while the scene is loaded remain
  const isOther = task !== shown.task || variant !== shown.variant || shifts !== shown.shifts || scene !== shown.scene || intent !== shown.intent;
  const load = scene && !seat ? async () => editedEnvironment(catalogue, { task, variant, seed, shifts }, linkedScene(scene, catalogue)) : () => loadEnvironment(task, variant, shifts);
  const environment = isOther ? await load().catch(failed) : shown.environment;
  if (choice !== choices) return;
  if (!environment) return stay(isAddress);
  const known = environment.scenes.find((entry) => entry.seed === seed);
  const entry = known ?? (seat ? { seed, expert: "", scene: null, horizon: environment.horizon } : environment.scenes[0]);
  const wanted = intent && entry.scene ? await import("./ownintent.js").then(({ intentIn }) => intentIn(intent, entry.scene))
    .catch((error) => { unknown = error.message; }) : null;
  if (choice !== choices) return;
  const acts = method === OWN ? own !== null : method === BC && task in policies;
  const replay = acts || scene ? null : await actionsOf(method, task, variant, entry, environment).catch(failed);
  if (choice !== choices) return;
  if (replay === undefined) return stay(isAddress);
  const watching = acts || Boolean(replay?.length), watched = watching ? method : "";
  element("inspect").href = `inspect.html#${addressOf({ task, variant, seed: entry.seed, shifts, scene })}`;
  const horizon = wanted?.horizon ?? entry.horizon ?? environment.horizon, judged = wanted ?? entry;
  Object.assign(shown, { task, variant, seed: entry.seed, shifts, scene, intent: wanted?.text ?? "", wanted, horizon, environment, watching, method: watched, taken: false, judged });
  shown.helped ||= watching;
  showChoice(isOther, !isAddress);
  if (unknown) say(unknown);
  else if (method && !watched) say(`There are no actions of “${method}” in this scene`);
  else if (wanted ? !wanted.goal : scene && entry.scene && lack(task, entry.scene)) say(`No score: ${wanted ? `the intent cannot start here, since ${wanted.lack}` : `${task} needs ${lack(task, /** @type {any} */ (entry.scene))}`}`);
  else if (entry.seed !== seed && environment.scenes.length > 1) say(`There is no scene ${seed} here, but ${environment.scenes.length}: this is the first`);
  shown.game?.episode.close();
  shown.game = shown.again = null;
  element("save").disabled = true;
  if (entry.scene) show(entry.scene, entry.scene);
  else element("status").textContent = pending;
  const actions = typeof replay === "string" ? fromLetters(replay) : replay;
  const next = () => {
    if (shown.taken) return controls.next();
    if (policy) return policy.next(game.actions.length);
    if (actions) return actions[game.actions.length] ?? 0;
    if (game.actions.length) return controls.next();
    if (!controls.touched) return null;
    shown.note = "";
    return controls.next();
  };
  await ready;
  if (choice !== choices) return;
  const episode = await open(environment, entry, task, variant).catch(failed);
  if (!episode || choice !== choices) return episode?.close();
  const file = acts && await (method === OWN ? own : fetchFile(`policies/${task}.onnx`).catch(failed));
  const policy = file && await loadPolicy(file, /** @type {any} */ (episode.simulation)).catch(failed);
  if ((acts && !policy) || choice !== choices) return episode.close();
  controls.tapped.clear();  // keys that were pressed before the scene appeared do not start it
  if (episode.goal) shown.judged = { goal: episode.goal };
  const game = new Game(episode, horizon, next, speed);
  shown.game = game;
  return true;
}

/** Opens the editor with the current scene. */
function change() {
  const { task, variant, seed, intent, game } = shown, scene = game?.now ?? shown.environment.scenes.find((one) => one.seed === seed)?.scene;
  if (!scene) return;
  shown.editing = true;
  const shifts = shown.shifts.split(",").filter(isChange).join(",");  // the changed scene contains the others
  edit(catalogue, { task, variant, seed, shifts, intent }, scene, "Play it", (changed) => {
    shown.editing = false;
    if (changed) choose(task, variant, seed, { scene: changed, shifts, intent });
    arena.focus({ preventScroll: true });
  }).catch((error) => {
    shown.editing = false;
    say(error);
  });
}

/** Keeps the current scene, since another one could not be loaded. @param {boolean} isFirst  whether it was the first scene */
async function stay(isFirst) {
  const problem = shown.note;
  if (!shown.task) {
    if (isFirst) return;
    await starting;  // the other choice had interrupted it
    await start();
    if (shown.game) say(problem);
    return;
  }
  showNames();
  if (shown.game) return;
  const opened = await choose(shown.task, shown.variant, shown.seed, { shifts: shown.shifts, scene: shown.scene, intent: shown.intent });  // the other choice had interrupted it
  if (opened) say(problem);
}

/** Whether a finished episode has not been sent to the study. */
function unsent() {
  return catalogue.collects && shown.game?.over && !shown.watching && !shown.game.sent;
}

/** Lists the tasks, and the shown puzzle. */
function showTasks() {
  const names = puzzleNames(catalogue.puzzles), puzzle = shown.environment.puzzle ? [new Option(`Puzzle ${names.indexOf(shown.task) + 1} of ${names.length}`, shown.task)] : [];
  const own = shown.wanted ? [new Option("An intent", INTENT)] : [];
  element("task").replaceChildren(...Object.keys(catalogue.tasks).map((name) => new Option(name)), ...puzzle, ...own);
}

/** Shows the current environment in the lists and the address. @param {boolean} [isNew]  whether to add an entry to the browser's history */
function showNames(isNew = false) {
  const { task, variant, method, environment } = shown, hash = `#${addressOf(shown)}${method && "@"}${method}`;
  showAddress(hash, isNew && location.hash !== "");
  element("seed").value = shown.seed;
  showTasks();
  element("task").value = shown.wanted ? INTENT : task;
  const variants = environments.filter((/** @type {Name} */ one) => one.task === task);
  element("variant").replaceChildren(...variants.map((/** @type {Name} */ { variant }) => new Option(variant)));
  element("variant").value = variant;
  const hasBody = shown.scene && environment.scenes[0].scene.robot.body;
  showShifts(element("shifts"), hasBody ? {} : shiftsOf(shown, environments), shown);
}

/** Applies the chosen shifts. @param {Event} event */
function changeShifts({ target }) {
  const shifts = chosenShifts(element("shifts"), /** @type {HTMLSelectElement} */ (target), catalogue.exclusive);
  choose(shown.task, shown.variant, shown.seed, { shifts, method: shown.method, scene: shown.scene, intent: shown.intent });
}

/** @param {boolean} isOther  whether another environment is shown than before @param {boolean} isNew */
function showChoice(isOther, isNew) {
  const { task, variant, seed, environment, wanted } = shown, { puzzle } = environment;
  const own = wanted && { summary: wanted.sentence.slice(0, -1), hint: wanted.text, solved: wanted.end ?? environment.scenes[0].scene };
  const { summary, hint, solved } = own ?? (puzzle ? described(puzzle) : catalogue.tasks[task]);
  showNames(isNew);
  element("summary").textContent = `${summary[0].toUpperCase()}${summary.slice(1)}.`;
  element("words").textContent = hint;
  element("about").href = own ? `intents.html#${encodeURI(wanted.text)}` : `../${puzzle ? "intents" : task === "SweepToTop" ? "bodies" : task}.html`;
  element("about").textContent = own ? "Change the intent" : "About this task";
  element("puzzle").hidden = !puzzle;
  for (const id of ["inspect", "edit"]) element(id).hidden = seat !== null || puzzle !== undefined;
  for (const button of puzzleButtons) button.ariaCurrent = String(button.dataset.variant === variant && Number(button.dataset.seed) === seed);
  showWatchable();
  if (isOther) {
    draw(element("solved"), catalogue.look, solved, "allo");
    element("scenes").replaceChildren(...environment.scenes.map((entry) => sceneButton(entry, catalogue.look, () => play(entry.seed))));
  }
  element("more").hidden = !may("scenes");  // not before: what is above would still move it
  for (const button of element("scenes").children) button.ariaCurrent = String(Number(button.dataset.seed) === seed);
}

/**
 * @param {import("./scene.js").Scene} initial
 * @param {import("./scene.js").Scene} scene
 */
function show(initial, scene) {
  shown.again = () => show(initial, scene);
  const { task, game, horizon, watching, sending, judged, wanted, environment: { puzzle } } = shown, final = game?.now ?? scene;
  const done = game?.actions.length ?? 0, isGoal = puzzle || wanted, isScored = wanted ? wanted.goal : puzzle || !lack(task, initial);
  const points = isGoal ? goalScore(judged.goal ?? null, initial, final) : isScored ? score(task, initial, final) : 0;
  for (const view of /** @type {const} */ (["allo", "ego"])) {
    const canvas = element(view);
    const words = `${view === "allo" ? "From above" : "As the robot sees it"}; blocks: ${scene.blocks.length}, goal regions: ${scene.regions.length}`;
    if (canvas.ariaLabel !== words) canvas.ariaLabel = words;
    draw(canvas, catalogue.look, scene, view);
  }
  showEnd(game?.over && isScored ? pursuedIn(initial, final, points) : null, points);
  element("time").value = done / horizon;
  element("left").textContent = game ? `${game.secondsLeft.toFixed(0)} s left` : "";
  if (game?.over && shown.told !== game) tell(game, isScored ? points : null);
  const isHidden = puzzle && !watching && isSecret(puzzle);
  const now = isHidden ? "?" : !isScored ? "–" : points.toFixed(2);
  if (element("score").textContent !== now) element("score").textContent = now;  // otherwise screen readers would repeat it
  element("save").disabled = !game?.over || watching || sending || game.sent || [shown.shifts, shown.scene, shown.intent].some(Boolean);  // recordings contain none of them
  if (game?.failure) say(game.failure);
  const status = shown.note ? shown.note : !game ? pending : game.over ? `Over: score ${now}`
    : shown.taken || (done && !watching) ? "Playing" : watching ? `Watching ${watchedWords()}` : "Press a key or button to start";
  if (element("status").textContent !== status) element("status").textContent = status;
}

/** Shows a message until another scene is shown. @param {Error | string} what @param {() => void} [retry] */
function say(what, retry = again) {
  shown.note = what instanceof Error ? what.message : what;
  element("status").textContent = shown.note;
  if (what instanceof Error && !shown.game) /** @type {any} */ (window).showFailure(`${shown.note}.`, retry);
}

/** Shows that the connection broke, and what was shown before when it is restored. @param {string} text */
function sayConnection(text) {
  if (text) shown.note = text;
  else if (shown.note.endsWith("trying again …")) shown.note = "";
  element("status").textContent = shown.note || pending;
}

/** @param {number} time */
function frame(time) {
  const game = shown.game;
  if (game && !shown.editing) {
    game.advance(time);
    show(game.initial, game.shown(time));
  }
  requestAnimationFrame(frame);
}

/** Plays this scene of the current environment from its start. @param {number} seed @param {{method?: string}} [how] */
function play(seed, how = {}) {
  arena.focus({ preventScroll: true });
  if (!element("ending").hidden && !may("scenes")) return;  // nothing is left to play
  if (!shown.task) return start();  // the first scene is not loaded yet, or loading failed
  return choose(shown.task, shown.variant, seed, { shifts: shown.shifts, scene: seed === shown.seed ? shown.scene : "", intent: shown.intent, ...how });
}

function next() {
  const seeds = shown.environment.scenes.map(({ seed }) => seed);
  return play(seat && seeds.length > 1 ? shown.seed + 1 : seeds[(seeds.indexOf(shown.seed) + 1) % seeds.length], { method: shown.method });
}

const again = () => play(shown.seed);

/** Watches something in this scene from its start, if the scene has it. @param {string} method */
function watch(method) {
  if (method === OWN) return element("policy").click();
  const exists = Object.values(watchable()).flat().some(([value]) => value === method);
  if (!method || (exists && may("expert"))) return play(shown.seed, { method });
  if (shown.scene || shown.wanted) say(NO_EXPERT);
}

/** Shows a demonstration of a puzzle, or another of its scenes for playing. @param {string} task @param {string} variant @param {number} seed */
function showPuzzle(task, variant, seed) {
  arena.focus({ preventScroll: true });
  return choose(task, variant, seed, { method: variant === "Demo" ? EXPERT : "" });
}

/** Lets the player continue the watched episode from its current state. */
function take() {
  shown.taken = true;
  controls.tapped.clear();
  showWatchable();
  arena.focus({ preventScroll: true });
}

/** Sends the episode to the server, and shows the next scene in its reply. */
async function send() {
  const game = /** @type {Game} */ (shown.game);
  shown.sending = element("save").disabled = true;
  arena.focus({ preventScroll: true });  // a disabled button would swallow keys
  say("Sending …");
  const choice = choices;
  try {
    const about = { speed, watched: shown.helped };
    const { score, next, ...rest } = await /** @type {Seat} */ (seat).ask({ keep: recording(shown, catalogue.protocol), about });
    game.sent = true;
    const kept = shown.practice ? `That was practice, with score ${score.toFixed(2)}.` : `Kept, with score ${score.toFixed(2)}. Thank you!`;
    if (choices !== choice) return say(kept);  // another scene was chosen in the meantime
    const opened = await chooseWanted(next);
    if (next && choices !== choice + 1) return say(kept);  // or while the next one was loaded
    const after = !next ? end(rest) : opened ? "Press a key to go on" : `The next scene cannot be opened: ${shown.note}`;
    say(`${kept} ${after}`);
  } catch (error) {
    say(/** @type {Error} */ (error));
  } finally {
    shown.sending = false;
  }
}

/** Registers the participant with the server, and shows the scene in its reply. @param {Seat} seat */
async function arrive(seat) {
  let reply = await seat.ask({ arrive: remembered() });
  remembered(reply.participant);
  if (reply.consent) {
    await agreement(reply.consent);
    reply = await seat.ask({ arrive: reply.participant, agree: true });
  }
  if (reply.next) await chooseWanted(reply.next);
  else {
    if (may("scenes")) await chooseByAddress();
    say(end(reply));
  }
}

/** Shows, until the page is left, why no scene is offered, and the participant's completion code. @param {{why?: string, code?: string}} reply */
function end({ why, code }) {
  const text = `${why ?? "That was everything"}${code ? ` Your code: ${code}` : ""}`;
  element("ending").textContent = text;
  element("ending").hidden = false;
  element("turn").hidden = true;
  return text;
}

/** @param {{task: string, variant: string, seed: number, practice: boolean, number: number, of: number | null} | null} wanted */
async function chooseWanted(wanted) {
  Object.assign(shown, { helped: false, practice: wanted?.practice ?? false });
  if (!wanted) return null;
  const { task, variant, seed, practice, number, of } = wanted, count = `${number}${of ? ` of ${of}` : ""}`;
  element("turn").textContent = practice ? `Practice ${count}: this episode does not count.` : `Episode ${count}`;
  element("turn").hidden = false;
  return choose(task, variant, seed);
}

/** @param {string | undefined} text */
function seedIn(text) {
  return /^\d+$/.test(text ?? "") && Number.isSafeInteger(Number(text)) ? Number(text) : 0;
}

/** Shows the scene in the address, or the most similar one with a message. */
async function chooseByAddress() {
  const random = location.hash === PUZZLE && catalogue.puzzles.length ? `#${drawn(catalogue.puzzles, shown.task)}-Demo-0@${EXPERT}` : "";
  const { task, variant, seed, ...how } = parseAddress(random || location.hash, { ...catalogue, environments });
  await choose(task, variant, seed, { ...how, isAddress: true });
}

/** @type {Promise<void> | null} */
let starting = null;

/** Shows the first scene. Further calls wait for the same one. */
function start() {
  starting ??= (seat && catalogue.collects ? arrive(seat).catch(say) : chooseByAddress())
    .finally(() => { starting = null; });
  return starting;
}

/** @type {Record<string, string>} the buttons by key */
const SHORTCUTS = { KeyR: "again", KeyN: "next", KeyT: "take", KeyE: "edit" };
/** @type {Record<string, string>} what to watch, by key */
const WATCHED = { KeyH: EXPERT, KeyB: BC };

/** Fields keep the focus if they are used by keyboard. After a use by pointer, the arena gets it. */
for (const [id, changed] of Object.entries({ task: changeNames, variant: changeNames, seed: changeSeed })) {
  let byPointer = false;
  element(id).addEventListener("pointerdown", () => { byPointer = true; });
  element(id).addEventListener("keydown", () => { byPointer = false; });
  element(id).addEventListener("change", () => {
    if (byPointer) arena.focus({ preventScroll: true });
    changed();
  });
}

function changeNames() {
  const intent = element("task").value === INTENT ? shown.intent : "", task = intent ? shown.task : element("task").value, variant = element("variant").value;
  const there = environments.filter((/** @type {Name} */ one) => one.task === task);
  const exists = there.some((/** @type {Name} */ one) => one.variant === variant);
  const { method, shifts } = shown, found = exists ? variant : there[0].variant;
  const kept = parseAddress(`#${task}-${found}-0?shifts=${shifts}`, { ...catalogue, environments });  // the shifts that the other environment has as well
  choose(task, found, 0, { method, shifts: kept.unknown ? "" : kept.shifts, intent });
}

function changeSeed() {
  if (shown.task) choose(shown.task, shown.variant, seedIn(element("seed").value), { intent: shown.intent });
}

element("shifts").onchange = changeShifts;
element("watch").onchange = () => watch(element("watch").value);
element("policy").oncancel = showWatchable;
element("policy").onchange = async () => {
  own = new Uint8Array(await element("policy").files[0].arrayBuffer());
  play(shown.seed, { method: OWN });
};
for (const [id, press] of Object.entries({ again, next, take, share: () => share(say), edit: change })) element(id).onclick = () => press();
element("want").onclick = () => showPuzzle(drawn(catalogue.puzzles, shown.task), "Demo", 0);
for (const button of puzzleButtons) button.onclick = () => showPuzzle(shown.task, button.dataset.variant ?? "", Number(button.dataset.seed));
element("save").onclick = catalogue.collects ? send
  : () => save(recording({ ...shown, task: shown.environment.puzzle?.task ?? shown.task }, catalogue.protocol), addressOf(shown));
element("seed").addEventListener("keydown", ({ key }) => { if (key === "Enter") arena.focus({ preventScroll: true }); });
addEventListener("keydown", (event) => {
  const elsewhere = /** @type {any} */ (event.target).matches("select, input");
  if (elsewhere || shown.editing || event.repeat || controls.held.size || event.ctrlKey || event.metaKey || event.altKey) return;  // R and W are next to each other
  if (WATCHED[event.code]) watch(WATCHED[event.code]);
  const button = element(SHORTCUTS[event.code] ?? "arena");
  if (button.id !== "arena" && !button.hidden) button.click();
});
addEventListener("hashchange", chooseByAddress);
addEventListener("beforeunload", (event) => { if (unsent()) event.preventDefault(); });

fitToScreen(["allo", "ego"].map(element), () => shown.again?.());
showTasks();
element("want").hidden = !catalogue.puzzles.length;
element("build").hidden = seat !== null;
element("choose").hidden = !catalogue.questions;
element("seed-label").hidden = !seat;
for (const link of ["inspect", "about", "docs", "edit"]) element(link).hidden = seat !== null;
if (seat) element("home").removeAttribute("href");
requestAnimationFrame(frame);
if (catalogue.collects) {
  element("save").textContent = "Send";
  element("instructions").hidden = !catalogue.instructions;
  element("instructions").textContent = catalogue.instructions;
  if (catalogue.title) {
    document.title = element("home").textContent = catalogue.title;
    document.body.classList.add("titled");
  }
}
for (const choice of ["task", "variant", "seed"]) element(choice).parentElement.hidden ||= !may("scenes");
element("next").hidden = !may("scenes");
await start();

