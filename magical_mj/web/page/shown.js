// @ts-check
/** What the page for playing shows at present, and what it knows from the start. */
import { loadMethods } from "./replays.js";
import { fetchJson } from "./scenes.js";

/** @param {string} id */
export const element = (id) => /** @type {any} */ (document.getElementById(id));
export const catalogue = await fetchJson("catalogue.json");
/** Whether the server simulates, and not this page. */
export const isServed = catalogue.simulation === "server";
/** The features that participants of a study may use. Without a study, all of them. @param {string} what */
export const may = (what) => !catalogue.collects || catalogue.shows.includes(what);
export const methods = isServed ? {} : await loadMethods();
/** @type {Record<string, Record<string, number>>} the mean scores of these policies, by task and variant */
export const policies = isServed ? {} : await fetchJson("policies/scores.json");

/** The current state of the page. */
export const shown = {
  task: "", variant: "", seed: -1, shifts: "", /** a changed scene, as JSON, or "" */ scene: "",
  /** a visitor's intent as text, or "" */ intent: "", /** the same in this scene @type {import("./ownintent.js").OwnIntent | null} */ wanted: null, editing: false, horizon: 1, watching: false, sending: false, note: "", helped: false, practice: false,
  /** what is watched, as in addresses, or "" */ method: "", /** whether the player has taken over */ taken: false,
  /** @type {import("./scenes.js").Environment} */ environment: { scenes: [], horizon: 1, demonstrations: [] },
  /** @type {import("./puzzles.js").Judged} */ judged: {}, /** the episode whose outcome is shown @type {import("./game.js").Game | null} */ told: null, /** which rival it reached, in words */ rival: "",
  /** @type {import("./game.js").Game | null} */ game: null,
  /** @type {(() => void) | null} draws it again */ again: null,
};
