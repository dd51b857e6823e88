// @ts-check
/**
 * What an episode of one of the eight tasks pursued, the same as in magical_mj/web/pursued.py. Tests compare them.
 * @typedef {import("./scene.js").Scene} Scene
 * @typedef {{blocks: {shape: string, colour: string, x: number, y: number}[], regions: import("./scene.js").Region[]}} Demonstrated
 *   blocks: those that the demonstrations move
 * @typedef {{sentence: string, moved: number[], intended: number[]}} Pursued  moved, intended: indices of blocks
 */
import { STAYED, distance, unmet } from "./goal.js";
import { alike, contains, inside } from "./score.js";

const SAME_PLACE = 0.3;  // world units
const NUMBERS = ["no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine"];

/** @param {string} relation @param {number[]} blocks @param {{argument?: string, some?: boolean}} [rest] @returns {import("./goal.js").Conjunct} */
const conjunct = (relation, blocks, { argument = "", some = false } = {}) => ({ relation, blocks, argument, number: 0, some });
const all = (/** @type {Scene} */ { blocks }) => [...blocks.keys()];

/** The intents of the eight tasks. @type {Record<string, (scene: Scene) => import("./goal.js").Conjunct[]>} */
const INTENTS = {
  MoveToCorner: (scene) => [conjunct("near corner", all(scene), { argument: "top left" })],
  MoveToRegion: () => [conjunct("robot in", [])],
  MatchRegions(scene) {
    const { blocks, regions: [{ colour }] } = scene, fits = (/** @type {number} */ i) => blocks[i].colour === colour;
    return [conjunct("in", all(scene).filter(fits)), conjunct("out", all(scene).filter((i) => !fits(i)))];
  },
  MakeLine: (scene) => [conjunct("line", all(scene))],
  FindDupe(scene) {
    const [query] = inside(scene.regions[0], scene.blocks), fits = (/** @type {number} */ i) => alike(scene.blocks[i], scene.blocks[query]);
    const others = all(scene).filter((i) => i !== query);
    return [conjunct("in", [query]), conjunct("in", others.filter(fits), { some: true }), conjunct("out", others.filter((i) => !fits(i)))];
  },
  FixColour(scene) {
    const { regions, blocks } = scene, home = (/** @type {number} */ i) => regions.find((region) => contains(region, blocks[i]));
    const within = all(scene).filter(home), fits = (/** @type {number} */ i) => home(i)?.colour === blocks[i].colour;
    return [conjunct("in", within.filter(fits), { argument: "home" }), conjunct("out", within.filter((i) => !fits(i)))];
  },
  ClusterColour: (scene) => [conjunct("clustered", all(scene), { argument: "colour" })],
  ClusterShape: (scene) => [conjunct("clustered", all(scene), { argument: "shape" })],
};

/**
 * What an episode pursued. Null if the task is not one of the eight.
 * @param {string} task @param {Demonstrated} demonstrated @param {Scene} initial @param {Scene} final @param {number} score
 * @returns {Pursued | null}
 */
export function pursued(task, demonstrated, initial, final, score) {
  if (!(task in INTENTS)) return null;
  const goal = INTENTS[task](initial), left = goal.map((one) => unmet(one, initial)), intended = [...new Set(left.flat())].sort((a, b) => a - b);
  const moved = all(initial).filter((i) => distance(initial.blocks[i], final.blocks[i]) > STAYED);
  const said = (/** @type {string} */ sentence) => ({ sentence, moved, intended });
  if (score === 1) {
    const others = moved.filter((i) => !goal.some(({ blocks }) => blocks.includes(i)));
    return said(`It did what was intended${others.length ? `, and also moved ${named(others, initial)}` : ""}.`);
  }
  if (!initial.blocks.length) return said(`${driven(demonstrated, initial, final)} Intended: the goal region.`);
  const right = moved.filter((i) => intended.includes(i)), wrong = moved.filter((i) => !intended.includes(i));
  if (right.length) {
    const also = wrong.length ? ` It also moved ${named(wrong, initial, { after: right })}.` : "";
    return said(`It moved ${named(right, initial)}, as intended, but did not solve the task.${also}`);
  }
  const names = goal.flatMap(({ some }, i) => left[i].length ? [named(left[i], initial, { one: some, after: wrong })] : []);
  return said(`${wrong.length ? reasons(wrong, demonstrated, initial) : "It moved no block."} Intended: ${names.length ? joined(names) : "no block"}.`);
}

/** Where the robot drove. @param {Demonstrated} demonstrated @param {Scene} initial @param {Scene} final */
function driven({ regions }, initial, { robot }) {
  if (distance(initial.robot, robot) <= STAYED) return "The robot stayed where it began.";
  return regions.some((region) => contains(region, robot)) ? "It drove to where the demonstrations' region was." : "It drove elsewhere.";
}

/** The block nearest to a point. @param {import("./goal.js").Point} point @param {Scene} scene */
const nearest = (point, { blocks }) => [...blocks.keys()].reduce((best, i) => distance(blocks[i], point) < distance(blocks[best], point) ? i : best, 0);

/** Which wrong blocks were moved, and what each has in common with the demonstrations' blocks. @param {number[]} wrong @param {Demonstrated} demonstrated @param {Scene} initial */
function reasons(wrong, { blocks: models }, initial) {
  const { blocks, robot } = initial, model = models.length === 1 ? "the demonstrations' block" : "a block of the demonstrations";
  const unlike = `is unlike the demonstrations' block${models.length === 1 ? "" : "s"} in place, colour and shape`;
  const places = models.flatMap((one) => {
    const near = nearest(one, initial);
    return distance(blocks[near], one) <= SAME_PLACE ? [near] : [];
  });
  const reason = (/** @type {number} */ i) => {
    const looks = /** @type {const} */ (["colour", "shape"]).filter((name) => models.some((one) => one[name] === blocks[i][name]));
    return [
      places.includes(i) && `began where ${model} began`,
      looks.length && `has the ${looks.join(" and the ")} of ${model}`,
      i === nearest(robot, initial) && "was nearest to the robot",
    ].filter(Boolean).join(", and ") || unlike;
  };
  if (wrong.length === 1) return `It moved ${named(wrong, initial)}, which ${reason(wrong[0])}.`;
  const each = wrong.map((i) => [named([i], initial), reason(i)]).map(([name, why]) => `${name[0].toUpperCase()}${name.slice(1)} ${why}.`);
  return [`It moved ${named(wrong, initial)}.`, ...new Set(each)].join(" ");
}

/**
 * Some blocks in words, such as "the red star and two green squares".
 * @param {number[]} indices @param {Scene} scene
 * @param {{one?: boolean, after?: number[]}} [how]  one: one of each kind; after: blocks that are named before, so others are "another red star"
 */
function named(indices, { blocks }, { one = false, after = [] } = {}) {
  const looks = blocks.map(({ colour, shape }) => `${colour} ${shape}`), chosen = indices.map((i) => looks[i]), before = after.map((i) => looks[i]);
  if (chosen.length === looks.length && looks.length > 2 && !one) return "all blocks";
  return joined([...new Set(chosen)].map((look) => {
    const number = (/** @type {string[]} */ some) => some.filter((other) => other === look).length;
    const count = one ? 1 : number(chosen), every = count === number(looks) ? "the " : "", single = before.includes(look) ? "another " : every || "a ";
    return count === 1 ? `${single}${look}` : `${every}${NUMBERS[count]} ${look}s`;
  }));
}

/** @param {string[]} names */
const joined = (names) => names.length > 1 ? `${names.slice(0, -1).join(", ")} and ${names.at(-1)}` : names[0];
