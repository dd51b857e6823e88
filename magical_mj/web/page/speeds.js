// @ts-check
/** Actions that are speeds, as in SweepToTop: what they are as values of MuJoCo's `ctrl`, as in `magical_mj.assets.robot.speed_signal`. */
const FORWARD = 0.8, TURN = 2.5, FINGER = 1;  // the most: units/s, rad/s, rad/s
/** The most that each actuator is told. */
export const MOST = [FORWARD, FORWARD, TURN, TURN, FINGER, FINGER];
const OPEN = Math.PI / 8, FINGER_GAIN = 10;

/** One of the 18 actions as (speed, turn, grip): full speed, or none. @param {number} action */
export function vector(action) {
  const sign = (/** @type {number} */ part) => [0, 1, -1][part % 3];
  return [sign(action), sign(Math.floor(action / 3)), action >= 9 ? 1 : -1];
}

/**
 * @param {number[]} action  speed (units/s), turn and grip (rad ahead); what is beyond the most, or for fingers that are not there, does nothing
 * @param {number[]} fingers  angles of the left and the right one; none for a stick
 * @param {Float64Array} before  the present values, which act for one more substep
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
