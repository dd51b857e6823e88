// @ts-check
/**
 * What was played as a small file: enough to replay it, and nothing about who played.
 * @typedef {{task: string, variant: string, seed: number, game: import("./game.js").Game | null}} Played
 */
import { poses } from "./scene.js";

const FORMAT = 1;

/** @param {Played} played */
export function recording({ task, variant, seed, game }) {
  if (!game) throw new Error("nothing was played");
  return { format: FORMAT, task, variant, seed, actions: game.actions, final: poses(game.now) };
}

/** Offers a recording as a download. @param {ReturnType<typeof recording>} data */
export function save(data) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([JSON.stringify(data)], { type: "application/json" }));
  link.download = `${data.task}-${data.variant}-${data.seed}.json`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href));
}
