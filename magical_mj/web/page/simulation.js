// @ts-check
/**
 * A simulation in MuJoCo's WebAssembly build, from a file of `magical_mj.export_mjcf`, which defines the actions' controls.
 * @typedef {import("./scene.js").Scene} Scene
 */
import { Raster } from "./raster.js";
import { moved } from "./scene.js";
import { speedSignal, vector } from "./speeds.js";
import { stateVector } from "./state.js";

/** @typedef {{robot: number, fingers: number[], blocks: number[], pebbles?: number[]}} Addresses  indices in qpos of the first coordinate of each object */

/** @param {any} mujoco @param {any} model @param {Scene} scene @returns {Addresses} */
export function addressesOf(mujoco, model, scene) {
  const address = (/** @type {string} */ joint) => {
    const id = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT.value, joint);
    return id < 0 ? -1 : model.jnt_qposadr[id];
  };
  return {
    robot: address("robot_x"),
    fingers: ["left_finger", "right_finger"].map(address).filter((at) => at >= 0),  // sticks have none
    blocks: scene.blocks.map((_, i) => address(`block${i}_x`)),
    pebbles: scene.pebbles?.map((_, i) => address(`pebble${i}_x`)),
  };
}

/** A scene with the poses in a state. @param {Scene} scene @param {Addresses} addresses @param {Float64Array} qpos */
export function sceneAt(scene, addresses, qpos) {
  const [robot, ...blocks] = planar(addresses, qpos);
  const pebbles = addresses.pebbles?.map((first) => [...qpos.subarray(first, first + 2)]);
  return moved(scene, { robot, fingers: fingers(scene, addresses, qpos), blocks, pebbles });
}

/** The coordinates, or velocities, of the robot and each block: x, y, angle. @param {Addresses} addresses @param {Float64Array} values  each joint has one */
const planar = ({ robot, blocks }, values) => [robot, ...blocks].map((first) => [values[first], values[first + 1], values[first + 2]]);

/** The angles of the fingers. For a body without fingers, those of the scene. @param {Scene} scene @param {Addresses} addresses @param {Float64Array} qpos */
const fingers = ({ robot }, addresses, qpos) => addresses.fingers.length ? addresses.fingers.map((at) => qpos[at]) : robot.fingers;

export class Simulation {
  /**
   * @param {any} mujoco  the module that its loader gives
   * @param {string} mjcf  the model at the start of an episode
   * @param {Scene} scene  the same
   */
  constructor(mujoco, mjcf, scene) {
    this.mujoco = mujoco;
    this.mjcf = mjcf;
    this.scene = scene;
    this.model = mujoco.MjModel.from_xml_string(mjcf);
    this.data = new mujoco.MjData(this.model);
    mujoco.mj_resetDataKeyframe(this.model, this.data, 0);
    this.controls = this.#numbers("controls");  // a row for each action, or empty if actions are speeds
    [this.substeps] = this.#numbers("substeps");
    this.addresses = addressesOf(mujoco, this.model, scene);
  }

  /**
   * Acts for one control step.
   * @param {number | number[]} action  0 to 17; or, where actions are speeds, a vector of them
   * @returns {Scene} the scene after it
   */
  act(action) {
    const { ctrl } = this.data;
    if (this.controls.length) {
      const first = Number(action) * ctrl.length;
      ctrl.set(this.controls.subarray(first, first + ctrl.length));
    } else {
      const fingers = this.addresses.fingers.map((at) => this.data.qpos[at]);
      ctrl.set(speedSignal(typeof action === "number" ? vector(action) : action, fingers, ctrl, this.substeps, this.model.opt.timestep));
    }
    for (let i = 0; i < this.substeps; i++) this.mujoco.mj_step(this.model, this.data);
    return sceneAt(this.scene, this.addresses, this.data.qpos);
  }

  /** The current state vector for policies. */
  state() {
    const { scene, addresses, data: { qpos, qvel } } = this;
    return stateVector(scene, planar(addresses, qpos), planar(addresses, qvel), fingers(scene, addresses, qpos));
  }

  /** The renderer of pictures for policies. */
  raster() {
    return new Raster(this.mujoco, this.model, this.mjcf, this.scene);
  }

  /**
   * What the model's <custom> says under a name; nothing if it lacks that.
   * @param {string} name
   * @returns {Float64Array}
   */
  #numbers(name) {
    const { numeric_adr: first, numeric_size: size, numeric_data: data } = this.model;
    const id = this.mujoco.mj_name2id(this.model, this.mujoco.mjtObj.mjOBJ_NUMERIC.value, name);
    return id < 0 ? new Float64Array() : data.slice(first[id], first[id] + size[id]);
  }

  /** Frees the WebAssembly memory, which is not garbage-collected. */
  close() {
    this.data.delete();
    this.model.delete();
  }
}
