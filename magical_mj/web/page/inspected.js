// @ts-check
/**
 * Any model in MuJoCo's WebAssembly build: its state, its parts, and the file's comments about them.
 * @typedef {import("./comments.js").Comments} Comments
 * @typedef {{name: string, about: string, facts: [string, string][], joints: string[][], geoms: string[][]}} Description
 */
import { readComments } from "./comments.js";
import { MOST, speedSignal, vector } from "./speeds.js";

const JOINTS = ["free", "ball", "slide", "hinge"];
const GEOMS = ["plane", "height field", "sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh", "SDF"];
/** The file's attributes that refer to other files, and the settings with their folders. */
const FILES = /\bfile\s*=\s*["']([^"']+)["']/g;
const FOLDERS = /\b(?:meshdir|texturedir|assetdir)\s*=\s*["']([^"']*)["']/g;

/** @param {ArrayLike<number>} values @param {number} [digits] */
const numbers = (values, digits = 4) => [...Array.from(values)].map((value) => Number(value.toPrecision(digits))).join(" ");

export class InspectedModel {
  /**
   * @param {any} mujoco  the module
   * @param {string} text  MJCF
   * @param {Map<string, Uint8Array>} files  those that the model needs, by their paths from its folder
   * @param {boolean} isFlat  whether they were dropped, and have only names
   */
  constructor(mujoco, text, files = new Map(), isFlat = false) {
    this.mujoco = mujoco;
    this.model = compiled(mujoco, text, files, isFlat);
    this.data = new mujoco.MjData(this.model);
    /** @type {Comments} */
    this.comments = readComments(text, this.model.nbody, this.model.ngeom);
    const { numeric_adr: first, numeric_size: size, numeric_data: values } = this.model;
    const custom = (/** @type {string} */ name) => {
      const id = mujoco.mj_name2id(this.model, mujoco.mjtObj.mjOBJ_NUMERIC.value, name);
      return id < 0 ? null : values.slice(first[id], first[id] + size[id]);
    };
    const controls = custom("controls"), { nu } = this.model;
    /** A row of ctrl for each action, or null if the file does not define actions. @type {Float64Array | null} */
    this.controls = controls?.length === 18 * nu && nu > 0 ? controls : null;
    const actsBySpeeds = !controls && custom("protocol") !== null;
    /** Whether the file is from this benchmark and defines actions. */
    this.acts = this.controls !== null || actsBySpeeds;
    const most = (/** @type {number} */ id) => this.controls ? Math.max(...this.controls.filter((_, i) => i % nu === id).map(Math.abs)) : 1;
    /** The largest control value of each actuator over all actions. @type {number[]} */
    this.most = actsBySpeeds ? MOST.slice(0, nu) : Array.from({ length: nu }, (_, id) => most(id));
    this.substeps = custom("substeps")?.[0] ?? 1;
    this.horizon = custom("horizon")?.[0] ?? null;
    this.reset();
  }

  /** Resets to the first keyframe if there is one, otherwise to the initial state. */
  reset() {
    const { mujoco, model, data } = this;
    if (model.nkey) mujoco.mj_resetDataKeyframe(model, data, 0);
    else mujoco.mj_resetData(model, data);
    mujoco.mj_forward(model, data);
  }

