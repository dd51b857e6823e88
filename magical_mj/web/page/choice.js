// @ts-check
/** What can be chosen to be inspected, and what is: the lists of the page, and its address. */
import { addressOf, parseAddress } from "./address.js";

/** @typedef {import("./address.js").Place} Place */
/** @param {string} id */
const element = (id) => /** @type {any} */ (document.getElementById(id));

/** @param {any} catalogue @param {Place} place @param {boolean} isNew  whether one can go back from it */
export function showChoice(catalogue, place, isNew) {
  const { task, variant, seed } = place;
  const hash = `#${addressOf(place)}`;
  if (hash !== location.hash) history[isNew ? "pushState" : "replaceState"](null, "", hash);
  const variants = catalogue.environments.filter((/** @type {Place} */ one) => one.task === task);
  element("variant").replaceChildren(...variants.map((/** @type {Place} */ one) => new Option(one.variant)));
  Object.assign(element("task"), { value: task });
  Object.assign(element("variant"), { value: variant });
  element("seed").value = seed;
  element("play").href = `./#${addressOf(place)}`;
}

/** Lists the tasks, and calls back with what is chosen from now on. @param {any} catalogue @param {(place: Place) => void} chosen */
export function onChoice(catalogue, chosen) {
  const { task, variant, seed } = { task: element("task"), variant: element("variant"), seed: element("seed") };
  const choose = (/** @type {number} */ number) => chosen({ ...parseAddress(`#${task.value}-${variant.value}`, catalogue), seed: number });
  task.replaceChildren(...Object.keys(catalogue.tasks).map((name) => new Option(name)));
  task.onchange = () => choose(0);
  for (const field of [variant, seed]) field.onchange = () => choose(Math.max(0, Math.floor(Number(seed.value))));
}
