// @ts-check
/**
 * Which objects of a scene are in illegal places: the rule of `magical_mj.scene.geometry.check_scene`. A test compares them.
 * A solid part is an outline enlarged by a radius: a disc is a point with a radius.
 * @typedef {import("./scene.js").Scene} Scene
 * @typedef {number[]} Point
 * @typedef {{outline: Point[], radius: number}} Part
 * @typedef {{blocks: Record<string, Part>, robots: Record<string, {part: Part | null, fingers: boolean}>, fingers: Point[][][], roots: Point[],
 *   pebble: Part, overlap: number, overhang: number, angle: number, open: number, slack: number}} Solids  written by magical_mj.web.page_data
 * @typedef {{names: string[], words: string}} Fault  names: of the objects, such as "robot", "block 0", "region 1"
 */

/**
 * All faults of a scene. The first one is that of Python's message.
 * @param {Scene} scene @param {Solids} solids @returns {Fault[]}
 */
export function faults(scene, solids) {
  const { robot, blocks, regions, half_width: half = 1, pebbles = [] } = scene;
  const bodies = /** @type {[string, Part[]][]} */ ([
    ["robot", robotParts(robot, solids)],
    ...blocks.map((block, i) => [`block ${i}`, [placed(solids.blocks[block.shape], block)]]),
    ...pebbles.map((pebble, i) => [`pebble ${i}`, [placed(solids.pebble, { ...pebble, angle: 0 })]]),
  ]);
  const found = /** @type {Fault[]} */ ([]), report = (/** @type {string} */ words, /** @type {string[]} */ ...names) => found.push({ names, words });
  const [left, right] = robot.fingers, isIn = (/** @type {number} */ angle) => -solids.slack <= angle && angle <= solids.open + solids.slack;
  if (!isIn(left) || !isIn(-right)) report("The fingers are bent too far", "robot");
  for (const [name, { angle }] of /** @type {[string, {angle: number}][]} */ ([["robot", robot], ...blocks.map((block, i) => [`block ${i}`, block])])) {
    if (Math.abs(angle) > solids.angle) report(`The angle of ${label(name)} is too large`, name);
  }
  for (const [name, parts] of bodies) {
    if (parts.some((part) => reach(part) > half + solids.overlap)) report(`${label(name, true)} is not inside the walls`, name);
  }
  for (const [i, [name, parts]] of bodies.entries()) for (const [other, others] of bodies.slice(0, i)) {
    if (touch(parts, others, solids.overlap)) report(`${label(other, true)} and ${label(name)} overlap`, other, name);
  }
  for (const [i, { x_min, y_min, x_max, y_max, border }] of regions.entries()) {
    const limit = half + (border === "solid" ? solids.overhang : solids.overlap);
    if (Math.max(-x_min, -y_min, x_max, y_max) > limit) report(`${label(`region ${i}`, true)} is not inside the walls`, `region ${i}`);
  }
  return found;
}

/** An object's name for people, who count from 1. @param {string} name @param {boolean} [isFirst]  of a sentence */
export function label(name, isFirst = false) {
  const text = name === "robot" ? "the robot" : name.replace(/\d+/, (digits) => String(Number(digits) + 1));
  return isFirst ? text[0].toUpperCase() + text.slice(1) : text;
}

/** @param {Part} part @param {{x: number, y: number, angle: number}} pose @returns {Part} */
function placed({ outline, radius }, { x, y, angle }) {
  const cosine = Math.cos(angle), sine = Math.sin(angle);
  return { outline: outline.map(([a, b]) => [x + cosine * a - sine * b, y + sine * a + cosine * b]), radius };
}

/** The robot's body, and both segments of each finger. @param {Scene["robot"]} robot @param {Solids} solids */
function robotParts(robot, { robots, fingers, roots }) {
  const { part, fingers: hasFingers } = robots[robot.body ?? "gripper"];
  const segments = hasFingers ? fingers.flatMap((outlines, side) => outlines.map(
    (outline) => placed({ outline, radius: 0 }, { x: roots[side][0], y: roots[side][1], angle: robot.fingers[side] }))) : [];
  return [...part ? [part] : [], ...segments].map((one) => placed(one, robot));
}

