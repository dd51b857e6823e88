// @ts-check
/** What can be watched in a scene: the expert, demonstrations, policies and recorded episodes. */
import { recordedActions, recordedIn } from "./replays.js";
import { element, isServed, may, methods, policies, shown } from "./shown.js";

/** @typedef {import("./scenes.js").Entry} Entry */
/** @typedef {string | number[][]} Script  actions, as letters or as vectors of speeds */

export const BC = "bc", OWN = "own", EXPERT = "expert", DEMO = "demo-";  // names in addresses: policies that run in the page, and known actions
export const NO_EXPERT = "The expert runs in Python: not in changed scenes and intents";

/**
 * The known actions of what is watched in a scene. Null if there are none.
 * @param {string} method @param {string} task @param {string} variant @param {Entry} entry @param {import("./scenes.js").Environment} environment
 * @returns {Promise<Script | null>}
 */
export async function actionsOf(method, task, variant, { seed, expert, shifts }, { demonstrations, scenes }) {
  if (method === EXPERT) return scenes.length === 1 ? scenes[0].expert : expert;  // all seeds of Demo have one scene
  if (method.startsWith(DEMO)) return demonstrations[Number(method.slice(DEMO.length)) - 1] ?? null;
  const place = { task, variant, seed };
  return shifts || recordedIn(methods, place).every((one) => one.method !== method) ? null : recordedActions(method, place);
}

/** The names of everything that can be watched in the current scene, by their names in addresses, in groups. @returns {Record<string, [string, string][]>} */
export function watchable() {
  const { task, variant, seed, shifts, scene, wanted, environment: { demonstrations, scenes } } = shown;
  const entry = scenes.find((one) => one.seed === seed || scenes.length === 1);
  return {
    "This scene": wanted ? [] : [
      ...entry?.expert.length ? [/** @type {[string, string]} */ ([EXPERT, `The ${shown.environment.puzzle ? "demonstration" : "expert"} (H)`])] : [],
      ...demonstrations.map((_, i) => /** @type {[string, string]} */ ([`${DEMO}${i + 1}`, `Demonstration ${i + 1}`])),
    ],
    "Policies that act in this page": isServed ? [] : [
      ...task in policies ? [/** @type {[string, string]} */ ([BC, "BC from states (B)"])] : [], [OWN, "A policy of yours: open a file …"],
    ],
    "Recorded episodes of the leaderboard": shifts || scene || wanted ? [] : recordedIn(methods, { task, variant, seed })
      .map(({ method, name, score }) => /** @type {[string, string]} */ ([method, `${score.toFixed(2)} ${name}`])),
  };
}

/** Lists what can be watched. */
export function showWatchable() {
  const groups = Object.entries(watchable()).filter(([, choices]) => choices.length).map(([label, choices]) => {
    const group = document.createElement("optgroup");
    group.label = label;
    group.append(...choices.map(([value, text]) => new Option(text, value)));
    return group;
  });
  const without = shown.scene || shown.wanted ? [new Option(NO_EXPERT)] : [];
  for (const option of without) option.disabled = true;
  element("watch").replaceChildren(new Option("nobody", ""), ...groups, ...without);
  element("watch").value = shown.method;
  element("watching").hidden = !groups.length || !may("expert");
  element("take").hidden = !shown.watching || shown.taken;
}

/** What is watched. A policy of the page with its mean scores. */
export function watchedWords() {
  const { method } = shown;
  if (method === EXPERT) return shown.environment.puzzle ? `demonstration ${shown.seed + 1}` : "the expert";
  if (method.startsWith(DEMO)) return `demonstration ${method.slice(DEMO.length)}`;
  if (method !== BC) return methods[method]?.name ?? "your policy";
  const scores = Object.entries(policies[shown.task]).map(([variant, score]) => `${score.toFixed(2)} in ${variant}`);
  return `BC from states: on average it scores ${scores.join(", ")}`;
}
