// @ts-check
/** Converts actions that are speeds, as in SweepToTop, to MuJoCo's `ctrl`, like `magical_mj.assets.robot.speed_signal`. */
const FORWARD = 0.8, TURN = 2.5, FINGER = 1;  // maximum speeds: units/s, rad/s, rad/s
/** The maximum command of each actuator. */
export const MOST = [FORWARD, FORWARD, TURN, TURN, FINGER, FINGER];
const OPEN = Math.PI / 8, FINGER_GAIN = 10;

/** One of the 18 actions as (speed, turn, grip), each at full speed or 0. @param {number} action */
export function vector(action) {
  const sign = (/** @type {number} */ part) => [0, 1, -1][part % 3];
  return [sign(action), sign(Math.floor(action / 3)), action >= 9 ? 1 : -1];
}

/**
 * @param {number[]} action  speed (units/s), turn and grip (rad ahead); values are clipped to the maximum; grip is ignored without fingers
 * @param {number[]} fingers  angles of the left and the right one; empty for a stick
 * @param {Float64Array} before  the current values, which stay active for one more substep
 * @param {number} substeps  of an action
 * @param {number} timestep  seconds
 */
export function speedSignal([drive, ahead, grip], fingers, before, substeps, timestep) {
  const within = (/** @type {number} */ value, /** @type {number} */ low, /** @type {number} */ high) => Math.min(Math.max(value, low), high);
  const speed = within(drive, -FORWARD, FORWARD), turn = within(0.5 / timestep * ahead, -TURN, TURN), opening = within(OPEN - grip, 0, OPEN);
  const rates = fingers.map((angle, i) => {
    const target = i ? -opening : opening, rate = before[4 + i];
    let end = angle, last = rate;
    for (let k = 0; k < substeps; k++) {
      const next = within(FINGER_GAIN * (target - end), -FINGER, FINGER);
      end += timestep * last;
      last = next;
    }
    return ((end - angle) / timestep - rate) / (substeps - 1);
  });
  return [speed, speed, turn, turn, ...rates];
}
