// @ts-check
/** The selection of a scene to inspect: the lists of the page, and its address. */
import { addressOf, parseAddress } from "./address.js";

/** @typedef {import("./address.js").SceneId} SceneId */
/** @param {string} id */
const element = (id) => /** @type {any} */ (document.getElementById(id));

let known = location.hash;
addEventListener("hashchange", () => { known = location.hash; });

/**
 * Shows the address of a scene. An address that the visitor has just opened stays: the page is about to be told of it.
 * @param {string} hash  with "#" @param {boolean} isNew  whether to add an entry to the browser's history
 */
export function showAddress(hash, isNew) {
  if (hash === location.hash || location.hash !== known) return;
  history[isNew ? "pushState" : "replaceState"](null, "", hash);
  known = location.hash;
}

/** Selects the displayed scene in the lists, or nothing for a model that is not from the catalogue. @param {any} catalogue @param {SceneId | null} sceneId */
export function showChoice(catalogue, sceneId) {
  const variants = catalogue.environments.filter((/** @type {SceneId} */ one) => one.task === sceneId?.task);
  element("variant").replaceChildren(...variants.map((/** @type {SceneId} */ one) => new Option(one.variant)));
  for (const name of /** @type {const} */ (["task", "variant", "seed"])) element(name).value = sceneId?.[name] ?? "";
  for (const name of ["variant", "seed"]) element(name).disabled = !sceneId;
  element("play").hidden = !sceneId;
  if (sceneId) element("play").href = `./#${addressOf(sceneId)}`;
}

/** Lists the tasks, and calls back for each selection. @param {any} catalogue @param {(sceneId: SceneId) => void} chosen */
export function onChoice(catalogue, chosen) {
  const { task, variant, seed } = { task: element("task"), variant: element("variant"), seed: element("seed") };
  const choose = (/** @type {number} */ number) => chosen({ ...parseAddress(`#${task.value}-${variant.value}`, catalogue), seed: number });
  task.replaceChildren(...Object.keys(catalogue.tasks).map((name) => new Option(name)));
  task.onchange = () => choose(0);
  for (const field of [variant, seed]) field.onchange = () => choose(Math.max(0, Math.floor(Number(seed.value))));
  showChoice(catalogue, null);
}

/**
 * The scene of the catalogue that is named in an exported file. Null for any other model.
 * @param {Record<string, string>} texts  of the file
 * @param {any} catalogue
 * @returns {SceneId | null}
 */
export function sceneIdOf({ task, variant, seed, shifts = "", scene }, catalogue) {
  if (!task || !variant || !seed || !scene) return null;
  const { body } = JSON.parse(scene).robot, all = [shifts, body ? `body:${body}` : ""].filter(Boolean).join(",");
  const { unknown, method, ...sceneId } = parseAddress(`#${task}-${variant}-${seed}?${new URLSearchParams({ shifts: all })}`, catalogue);
  return unknown ? null : sceneId;
}
