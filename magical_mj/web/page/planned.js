// @ts-check
/**
 * An end of a scene that satisfies a goal, found by moving one object at a time to the best of many places. It is a
 * picture for visitors. Plans for episodes are those of `magical_mj.intents.plans`.
 * @typedef {import("./scene.js").Scene} Scene
 * @typedef {import("./goal.js").Conjunct} Conjunct
 */
import { distance, share } from "./goal.js";

const GRID = [-0.84, -0.7, -0.56, -0.42, -0.28, -0.14, 0, 0.14, 0.28, 0.42, 0.56, 0.7, 0.84];  // times the half width of the arena
const FREE = 0.27, CLEAR = 0.4, MARGIN = 0.05;  // world units: the least distance of two blocks, of a block and the robot, and of a block and a border
const TRIES = 24, MOVES = 12;

/** The cheapest of some ends that satisfy a goal; null if none was found. @param {Conjunct[]} goal @param {Scene} initial @returns {Scene | null} */
export function plannedEnd(goal, initial) {
  const random = randomFrom(1), places = placesIn(initial), pick = (/** @type {any[]} */ all) => all[Math.floor(random() * all.length)], movable = movableBy(goal, initial), aims = goal.flatMap((one) => one.relation === "exactly" ? counted(one, initial) : one);
  let best = /** @type {Scene | null} */ (null);
  for (let i = 0; i < TRIES; i++) {
    let start = initial;  // a random arrangement of more and more blocks, except in the first attempts
    for (let k = 0; k < i / 3; k++) start = placed(start, pick(movable), pick(places)) ?? start;
    const end = improved(aims, initial, start, movable, places);
    if (share(goal, initial, end) === 1 && (!best || effort(initial, end) < effort(initial, best))) best = end;
    if (best && i >= 3) return best;
  }
  return best;
}

/** The blocks nearest to the region in it, and the others outside. @param {Conjunct} exactly @param {Scene} scene @returns {Conjunct[]} */
function counted({ blocks, number, ...rest }, { regions: [{ x_min, x_max, y_min, y_max }], blocks: all }) {
  const centre = { x: (x_min + x_max) / 2, y: (y_min + y_max) / 2 }, order = [...blocks].sort((a, b) => distance(all[a], centre) - distance(all[b], centre));
  return [{ ...rest, number: 0, relation: "in", blocks: order.slice(0, number) }, { ...rest, number: 0, relation: "out", blocks: order.slice(number) }];
}

/** The sum of the distances between the places of blocks and of the robot, and a constant for each that moves. @param {Scene} initial @param {Scene} end */
function effort(initial, end) {
  const ways = [initial.robot, ...initial.blocks].map((one, i) => distance(one, i ? end.blocks[i - 1] : end.robot)).filter((way) => way > 0);
  return ways.reduce((sum, way) => sum + way + 1, 0);
}

/** The objects that a goal is about: indices of blocks, and -1 for the robot. @param {Conjunct[]} goal @param {Scene} scene */
function movableBy(goal, { blocks }) {
  const moves = goal.filter(({ relation }) => relation !== "untouched"), named = new Set(moves.flatMap(({ relation, blocks, argument }) =>
    relation.startsWith("robot") ? [-1] : relation === "near" ? [...blocks, Number(argument)] : relation === "clustered" ? [] : blocks));
  return moves.some(({ relation }) => relation === "clustered") ? [...blocks.keys(), ...named.has(-1) ? [-1] : []] : [...named];
}

/** Moves objects to places as long as more of the goal holds, or the same with less effort. @param {Conjunct[]} goal @param {Scene} initial @param {Scene} start @param {number[]} movable @param {import("./goal.js").Point[]} places */
function improved(goal, initial, start, movable, places) {
  const worth = (/** @type {Scene} */ end) => share(goal, initial, end) - 0.002 * effort(initial, end);
  let now = start, value = worth(start);
  for (let k = 0; k < MOVES; k++) {
    let best = now, most = value;
    for (const i of movable) for (const place of [i < 0 ? initial.robot : initial.blocks[i], ...places]) {
      const next = placed(now, i, place), points = next ? worth(next) : -1;
      if (next && points > most + 1e-9) [best, most] = [next, points];
    }
    if (best === now) break;
    [now, value] = [best, most];
  }
  return now;
}

/** The scene with one object elsewhere; null if the place is not free. @param {Scene} scene @param {number} i @param {{x: number, y: number}} place */
function placed(scene, i, { x, y }) {
  const isRobot = i < 0, taken = scene.blocks.some((block, k) => k !== i && Math.abs(block.x - x) < CLEAR && distance(block, { x, y }) < (isRobot ? CLEAR : FREE));
  if (taken) return null;
  return isRobot ? { ...scene, robot: { ...scene.robot, x, y } } : { ...scene, blocks: scene.blocks.map((block, k) => k === i ? { ...block, x, y } : block) };
}

/** Places in a grid over the arena, but not at the border of a region, and in each region. @param {Scene} scene */
function placesIn({ half_width: half = 1, regions }) {
  const inner = regions.flatMap(({ x_min, y_min, x_max, y_max }) => [-0.3, 0, 0.3].flatMap((u) => [-0.3, 0, 0.3].map((v) => (
    { x: (x_min + x_max) / 2 + u * (x_max - x_min), y: (y_min + y_max) / 2 + v * (y_max - y_min) }))));
  const isClear = (/** @type {import("./goal.js").Point} */ { x, y }) => regions.every(({ x_min, x_max, y_min, y_max }) =>
    Math.abs(Math.max(x_min - x, x - x_max, y_min - y, y - y_max)) > MARGIN);
  return [...GRID.flatMap((u) => GRID.map((v) => ({ x: u * half, y: v * half }))).filter(isClear), ...inner];
}

/** Random numbers that are the same at each visit. @param {number} seed */
export function randomFrom(seed) {
  let state = seed;
  return () => (state = (state * 16807) % 2147483647) / 2147483647;
}
