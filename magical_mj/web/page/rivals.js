// @ts-check
/** Other goals that the demonstrations of a task reach: its rivals, from `magical_mj.web.grammar.rival_texts`. */
import { holds } from "./goal.js";
import { parsed, sentenceOf } from "./intent.js";
import { loadGrammar } from "./ownintent.js";
import { fetchJson } from "./scenes.js";
import { goalIn } from "./selectors.js";

/** @typedef {import("./scene.js").Scene} Scene */

/** The sentence of the simplest rival that an episode reached; "" without one. @param {string} task @param {Scene} initial @param {Scene} final */
export async function rivalReached(task, initial, final) {
  const [grammar, rivals] = await Promise.all([loadGrammar(), fetchJson("rivals.json")]);
  return firstReached(rivals[task] ?? [], grammar, initial, final);
}

/** @param {string[]} rivals @param {import("./intent.js").Grammar} grammar @param {Scene} initial @param {Scene} final */
export function firstReached(rivals, grammar, initial, final) {
  for (const text of rivals) {
    const intent = parsed(text, grammar), goal = goalOrNull(intent, initial, grammar);
    if (holds(goal, initial, final) && !holds(goal, initial, initial)) return sentenceOf(intent, grammar);
  }
  return "";
}

/** The goal if every relation applies to an object in the scene. @param {import("./intent.js").Intent} intent @param {Scene} initial @param {import("./intent.js").Grammar} grammar */
function goalOrNull(intent, initial, grammar) {
  try {
    const goal = goalIn(intent, initial, grammar);
    return goal.every(({ relation, blocks }) => blocks.length || relation.startsWith("robot")) ? goal : null;
  } catch {  // it is undefined there
    return null;
  }
}
