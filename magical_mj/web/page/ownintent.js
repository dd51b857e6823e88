// @ts-check
/**
 * A visitor's intent as the goal of an episode, in any scene.
 * @typedef {import("./scene.js").Scene} Scene
 * @typedef {{text: string, sentence: string, goal: import("./goal.js").Goal, lack: string, end: Scene | null, horizon: number,
 *   outcome: (final: Scene, points: number) => import("./pursued.js").Pursued}} OwnIntent
 *   lack: why no episode of it starts in the scene, "" if one does; end: one that satisfies it, if it was found
 */
import { distance, shares, STAYED, unmet } from "./goal.js";
import { clauseOf, parsed, sentenceOf, textOf } from "./intent.js";
import { plannedEnd } from "./planned.js";
import { fetchJson } from "./scenes.js";
import { goalIn, lackOf } from "./selectors.js";

/** @returns {Promise<import("./intent.js").Grammar>} */
export const loadGrammar = () => fetchJson("intents.json");

/**
 * The intent of a text, in a scene. Throws an error if the text is not an intent.
 * @param {string} text @param {Scene} scene @returns {Promise<OwnIntent>}
 */
export async function intentIn(text, scene) {
  const grammar = await loadGrammar(), intent = parsed(text, grammar), lack = lackOf(intent, scene, grammar);
  const goal = lack ? null : goalIn(intent, scene, grammar), end = goal && plannedEnd(goal, scene);
  const said = { text: textOf(intent, grammar), sentence: sentenceOf(intent, grammar), goal, lack, end, horizon: horizonOf(scene, end, grammar) };
  const clauses = intent.map((part) => clauseOf(part, intent, grammar));
  return { ...said, outcome: (final, points) => outcome(goal ?? [], clauses, scene, final, points) };
}

/** The number of actions for an episode, by the estimated cost of a plan, as in Python. Without a known end, all objects move. @param {Scene} initial @param {Scene | null} end @param {import("./intent.js").Grammar} grammar */
function horizonOf(initial, end, { time: { least, rounded, rate, fetch, carry } }) {
  const ways = [initial.robot, ...initial.blocks].map((one, i) => end ? distance(one, i ? end.blocks[i - 1] : end.robot) : 1).filter((way) => way > 0);
  const cost = ways.reduce((sum, way) => sum + fetch + carry * way, 0);
  return Math.max(least, rounded * Math.ceil(rate * cost / rounded));
}

/**
 * Which relations hold at the end of an episode, which blocks moved, and which had to.
 * @param {import("./goal.js").Conjunct[]} goal @param {string[]} clauses @param {Scene} initial @param {Scene} final @param {number} points
 */
function outcome(goal, clauses, initial, final, points) {
  const now = shares(goal, initial, final), left = clauses.filter((_, i) => now[i] < 1);
  const moved = [...initial.blocks.keys()].filter((i) => distance(initial.blocks[i], final.blocks[i]) > STAYED);
  const intended = [...new Set(goal.flatMap((conjunct) => unmet(conjunct, initial)))];
  return { sentence: points === 1 ? "That is the intent." : `What is missing: ${left.join("; ")}.`, moved, intended };
}
