// @ts-check
/** The lists of shifts. */
import { isChange } from "./scenes.js";

/**
 * Lists the shifts that a scene can have, and selects those that it has.
 * @param {HTMLElement} box @param {Record<string, string[]>} all  axis -> strengths, or bodies @param {{shifts: string, scene: string}} shown
 */
export function showShifts(box, all, { shifts, scene }) {
  const chosen = Object.fromEntries(shifts.split(",").map((one) => one.split(":")));
  box.replaceChildren(...Object.entries(all).filter(([axis]) => !scene || isChange(axis)).map(([axis, levels]) => {
    const label = document.createElement("label"), select = document.createElement("select");
    select.name = axis;
    select.append(new Option(axis === "body" ? "gripper" : "0", ""), ...levels.map((level) => new Option(level)));
    select.value = chosen[axis] ?? "";
    label.append(`${axis[0].toUpperCase()}${axis.slice(1)} `, select);
    return label;
  }));
}

/** The chosen shifts as in addresses. An exclusive one that was just chosen replaces others. @param {HTMLElement} box @param {HTMLSelectElement} chosen @param {string[][]} exclusive */
export function chosenShifts(box, chosen, exclusive) {
  const isLeft = (/** @type {HTMLSelectElement} */ { name }) => name === chosen.name || !exclusive.some((pair) => pair.includes(name) && pair.includes(chosen.name));
  return [...box.querySelectorAll("select")].filter((one) => one.value && isLeft(one)).map(({ name, value }) => `${name}:${value}`).join(",");
}
