// @ts-check
/** The state vector for policies, with the entries of `magical_mj.observations.STATE_NAMES`. World units, rad, units/s, rad/s. */
const SHAPES = ["square", "pentagon", "star", "circle"], COLOURS = ["red", "green", "blue", "yellow"];
const ROBOT = 8, BLOCK = 7 + SHAPES.length + COLOURS.length, REGION = 5 + COLOURS.length, BLOCKS = 10, REGIONS = 3;
export const SIZE = ROBOT + BLOCKS * BLOCK + REGIONS * REGION;

/**
 * @param {import("./scene.js").Scene} scene  for the constant entries
 * @param {number[][]} poses  of the robot and each block: x, y, angle
 * @param {number[][]} velocities  of the robot and each block
 * @param {number[]} fingers  angles of the left and the right one
 */
export function stateVector({ blocks, regions }, poses, velocities, fingers) {
  const state = new Float32Array(SIZE);
  state.set([...poses[0], ...velocities[0], ...fingers]);
  blocks.forEach(({ shape, colour }, i) => {
    const row = [1, ...poses[1 + i], ...velocities[1 + i], ...SHAPES.map((one) => Number(one === shape)), ...COLOURS.map((one) => Number(one === colour))];
    state.set(row, ROBOT + i * BLOCK);
  });
  regions.forEach(({ colour, x_min, y_min, x_max, y_max }, i) => {
    state.set([1, x_min, y_min, x_max, y_max, ...COLOURS.map((one) => Number(one === colour))], ROBOT + BLOCKS * BLOCK + i * REGION);
  });
  return state;
}
