// @ts-check
/**
 * Which blocks an intent selects in an initial scene, the same as in magical_mj/intents. Tests compare them.
 * @typedef {import("./scene.js").Scene} Scene
 * @typedef {import("./intent.js").Part} Part
 * @typedef {import("./intent.js").Grammar} Grammar
 */
import { distance, shares } from "./goal.js";
import { isRest } from "./intent.js";
import { contains, inside } from "./score.js";

const TIE = 0.05, LEAST_ODD = 3;
/** Ends what is undefined in the scene. @param {string} why @returns {never} */
const undefinedThere = (why) => { throw new Error(why); };
/** @param {Scene} scene */
const all = ({ blocks }) => [...blocks.keys()];
/** @param {Scene} scene */
const theRegion = ({ regions }) => regions.length === 1 ? regions[0] : undefinedThere(`the scene has ${regions.length} regions`);
/** The first region that contains a block's centre. @param {Scene} scene @param {number} i */
const homeOf = ({ regions, blocks }, i) => regions.find((region) => contains(region, blocks[i]));

/** The block that a reference names. @param {string} reference @param {Scene} scene */
function blockOf(reference, scene) {
  const found = all(scene).filter((i) => reference.split(" ").every((word) => [scene.blocks[i].colour, scene.blocks[i].shape].includes(word)));
  return found.length === 1 ? found[0] : undefinedThere(`${found.length || "no"} block${found.length ? "s fit" : " fits"} “${reference}”`);
}

/** @type {Record<string, (value: string, equal: boolean, scene: Scene) => number[]>} name of a test -> the blocks that pass it */
const TESTS = {
  colour(value, equal, scene) {
    const wanted = value === "region" ? theRegion(scene).colour : value;
    return all(scene).filter((i) => (scene.blocks[i].colour === wanted) === equal);
  },
  shape: (value, equal, scene) => all(scene).filter((i) => (scene.blocks[i].shape === value) === equal),
  like(value, equal, scene) {
    const inner = inside(theRegion(scene), scene.blocks), model = scene.blocks[inner[0]];
    if (inner.length !== 1) undefinedThere(`${inner.length} blocks start in the region`);
    const names = /** @type {("colour" | "shape")[]} */ (value === "both" ? ["colour", "shape"] : [value]);
    return all(scene).filter((i) => i !== inner[0] && names.every((name) => scene.blocks[i][name] === model[name]) === equal);
  },
  starts(value, _, scene) {
    if (!scene.regions.length) undefinedThere("the scene has no region");
    return all(scene).filter((i) => {
      const home = homeOf(scene, i);
      if (["in", "out"].includes(value)) return Boolean(home) === (value === "in");
      return home !== undefined && (home.colour === scene.blocks[i].colour) === (value === "matched");
    });
  },
  odd(value, _, scene) {
    const values = scene.blocks.map((block) => block[/** @type {"colour" | "shape"} */ (value)]);
    const lone = all(scene).filter((i) => values.filter((one) => one === values[i]).length === 1);
    return values.length >= LEAST_ODD && lone.length === 1 && new Set(values).size === 2 ? lone : undefinedThere("no block is the odd one out");
  },
  nearest: (value, _, scene) => [extreme(scene, value, 1)],
  farthest: (value, _, scene) => [extreme(scene, value, -1)],
};

/** The nearest block to a reference (sign 1), or the farthest (-1). @param {Scene} scene @param {string} reference @param {number} sign */
function extreme(scene, reference, sign) {
  const region = reference === "region" ? theRegion(scene) : null, itself = region || reference === "robot" ? -1 : blockOf(reference, scene);
  const from = region ? { x: (region.x_min + region.x_max) / 2, y: (region.y_min + region.y_max) / 2 } : scene.blocks[itself] ?? scene.robot;
  const ways = all(scene).filter((i) => i !== itself).map((i) => ({ i, way: sign * distance(scene.blocks[i], from) })).sort((a, b) => a.way - b.way);
  return ways.length > 1 && ways[1].way - ways[0].way >= TIE ? ways[0].i : undefinedThere(`two blocks are about equally far from the ${reference}`);
}

/**
 * An intent in an initial scene. Throws an error that says why it is undefined there.
 * @param {Part[]} intent @param {Scene} scene @param {Grammar} grammar
 * @returns {import("./goal.js").Conjunct[]}
 */
export function goalIn(intent, scene, { relations }) {
  const isOfBlocks = (/** @type {Part} */ { relation }) => relations[relation].ofBlocks;
  const selected = (/** @type {Part} */ part) => part.tests.reduce((left, { name, value, equal }) => {
    const passing = TESTS[name](value, equal, scene);
    return left.filter((i) => passing.includes(i));
  }, all(scene));
  const named = new Set(intent.filter((part) => isOfBlocks(part) && !isRest(part)).flatMap(selected));
  return intent.map((part) => {
    const chosen = !isOfBlocks(part) ? [] : isRest(part) ? all(scene).filter((i) => !named.has(i)) : selected(part);
    return conjunct(part, chosen, scene, relations[part.relation].least);
  });
}

/** One relation about the chosen blocks, without those that it does not apply to. @param {Part} part @param {number[]} chosen @param {Scene} scene @param {number} least */
function conjunct({ relation, argument, number, some }, chosen, scene, least) {
  if (["in", "out"].includes(relation) && !scene.regions.length) undefinedThere("the scene has no region");
  if (["exactly", "robot in"].includes(relation)) theRegion(scene);
  if (relation === "clustered" && new Set(scene.blocks.map((block) => block[/** @type {"colour" | "shape"} */ (argument)])).size < 2) {
    undefinedThere(`all blocks have the same ${argument}`);
  }
  const other = ["near", "robot near"].includes(relation) ? blockOf(argument, scene) : -1;
  const blocks = chosen.filter((i) => argument === "home" ? homeOf(scene, i) : relation !== "near" || i !== other);
  if (!relation.startsWith("robot") && blocks.length < Math.max(least, number)) undefinedThere(`${relation}(…) is about ${blocks.length || "no"} block${blocks.length > 1 ? "s" : ""}`);
  return { relation, blocks, argument: other < 0 ? argument : other, number, some };
}

/**
 * Why no episode of an intent starts in a scene; "" if one does.
 * @param {Part[]} intent @param {Scene} scene @param {Grammar} grammar
 */
export function lackOf(intent, scene, grammar) {
  try {
    const goal = goalIn(intent, scene, grammar), now = shares(goal, scene, scene);
    const counted = now.filter((share, i) => share < 1 || !keeps(intent[i], grammar));
    const isNearly = !counted.length || counted.reduce((sum, share) => sum + share) / counted.length >= grammar.nearly;
    return isNearly ? "at least half of the intent is satisfied there" : "";
  } catch (error) {
    return /** @type {Error} */ (error).message;
  }
}

/** Whether a relation asks to change nothing where it holds. @param {Part} part @param {Grammar} grammar */
const keeps = ({ relation, argument, tests }, { relations }) => relations[relation].least === 0 || argument === "home"
  || tests.some(({ name, value }) => name === "starts" && value !== "out");
