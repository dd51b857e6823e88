// @ts-check
/**
 * What the part of an address after `#` asks for: `#FindDupe-All-3`, and `#FindDupe-Layout-7@state-bc` to watch a method.
 * @typedef {{task: string, variant: string, seed: number, method: string, unknown: string}} Wish
 *   method: "" for none; unknown: what is wrong with the address, and what is shown instead; "" if nothing is
 */

/**
 * @param {string} hash
 * @param {{environments: {task: string, variant: string}[]}} catalogue
 * @returns {Wish}
 */
export function parseAddress(hash, { environments }) {
  const [place, method = ""] = decodeURIComponent(hash.slice(1)).split("@");
  const [asked, variantAsked = "", ...rest] = place.split("-"), seedAsked = rest.join("-");
  const tasks = [...new Set(environments.map(({ task }) => task))], task = nearest(asked, tasks);
  const variants = environments.filter((one) => one.task === task).map(({ variant }) => variant), variant = nearest(variantAsked, variants);
  const isNumber = /^\d+$/.test(seedAsked) && Number.isSafeInteger(Number(seedAsked)), seed = isNumber ? Number(seedAsked) : 0;
  const wrong = [
    asked && asked !== task ? `no task “${asked}”` : "", variantAsked && variantAsked !== variant ? `no variant “${variantAsked}” of ${task}` : "",
    seedAsked && !isNumber ? `no scene “${seedAsked}”` : "",
  ].filter(Boolean);
  return { task, variant, seed, method, unknown: wrong.length ? `There is ${wrong.join(", and ")}: this is ${task}-${variant}-${seed}` : "" };
}

/** The name that differs least from the one asked for; the first one where nothing was. @param {string} asked @param {string[]} names */
export function nearest(asked, names) {
  if (!asked) return names[0];
  const distances = names.map((name) => distance(asked.toLowerCase(), name.toLowerCase()));
  return names[distances.indexOf(Math.min(...distances))];
}

/** How many letters must be changed, added or left out. @param {string} one @param {string} other */
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