/** The largest distance of a part from the centre of the arena along an axis. @param {Part} part */
const reach = ({ outline, radius }) => Math.max(...outline.flat().map(Math.abs)) + radius;

/** Whether two objects overlap, also after each was shrunk by half of the tolerance. @param {Part[]} one @param {Part[]} other @param {number} tolerance */
function touch(one, other, tolerance) {
  return one.some((a) => other.some((b) => meet(a, b) && meet(shrunk(a, tolerance / 2), shrunk(b, tolerance / 2))));
}

/** @param {Part} one @param {Part} other */
const meet = (one, other) => distance(one.outline, other.outline) <= one.radius + other.radius;

/** @param {Part} part @param {number} by @returns {Part} */
function shrunk({ outline, radius }, by) {
  return radius >= by ? { outline, radius: radius - by } : { outline: eroded(outline, by - radius), radius: 0 };
}

const ARC = Math.PI / 32;  // radians between the points of an arc

/** A counter-clockwise polygon whose sides were moved inwards. Around a concave corner, this makes an arc. @param {Point[]} outline @param {number} by */
function eroded(outline, by) {
  return outline.flatMap((corner, i) => {
    const before = outline.at(i - 1) ?? corner, after = outline[(i + 1) % outline.length];
    const from = Math.atan2(corner[1] - before[1], corner[0] - before[0]), to = Math.atan2(after[1] - corner[1], after[0] - corner[0]);
    const turn = Math.atan2(Math.sin(to - from), Math.cos(to - from));
    const moved = (/** @type {number} */ heading, /** @type {number} */ length) => [corner[0] - length * Math.sin(heading), corner[1] + length * Math.cos(heading)];
    if (turn >= 0) return [moved(from + turn / 2, by / Math.cos(turn / 2))];
    const steps = Math.ceil(-turn / ARC);
    return Array.from({ length: steps + 1 }, (_, k) => moved(from + turn * k / steps, by));
  });
}

/** The distance of two polygons, or points. @param {Point[]} one @param {Point[]} other */
function distance(one, other) {
  if (inside(one[0], other) || inside(other[0], one)) return 0;
  const sides = sidesOf(one), others = sidesOf(other);
  if (sides.some((side) => others.some((second) => cross(side, second)))) return 0;
  const least = (/** @type {Point[]} */ points, /** @type {Point[][]} */ all) => Math.min(...points.flatMap((point) => all.map((side) => away(point, side))));
  return Math.min(least(one, others), least(other, sides));
}

/** @param {Point[]} outline */
const sidesOf = (outline) => outline.map((corner, i) => [corner, outline[(i + 1) % outline.length]]);

/** The distance of a point from a line segment. @param {Point} point @param {Point[]} segment */
function away([x, y], [[ax, ay], [bx, by]]) {
  const length = (bx - ax) ** 2 + (by - ay) ** 2, share = length && Math.min(1, Math.max(0, ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / length));
  return Math.hypot(x - ax - share * (bx - ax), y - ay - share * (by - ay));
}

/** @param {Point} point @param {Point[]} outline */
function inside([x, y], outline) {
  return sidesOf(outline).filter(([[ax, ay], [bx, by]]) => ay > y !== by > y && x < ax + (bx - ax) * (y - ay) / (by - ay)).length % 2 === 1;
}

/** Whether two line segments cross. @param {Point[]} one @param {Point[]} other */
function cross([a, b], [c, d]) {
  const left = (/** @type {Point} */ from, /** @type {Point} */ to, /** @type {Point} */ point) =>
    (to[0] - from[0]) * (point[1] - from[1]) - (to[1] - from[1]) * (point[0] - from[0]) > 0;
  return left(a, b, c) !== left(a, b, d) && left(c, d, a) !== left(c, d, b);
}
