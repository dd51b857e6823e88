// @ts-check
/**
 * Scenes in the form that magical_mj writes. World units, x to the right, y up. Angles in radians, counter-clockwise.
 * @typedef {{x: number, y: number, angle: number, fingers: number[], body?: string}} Robot
 *   angle 0 faces +y; fingers left, right; body: "gripper" by default
 * @typedef {{shape: string, colour: string, x: number, y: number, angle: number, mass?: number}} Block
 * @typedef {{colour: string, x_min: number, y_min: number, x_max: number, y_max: number, border?: string}} Region
 * @typedef {{robot: Robot, blocks: Block[], regions: Region[], half_width?: number, pebbles?: {x: number, y: number}[],
 *   stains?: number[][], dynamics?: Record<string, number>}} Scene  half_width: of the arena, by default 1; stains: x, y, radius, darkness
 * @typedef {{robot: number[], fingers: number[], blocks: number[][], pebbles?: number[][]}} Poses
 *   robot and each block as x, y, angle; pebbles as x, y
 */

/**
 * The same scene with other poses.
 * @param {Scene} scene
 * @param {Poses} poses
 * @returns {Scene}
 */
export function moved(scene, poses) {
  const [x, y, angle] = poses.robot;
  const blocks = scene.blocks.map((block, i) => {
    const [x, y, angle] = poses.blocks[i];
    return { ...block, x, y, angle };
  });
  const pebbles = poses.pebbles?.map(([x, y]) => ({ x, y }));
  return { ...scene, robot: { ...scene.robot, x, y, angle, fingers: poses.fingers }, blocks, ...pebbles && { pebbles } };
}

/**
 * @param {Scene} scene
 * @returns {Poses}
 */
export function poses({ robot, blocks, pebbles }) {
  return {
    robot: [robot.x, robot.y, robot.angle],
    fingers: [...robot.fingers],
    blocks: blocks.map(({ x, y, angle }) => [x, y, angle]),
    ...pebbles && { pebbles: pebbles.map(({ x, y }) => [x, y]) },
  };
}

/**
 * The interpolation of two scenes with the same objects, for smooth drawing between two actions.
 * @param {Scene} before
 * @param {Scene} after
 * @param {number} share  0 (before) to 1 (after)
 * @returns {Scene}
 */
export function between(before, after, share) {
  const mix = (/** @type {number[]} */ a, /** @type {number[]} */ b) => a.map((value, i) => value + share * (b[i] - value));
  const [from, to] = [poses(before), poses(after)];
  return moved(after, {
    robot: mix(from.robot, to.robot),
    fingers: mix(from.fingers, to.fingers),
    blocks: from.blocks.map((block, i) => mix(block, to.blocks[i])),
    pebbles: from.pebbles?.map((pebble, i) => mix(pebble, /** @type {number[][]} */ (to.pebbles)[i])),
  });
}
