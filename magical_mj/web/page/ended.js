// @ts-check
/** The end of an episode: what it pursued, how its score compares, and sharing it. */
import { outline } from "./draw.js";
import { pursued } from "./pursued.js";
import { outcome } from "./puzzles.js";
import { compared, recordedIn } from "./replays.js";
import { catalogue, element, isServed, methods, shown } from "./shown.js";

/** @typedef {import("./game.js").Game} Game */

/** Says once what an ended episode reached: of a puzzle, or which rival of the task. @param {Game} game @param {number | null} points  null: without a score */
export function tell(game, points) {
  const { task, watching, judged, wanted, environment: { puzzle } } = shown, { initial, now } = game;
  Object.assign(shown, { told: game, rival: "" });
  if (puzzle && !watching) {
    element("words").textContent = outcome(puzzle, judged, initial, now, points ?? 0);
    element("summary").textContent = puzzle.sentence;
  }
  if (puzzle || wanted || isServed || points === null || points === 1) return;
  import("./rivals.js").then(({ rivalReached }) => rivalReached(task, initial, now)).then((rival) => {
    if (shown.game === game) shown.rival = rival && `It reached another goal that the demonstrations reach: “${rival}”`;
  }).catch(() => {});  // offline, only this sentence is missing
}

/** What an episode pursued. Not of puzzles, which have their own sentences, and not for participants of studies. @param {import("./scene.js").Scene} initial @param {import("./scene.js").Scene} final @param {number} points */
export const pursuedIn = (initial, final, points) => shown.environment.puzzle || catalogue.collects ? null : shown.wanted ? shown.wanted.outcome(final, points)
  : pursued(shown.task, catalogue.demonstrated[shown.task], initial, final, points);

/** Shows what the finished episode pursued, with the blocks outlined, and how its score compares. Null before the end. @param {import("./pursued.js").Pursued | null} what @param {number} points */
export function showEnd(what, points) {
  const { task, variant, seed, scene, shifts, wanted, game } = shown, isCompared = what && !scene && !shifts && !wanted;
  const words = { "pursued-words": what?.sentence ?? "", rival: shown.rival, compared: isCompared ? compared(recordedIn(methods, { task, variant, seed }), points) : "" };
  for (const [id, text] of Object.entries(words)) if (element(id).textContent !== text) element(id).textContent = text;
  element("ended").hidden = !what;
  element("outlines").hidden = !what?.moved.length && !what?.intended.length;
  if (what && game) outline(element("allo"), catalogue.look, game.now, what);
  element("share").hidden = isServed || !game?.over;
  document.body.classList.toggle("over", game?.over ?? false);
}

/** Shares the address of what is shown, with the score. @param {(what: string) => void} say */
export async function share(say) {
  const { task, variant, seed, wanted, environment: { puzzle } } = shown, what = wanted ? `“${wanted.sentence}”` : puzzle ? "a puzzle" : `${task}-${variant}-${seed}`;
  const text = `Score ${element("score").textContent} in ${what}, MAGICAL:`, url = location.href;
  if (navigator.canShare?.({ text, url })) return navigator.share({ text, url }).catch(() => {});  // the visitor may cancel it
  await navigator.clipboard.writeText(`${text} ${url}`).then(() => say("Score and link were copied"), () => say(url));
}
