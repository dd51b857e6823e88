// @ts-check
/**
 * A worker that looks for scenes where an intent can start and be reached. It receives its text; a new one ends a search.
 * @typedef {import("./scene.js").Scene} Scene
 * @typedef {{task: string, variant: string, seed: number, scene: Scene, isRedrawn: boolean}} Start
 * @typedef {{text: string, problem: string, start?: Start, end?: Scene, isLast?: boolean}} Found  problem: what to say meanwhile, or why there are no scenes
 */
import { parsed } from "./intent.js";
import { faults } from "./legal.js";
import { loadGrammar } from "./ownintent.js";
import { plannedEnd, randomFrom } from "./planned.js";
import { CHOICES } from "./scenefile.js";
import { fetchJson } from "./scenes.js";
import { goalIn, lackOf } from "./selectors.js";

const SHOWN = 4, TRIED = 6, REDRAWN = 4_000;  // scenes
const LOOKING = "Looking for scenes …";
const data = Promise.all([loadGrammar(), fetchJson("starts.json"), fetchJson("catalogue.json")]);
let searches = 0;  // only the last one goes on

addEventListener("message", ({ data: text }) => search(text, ++searches));

/** @param {string} text @param {number} number */
async function search(text, number) {
  const report = (/** @type {Omit<Found, "text">} */ found) => postMessage({ text, ...found });
  if (!text) return;
  report({ problem: LOOKING });
  const [grammar, starts, { solids }] = await data, intent = parsed(text, grammar), whys = /** @type {Record<string, number>} */ ({});
  let tried = 0, found = 0;
  for (const start of candidates(intent, grammar, starts, solids, whys)) {
    await new Promise((resolve) => setTimeout(resolve));  // to receive another text
    if (number !== searches) return;
    const end = plannedEnd(goalIn(intent, start.scene, grammar), start.scene);
    tried += 1;
    found += Number(end !== null);
    if (end) report({ problem: LOOKING, start, end });
    if (found === SHOWN || tried === TRIED) break;
  }
  const [[why] = [""]] = Object.entries(whys).sort((a, b) => b[1] - a[1]);
  report({ isLast: true, problem: found ? "" : tried ? `No end was found that satisfies it, in any of ${tried} scenes: its relations may contradict each other.`
    : `It can start in none of this page's scenes; in most of them, ${why}.` });
}

/**
 * The scenes where an intent can start: first those of the page, then such with other colours and shapes.
 * @param {import("./intent.js").Intent} intent @param {import("./intent.js").Grammar} grammar @param {Start[]} starts @param {import("./legal.js").Solids} solids
 * @param {Record<string, number>} whys  counts why episodes cannot start in others
 */
function* candidates(intent, grammar, starts, solids, whys) {
  const random = randomFrom(7), pick = (/** @type {string[]} */ all) => all[Math.floor(random() * all.length)];
  for (let i = 0; i < starts.length + REDRAWN; i++) {
    const start = starts[i % starts.length], isRedrawn = i >= starts.length, scene = isRedrawn ? redrawn(start.scene, random, pick) : start.scene;
    const why = lackOf(intent, scene, grammar);
    if (why) whys[why] = (whys[why] ?? 0) + 1;
    else if (!isRedrawn || !faults(scene, solids).length) yield { ...start, scene, isRedrawn };
  }
}

/** A scene with other colours and shapes, half of them of two. @param {Scene} scene @param {() => number} random @param {(all: string[]) => string} pick @returns {Scene} */
function redrawn(scene, random, pick) {
  const few = { colour: [pick(CHOICES.colour), pick(CHOICES.colour)], shape: [pick(CHOICES.shape), pick(CHOICES.shape)] };
  const drawn = (/** @type {"colour" | "shape"} */ name) => pick(random() < 0.5 ? few[name] : CHOICES[name]);
  return { ...scene, blocks: scene.blocks.map((block) => ({ ...block, colour: drawn("colour"), shape: drawn("shape") })) };
}
