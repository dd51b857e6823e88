// @ts-check
/**
 * Parses the part of an address after `#`: `#FindDupe-All-3`, `#FindDupe-Layout-7@state-bc` to watch a method, and
 * `#FindDupe-Demo-0?shifts=clutter:3,friction:2` with shifts, or another body: `#SweepToTop-Layout-2?shifts=body:longstick`,
 * and `#FindDupe-Demo-0?scene={...}` with a scene that the visitor changed, as JSON. `intent=...` comes last: the goal is an
 * intent, `#FindDupe-All-3?intent=in(colour=red, region)`.
 * @typedef {{task: string, variant: string, seed: number, shifts: string, scene?: string, intent?: string}} SceneId
 *   shifts: "" without shifts; scene: "" if it is the seed's; intent: "" if the goal is the task's
 * @typedef {SceneId & {method: string, unknown: string}} Wish
 *   method: "" without a method; unknown: the error in the address and the scene shown instead, "" without an error
 * @typedef {{task: string, variant: string, shifts: Record<string, string[]>}} Environment  shifts: axis -> strengths, or bodies
 */

/**
 * @param {string} hash
 * @param {{environments: Environment[], exclusive?: string[][]}} catalogue  exclusive: pairs of axes that cannot be combined
 * @returns {Wish}
 */
export function parseAddress(hash, { environments, exclusive = [] }) {
  const [all, method = ""] = decoded(hash.slice(1)).split("@");
  const [name, query = ""] = all.split("?"), [settings, intent = ""] = query.split(/&?\bintent=/);
  const values = new URLSearchParams(settings), scene = values.get("scene") ?? "", shiftsAsked = values.get("shifts") ?? "";
  const [asked, variantAsked = "", ...rest] = name.split("-"), seedAsked = rest.join("-");
  const tasks = [...new Set(environments.map(({ task }) => task))], task = nearest(asked, tasks);
  const variants = environments.filter((one) => one.task === task).map(({ variant }) => variant), variant = nearest(variantAsked, variants);
  const there = shiftsOf({ task, variant }, environments), { shifts, wrong: wrongShifts } = chosenShifts(shiftsAsked, there, exclusive);
  const isNumber = /^\d+$/.test(seedAsked) && Number.isSafeInteger(Number(seedAsked)), seed = isNumber ? Number(seedAsked) : 0;
  const wrong = [
    asked && asked !== task ? `no task “${asked}”` : "", variantAsked && variantAsked !== variant ? `no variant “${variantAsked}” of ${task}` : "",
    ...wrongShifts.map((one) => `no shift “${one}” of ${task}-${variant}`), seedAsked && !isNumber ? `no scene “${seedAsked}”` : "",
  ].filter(Boolean);
  const found = { task, variant, seed, shifts, scene, intent };
  return { ...found, method, unknown: wrong.length ? `There is ${wrong.join(", and ")}: this is ${addressOf(found)}` : "" };
}

/** The text that is encoded in an address. Text that is not encoded correctly stays. @param {string} text */
function decoded(text) {
  try {
    return decodeURIComponent(text);
  } catch {
    return text;
  }
}

/** The address of a scene, without `#`. @param {SceneId} sceneId */
export function addressOf({ task, variant, seed, shifts, scene, intent }) {
  const settings = [shifts && `shifts=${shifts}`, scene && `scene=${encodeURI(scene)}`, intent && `intent=${encodeURI(intent)}`].filter(Boolean).join("&");
  return `${task}-${variant}-${seed}${settings && `?${settings}`}`;
}

/** @param {{task: string, variant: string}} name @param {Environment[]} environments @returns {Record<string, string[]>} */
export const shiftsOf = ({ task, variant }, environments) =>
  environments.find((one) => one.task === task && one.variant === variant)?.shifts ?? {};

/**
 * The available shifts most similar to the requested ones, in the order of `there`, and the requested ones that are not available.
 * @param {string} asked  such as "clutter:3,friction:2" @param {Record<string, string[]>} there  axis -> strengths, or bodies
 * @param {string[][]} exclusive  pairs of axes of which only the first one is taken
 */
function chosenShifts(asked, there, exclusive) {
  /** @type {Record<string, string>} */
  const found = {}, wrong = [];
  for (const one of asked.split(/[,+]/).filter(Boolean)) {
    const all = Object.entries(there).flatMap(([axis, levels]) => levels.map((level) => `${axis}:${level}`));
    const name = all.length ? nearest(one, all) : "", [axis, level] = name.split(":");
    const isTaken = axis in found || exclusive.some((pair) => pair.includes(axis) && pair.some((other) => other in found));
    if (name !== one || isTaken) wrong.push(one);
    if (name && !isTaken) found[axis] = level;
  }
  return { shifts: Object.keys(there).filter((axis) => axis in found).map((axis) => `${axis}:${found[axis]}`).join(","), wrong };
}

/** The name most similar to the requested one. The first one if none is requested. @param {string} asked @param {string[]} names */
export function nearest(asked, names) {
  if (!asked) return names[0];
  const distances = names.map((name) => distance(asked.toLowerCase(), name.toLowerCase()));
  return names[distances.indexOf(Math.min(...distances))];
}

/** The edit distance of two texts. @param {string} one @param {string} other */
function distance(one, other) {
  let row = Array.from({ length: other.length + 1 }, (_, i) => i);
  for (let i = 1; i <= one.length; i++) {
    row = row.reduce((/** @type {number[]} */ next, above, j) => {
      next.push(j === 0 ? i : Math.min(above + 1, next[j - 1] + 1, row[j - 1] + Number(one[i - 1] !== other[j - 1])));
      return next;
    }, []);
  }
  return row[other.length];
}
