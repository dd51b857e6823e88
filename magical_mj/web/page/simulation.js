// @ts-check
/**
 * One world in MuJoCo's WebAssembly build.
 * @typedef {import("./scene.js").Scene} Scene
 */
import { moved } from "./scene.js";

const SUBSTEPS = 10;  // calls of mj_step for an action, as in magical_mj.assets.world

export class Simulation {
  /**
   * @param {any} mujoco  the module that its loader gives
   * @param {string} mjcf  the world, at rest in its scene
   * @param {Scene} scene
   * @param {number[][]} controls  what each action writes into ctrl
   */
  constructor(mujoco, mjcf, scene, controls) {
    this.mujoco = mujoco;
    this.scene = scene;
    this.controls = controls;
    this.model = mujoco.MjModel.from_xml_string(mjcf);
    this.data = new mujoco.MjData(this.model);
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
    this.data.ctrl.set(this.controls[action]);
    for (let i = 0; i < SUBSTEPS; i++) this.mujoco.mj_step(this.model, this.data);
    const qpos = this.data.qpos, { robot, fingers, blocks } = this.addresses;
    const planar = (/** @type {number} */ first) => [qpos[first], qpos[first + 1], qpos[first + 2]];
    return moved(this.scene, { robot: planar(robot), fingers: fingers.map((at) => qpos[at]), blocks: blocks.map(planar) });
  }

  /** Frees the memory, which JavaScript does not do by itself. */
  close() {
    this.data.delete();
    this.model.delete();
  }
}
