// @ts-check
/**
 * Puzzles: intents that are played after two demonstrations. The sentence is shown after the first own episode.
 * @typedef {import("./scene.js").Scene} Scene
 * @typedef {import("./goal.js").Goal} Goal
 * @typedef {{task: string, sentence: string, solved: Scene}} Puzzle  task: its name in Python; solved: the end of a demonstration
 * @typedef {{goal?: Goal, rivals?: {sentence: string, goal: Goal}[]}} Judged  rivals: other readings of the demonstrations, the simplest first
 */
import { holds } from "./goal.js";

const QUESTION = "What do you want? Watch both demonstrations, then do the same in a scene with other poses, or with other blocks";
const HINT = "The sentence and the score are shown at the end of your episode.";

/** @type {Set<string>} the sentences that were shown */
const revealed = new Set();

/** @param {Puzzle} puzzle */
export const isSecret = ({ sentence }) => !revealed.has(sentence);

/** @param {{task: string}[]} environments  of puzzles */
export const puzzleNames = (environments) => [...new Set(environments.map((one) => one.task))];

/** The name of a random puzzle other than the current one. @param {{task: string}[]} environments  of puzzles @param {string} task */
export function drawn(environments, task) {
  const names = puzzleNames(environments).filter((name) => name !== task);
  return names[Math.floor(Math.random() * names.length)] ?? task;
}

/** What the page says about a puzzle, as of a task. @param {Puzzle} puzzle */
export function described(puzzle) {
  const secret = isSecret(puzzle);
  return { summary: secret ? QUESTION : puzzle.sentence.slice(0, -1), hint: secret ? HINT : "", solved: puzzle.solved };
}

/**
 * What the page says after an own episode.
 * @param {Puzzle} puzzle @param {Judged} judged @param {Scene} initial @param {Scene} final @param {number} score
 */
export function outcome(puzzle, { rivals = [] }, initial, final, score) {
  revealed.add(puzzle.sentence);
  const reached = rivals.find(({ goal }) => holds(goal, initial, final) && !holds(goal, initial, initial));
  return score === 1 ? "That is what you did." : reached ? `What you did instead: ${reached.sentence}` : "That is not what you did.";
}
