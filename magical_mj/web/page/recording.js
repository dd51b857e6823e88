// @ts-check
/**
 * A played episode as a small file for replays, without data about the player. `magical_mj.demos.recording` describes it.
 * @typedef {{task: string, variant: string, seed: number, game: import("./game.js").Game | null}} Played
 */
import { poses } from "./scene.js";

const FORMAT = 1;

/**
 * @param {Played} played
 * @param {number} protocol  the protocol number
 */
export function recording({ task, variant, seed, game }, protocol) {
  if (!game) throw new Error("nothing was played");
  return { format: FORMAT, protocol, task, variant, seed, actions: game.actions, final: poses(game.now) };
}

/** Offers a recording as a download. @param {ReturnType<typeof recording>} data @param {string} name */
export function save(data, name) {
  download(`${name}.json`, new Blob([JSON.stringify(data)], { type: "application/json" }));
}

/** @param {string} name @param {Blob} content */
export function download(name, content) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(content);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);  // a busy browser reads it later
}