  /** Performs an action of the benchmark, which takes several steps of MuJoCo. @param {number | number[]} action  0 to 17, or a vector of speeds */
  act(action) {
    const { ctrl, qpos } = this.data, { mujoco, model } = this;
    if (this.controls) ctrl.set(this.controls.subarray(Number(action) * ctrl.length, (Number(action) + 1) * ctrl.length));
    else {
      const joints = ["left_finger", "right_finger"].map((name) => mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT.value, name));
      const fingers = joints.filter((id) => id >= 0).map((id) => qpos[model.jnt_qposadr[id]]);  // sticks have none
      ctrl.set(speedSignal(typeof action === "number" ? vector(action) : action, fingers, ctrl, this.substeps, model.opt.timestep));
    }
    for (let i = 0; i < this.substeps; i++) this.step();
  }

  /** A step of MuJoCo with the current ctrl. */
  step() {
    this.mujoco.mj_step(this.model, this.data);
  }

  /** Computes positions, contacts and sensors for the current state, since MuJoCo's step leaves those before the step. The next step is unchanged to the bit. */
  update() {
    this.mujoco.mj_forward(this.model, this.data);
  }

  /** The state as plain data. */
  state() {
    const { time, qpos, qvel, act, ctrl } = this.data;
    return { time, qpos: [...qpos], qvel: [...qvel], act: [...act], ctrl: [...ctrl] };
  }

  /** The name of a part, or "". @param {string} kind  "body", "jnt", "geom", ... @param {number} id */
  name(kind, id) {
    const { names, [`name_${kind}adr`]: first } = this.model;
    return new TextDecoder().decode(names.slice(first[id], names.indexOf(0, first[id])));
  }

  /** The names of all parts of a kind. Unnamed ones are numbered. @param {string} kind @param {string} word @param {number} count */
  names(kind, word, count) {
    return Array.from({ length: count }, (_, id) => this.name(kind, id) || `${word} ${id}`);
  }

  /** The label of a body in lists. @param {number} body */
  label(body) {
    return body === 0 ? "world" : this.name("body", body) || `body ${body}`;
  }

  /** The current description of a body. @param {number} body @returns {Description} */
  describe(body) {
    const { model, data, mujoco } = this, at = (/** @type {any} */ all, /** @type {number} */ width) => all.subarray(body * width, (body + 1) * width);
    const velocity = new mujoco.DoubleBuffer(6);
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY.value, body, velocity, 0);
    const [rx, ry, rz, vx, vy, vz] = velocity.GetView();
    velocity.delete();
    const [w, x, y, z] = at(data.xquat, 4);
    const heading = Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z));
    const parent = model.body_parentid[body];
    /** @type {[string, string][]} */
    const facts = [
      ["Position", numbers(at(data.xpos, 3))], ["Quaternion", numbers([w, x, y, z])], ["Heading", `${numbers([heading])} rad`],
      ["Velocity", numbers([vx, vy, vz])], ["Angular velocity", numbers([rx, ry, rz])],
      ["Mass", numbers([model.body_mass[body]])], ["With all below it", numbers([model.body_subtreemass[body]])],
      ["Inertia", numbers(at(model.body_inertia, 3))],
    ];
    if (body) facts.push(["Part of", this.label(parent)]);
    const range = (/** @type {any} */ first, /** @type {any} */ count) => Array.from({ length: Math.max(0, count[body]) }, (_, i) => first[body] + i);
    return {
      name: this.label(body),
      about: this.comments.bodies[body] ?? "",
      facts,
      joints: range(model.body_jntadr, model.body_jntnum).map((joint) => this.#joint(joint)),
      geoms: range(model.body_geomadr, model.body_geomnum).map((geom) => this.#geom(geom)),
    };
  }

  /** @param {number} joint */
  #joint(joint) {
    const { model, data } = this, type = model.jnt_type[joint], width = [7, 4, 1, 1][type], freedom = [6, 3, 1, 1][type];
    const at = model.jnt_qposadr[joint], dof = model.jnt_dofadr[joint];
    const [low, high] = model.jnt_range.subarray(2 * joint, 2 * joint + 2);
    return [
      this.name("jnt", joint) || `joint ${joint}`, JOINTS[type], numbers(data.qpos.subarray(at, at + width)),
      numbers(data.qvel.subarray(dof, dof + freedom)), low < high ? numbers([low, high]) : "free",
      numbers([model.dof_damping[dof]]), numbers([model.dof_frictionloss[dof]]),
    ];
  }

  /** @param {number} geom */
  #geom(geom) {
    const { model } = this, row = (/** @type {any} */ all) => numbers(all.subarray(3 * geom, 3 * geom + 3));
    return [
      this.name("geom", geom) || `geom ${geom}`, GEOMS[model.geom_type[geom]] ?? "other", row(model.geom_size), String(model.geom_group[geom]),
      row(model.geom_friction), `${model.geom_contype[geom]} / ${model.geom_conaffinity[geom]}`, this.comments.geoms[geom] ?? "",
    ];
  }

  /** Frees the WebAssembly memory, which is not garbage-collected. */
  close() {
    this.data.delete();
    this.model.delete();
  }
}

/**
 * @param {any} mujoco
 * @param {string} text
 * @param {Map<string, Uint8Array>} files
 * @param {boolean} isFlat
 */
function compiled(mujoco, text, files, isFlat) {
  const vfs = new mujoco.MjVFS();
  try {
    for (const [path, content] of placed(text, files, isFlat)) vfs.addBuffer(path, content);
    return mujoco.MjModel.from_xml_string(text, vfs);
  } catch (error) {
    throw new Error(explained(/** @type {Error} */ (error).message, text));
  } finally {
    vfs.delete();
  }
}

/**
 * The files under all paths by which the model may ask for them.
 * @param {string} text
 * @param {Map<string, Uint8Array>} files
 * @param {boolean} isFlat
 */
export function placed(text, files, isFlat) {
  const found = new Map(files), /** @type {Map<string, string>} */ asked = new Map();
  const texts = [text, ...[...files].filter(([name]) => name.endsWith(".xml")).map(([, content]) => new TextDecoder().decode(content))];
  const folders = ["", ...texts.flatMap((one) => [...one.matchAll(FOLDERS)].map(([, folder]) => folder.replace(/\/?$/, "/")))];
  for (const path of new Set(texts.flatMap((one) => [...one.matchAll(FILES)].map(([, path]) => path)))) {
    const name = /** @type {string} */ (path.split(/[\\/]/).pop()), other = asked.get(name);
    if (isFlat && files.has(name) && other !== undefined && tidy(other) !== tidy(path)) {
      throw new Error(`The model needs two files with the name ${name}: ${other} and ${path}. magical-mj inspect FILE finds both.`);
    }
    asked.set(name, path);
    for (const place of folders.flatMap((folder) => [folder + path, folder + name])) {
      const content = files.get(isFlat ? name : tidy(place));
      if (content) found.set(tidy(place), content);
    }
  }
  return found;
}

/** A path without "." and "..", as far as possible. @param {string} path */
function tidy(path) {
  /** @type {string[]} */
  const parts = [];
  for (const part of path.split(/[\\/]/)) {
    if (part === ".." && parts.length && parts[parts.length - 1] !== "..") parts.pop();
    else if (part !== "." && (part || !parts.length)) parts.push(part);
  }
  return parts.join("/");
}

/** The compiler's message, without internal details, and with the line that it refers to. @param {string} message @param {string} text */
function explained(message, text) {
  const said = message.replace(/^(MuJoCo Error: )?(Loading error: )?((XML )?Error: )?/, "").trim();
  const missing = /Error opening file '([^']+)'|resource not found.*?'([^']+)'|could not open.*?'([^']+)'/i.exec(said);
  if (missing) return `The model needs the file ${missing.slice(1).find(Boolean)}: open it together with the model.`;
  const line = Number(/line (\d+)/i.exec(said)?.[1]);
  const quoted = line ? text.split("\n")[line - 1]?.trim().slice(0, 200) : "";
  return quoted ? `${said}\n\n${line}: ${quoted}` : said;
}
