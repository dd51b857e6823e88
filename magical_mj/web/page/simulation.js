// @ts-check
/**
 * One world in MuJoCo's WebAssembly build, from a file that `magical_mj.export_mjcf` wrote: it says what an action does.
 * @typedef {import("./scene.js").Scene} Scene
 */
import { moved } from "./scene.js";
import { stateVector } from "./state.js";

export class Simulation {
  /**
   * @param {any} mujoco  the module that its loader gives
   * @param {string} mjcf  the world at the start of an episode
   * @param {Scene} scene  the same
   */
  constructor(mujoco, mjcf, scene) {
    this.mujoco = mujoco;
    this.scene = scene;
    this.model = mujoco.MjModel.from_xml_string(mjcf);
    this.data = new mujoco.MjData(this.model);
    mujoco.mj_resetDataKeyframe(this.model, this.data, 0);
    this.controls = this.#numbers("controls");  // a row for each action
    [this.substeps] = this.#numbers("substeps");
    const address = (/** @type {string} */ joint) => {
      const id = mujoco.mj_name2id(this.model, mujoco.mjtObj.mjOBJ_JOINT.value, joint);
      return this.model.jnt_qposadr[id];
    };
    this.addresses = {
      robot: address("robot_x"),
      fingers: [address("left_finger"), address("right_finger")],
      blocks: scene.blocks.map((_, i) => address(`block${i}_x`)),
    };
  }

  /**
   * Acts for one control step.
   * @param {number} action  0 to 17
   * @returns {Scene} the scene after it
   */
  act(action) {
    const { ctrl } = this.data;
    ctrl.set(this.controls.subarray(action * ctrl.length, (action + 1) * ctrl.length));
    for (let i = 0; i < this.substeps; i++) this.mujoco.mj_step(this.model, this.data);
    const [robot, ...blocks] = this.#planar(this.data.qpos);
    return moved(this.scene, { robot, fingers: this.#fingers(), blocks });
  }

  /** What policies see now. */
  state() {
    return stateVector(this.scene, this.#planar(this.data.qpos), this.#planar(this.data.qvel), this.#fingers());
  }

  /** The coordinates, or velocities, of the robot and each block: x, y, angle. @param {Float64Array} values  all joints have one */
  #planar(values) {
    return [this.addresses.robot, ...this.addresses.blocks].map((first) => [values[first], values[first + 1], values[first + 2]]);
  }

  #fingers() {
    return this.addresses.fingers.map((at) => this.data.qpos[at]);
  }

  /**
   * What the model's <custom> says under a name.
   * @param {string} name
   * @returns {Float64Array}
   */
  #numbers(name) {
    const { numeric_adr: first, numeric_size: size, numeric_data: data } = this.model;
    const id = this.mujoco.mj_name2id(this.model, this.mujoco.mjtObj.mjOBJ_NUMERIC.value, name);
    return data.slice(first[id], first[id] + size[id]);
  }

  /** Frees the memory, which JavaScript does not do by itself. */
  close() {
    this.data.delete();
    this.model.delete();
  }
}
