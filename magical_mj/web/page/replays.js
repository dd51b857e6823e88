// @ts-check
/**
 * The recorded episodes of the leaderboard's methods in the scenes of the page.
 * @typedef {{task: string, variant: string, seed: number}} Place
 * @typedef {Record<string, {name: string, scores: Record<string, Record<string, number>>}>} Methods  scores: environment -> seed -> score
 * @typedef {{method: string, name: string, score: number}} Recorded
 */
import { fetchJson } from "./scenes.js";

/** @returns {Promise<Methods>} */
export const loadMethods = () => fetchJson("replays/index.json");

/** The methods with an episode in a scene, the best first. @param {Methods} methods @param {Place} place @returns {Recorded[]} */
export function recordedIn(methods, { task, variant, seed }) {
  const all = Object.entries(methods).map(([method, { name, scores }]) => ({ method, name, score: scores[`${task}-${variant}`]?.[seed] }));
  return all.filter(({ score }) => score !== undefined).sort((a, b) => b.score - a.score);
}

/** @type {Record<string, Promise<Record<string, Record<string, string>>>>} method -> environment -> seed -> actions */
const files = {};

/** The actions of a method in a scene, as letters. @param {string} method @param {Place} place */
export async function recordedActions(method, { task, variant, seed }) {
  files[method] ??= fetchJson(`replays/${method}.json`);
  files[method].catch(() => delete files[method]);
  return (await files[method])[`${task}-${variant}`][seed];
}

/** What an episode's score is worth: the best of the methods in its scene, and how many scored less. "" without any. @param {Recorded[]} recorded @param {number} points */
export function compared(recorded, points) {
  if (!recorded.length) return "";
  const [{ name, score: best }] = recorded, same = recorded.filter(({ score }) => score === best).length - 1, less = recorded.filter(({ score }) => score < points).length;
  const who = same > 1 ? `${name} and ${same} others` : same ? `${name} and another one` : name;
  return `The best of ${recorded.length} methods here scored ${best.toFixed(2)} (${who}); ${less || "none"} scored less than this episode.`;
}
