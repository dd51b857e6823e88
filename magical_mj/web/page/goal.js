// @ts-check
/**
 * The scores of intents, the same as in magical_mj/intents. Tests compare them. Python selects the blocks: a goal is an
 * intent in one initial scene, from `magical_mj.web.puzzles.goal_data`, or from selectors.js.
 * @typedef {import("./scene.js").Scene} Scene
 * @typedef {{relation: string, blocks: number[], argument: string | number, number: number, some: boolean}} Conjunct
 *   blocks: indices of those that the relation is about; argument: the index of a block if it names one
 * @typedef {Conjunct[] | null} Goal  null: the intent is undefined in the scene
 */
import { contains, longestLine, rightBlocks } from "./score.js";

export const STAYED = 0.15;  // world units, as are these
const NEAR = 0.45, APART = 0.7, AT_WALL = 0.25, ROBOT_AT_WALL = 0.3, IN_CORNER = 0.6, NEAR_CORNER = Math.SQRT2 / 2;
/** @type {Record<string, number[]>} */
const WALLS = { left: [-1, 0], right: [1, 0], bottom: [0, -1], top: [0, 1] };
/** @type {Record<string, number[]>} */
const CORNERS = { "top left": [-1, 1], "top right": [1, 1], "bottom left": [-1, -1], "bottom right": [1, -1] };

/** @typedef {{x: number, y: number}} Point */
/** @param {Point} one @param {Point} other */
export const distance = (one, other) => Math.hypot(one.x - other.x, one.y - other.y);
/** The chosen direction, or all of them. @param {Record<string, number[]>} all @param {string | number} name */
const directions = (all, name) => name === "any" ? Object.values(all) : [all[name]];
/** The distance from a wall, or from the nearest. @param {Point} body @param {string | number} wall @param {Scene} scene */
const fromWall = ({ x, y }, wall, { half_width: half = 1 }) => half - Math.max(...directions(WALLS, wall).map(([u, v]) => u * x + v * y));
/** The distance from a corner, or from the nearest. @param {Point} body @param {string | number} corner @param {Scene} scene */
const fromCorner = (body, corner, { half_width: half = 1 }) => Math.min(...directions(CORNERS, corner).map(([u, v]) => distance(body, { x: u * half, y: v * half })));

/** @type {Record<string, (conjunct: Conjunct, initial: Scene, final: Scene) => boolean[]>} relation -> whether it holds, for each object */
const RELATIONS = {
  in: ({ blocks, argument }, initial, { regions, blocks: now }) => blocks.map((i) => argument === "home"
    ? contains(regions[initial.regions.findIndex((region) => contains(region, initial.blocks[i]))], now[i])
    : regions.some((region) => contains(region, now[i]))),
  out: ({ blocks }, _, { regions, blocks: now }) => blocks.map((i) => !regions.some((region) => contains(region, now[i]))),
  exactly: ({ blocks, number }, _, { regions: [region], blocks: now }) => [blocks.filter((i) => contains(region, now[i])).length === number],
  wall: ({ blocks, argument }, _, final) => blocks.map((i) => fromWall(final.blocks[i], argument, final) <= AT_WALL),
  corner: ({ blocks, argument }, _, final) => blocks.map((i) => fromCorner(final.blocks[i], argument, final) <= IN_CORNER),
  "near corner": ({ blocks, argument }, _, final) => blocks.map((i) => fromCorner(final.blocks[i], argument, final) <= NEAR_CORNER),
  near: ({ blocks, argument }, _, { blocks: now }) => blocks.map((i) => distance(now[i], now[Number(argument)]) <= NEAR),
  apart: ({ blocks }, _, { blocks: now }) => blocks.map((i) => blocks.every((k) => k === i || distance(now[i], now[k]) >= APART)),
  line: ({ blocks }, _, { blocks: now }) => {
    const right = longestLine(blocks.map((i) => now[i]));
    return blocks.map((_, i) => i < right);
  },
  clustered: ({ blocks, argument }, _, { blocks: now }) => {
    const right = rightBlocks(now, (block) => argument === "colour" ? block.colour : block.shape);
    return blocks.map((i) => right[i]);
  },
  untouched: ({ blocks }, initial, { blocks: now }) => blocks.map((i) => distance(initial.blocks[i], now[i]) <= STAYED),
  "robot in": (_, __, { regions: [region], robot }) => [contains(region, robot)],
  "robot near": ({ argument }, _, { robot, blocks }) => [distance(robot, blocks[Number(argument)]) <= NEAR],
  "robot wall": ({ argument }, _, final) => [fromWall(final.robot, argument, final) <= ROBOT_AT_WALL],
};

/** The relations that judge each block by itself. */
const SINGLE = ["in", "out", "wall", "corner", "near corner", "near", "untouched"];

/** The blocks of a relation that still have to move in a scene, one or all of them. @param {Conjunct} conjunct @param {Scene} scene */
export function unmet(conjunct, scene) {
  const { relation, blocks, some } = conjunct, parts = RELATIONS[relation](conjunct, scene, scene);
  if (some ? parts.includes(true) : parts.every(Boolean)) return [];
  return SINGLE.includes(relation) ? blocks.filter((_, i) => !parts[i]) : blocks;
}

/** For each relation, the share of objects for which it holds. @param {Conjunct[]} goal @param {Scene} initial @param {Scene} final */
export const shares = (goal, initial, final) => goal.map((conjunct) => {
  const all = RELATIONS[conjunct.relation](conjunct, initial, final), parts = conjunct.some ? [all.includes(true)] : all;
  return parts.length ? parts.filter(Boolean).length / parts.length : 1;
});

/** The mean share. @param {Goal} goal @param {Scene} initial @param {Scene} final */
export function share(goal, initial, final) {
  if (!goal) return 0;
  const all = shares(goal, initial, final);
  return all.every((part) => part === 1) ? 1 : all.reduce((sum, part) => sum + part) / all.length;
}

/** Whether an intent holds in a final scene. @param {Goal} goal @param {Scene} initial @param {Scene} final */
export const holds = (goal, initial, final) => share(goal, initial, final) === 1;

/** The score of a final scene, in [0, 1]. @param {Goal} goal @param {Scene} initial @param {Scene} final */
export function goalScore(goal, initial, final) {
  const now = share(goal, initial, final), before = share(goal, initial, initial);
  return now === 1 ? 1 : before === 1 ? 0 : Math.max(0, (now - before) / (1 - before));
}
