// @ts-check
/** Policies: ONNX networks that map the latest observations to a value for each action, in ONNX Runtime's WebAssembly build. */
import { SIZE } from "./state.js";

/** @typedef {{state: () => Float32Array, raster: () => import("./raster.js").Raster, data: any}} Seen  a simulation, with its observations */
/** @typedef {{type: string, dims: number[], look: () => Float32Array | Uint8Array}} Eye  look: adds the current observation, and returns the latest ones */

const HISTORY = 4;
const PIXELS = 96;
/** Presets of pictures: the cameras in stacking order, and the number of the latest pictures of each. */
const PRESETS = { LoRes4E: { ego: 4 }, LoRes4A: { allo: 4 }, LoRes3EA: { allo: 1, ego: 3 } };
/** @type {Promise<any> | null} */
let runtime = null;

/** The runtime. It is fetched at the first call, and again after a failure. */
function loadRuntime() {
  const folder = new URL("onnx/", document.baseURI).href;
  runtime ??= import(`${folder}ort.js`)
    .then((ort) => {
      Object.assign(ort.env.wasm, { numThreads: 1, wasmPaths: { mjs: `${folder}wasm.js`, wasm: `${folder}ort.wasm` } });
      return ort;
    })
    .catch((error) => {
      runtime = null;
      throw error;
    });
  return runtime;
}

/**
 * A policy at the start of an episode.
 * @param {Uint8Array} file  its content
 * @param {Seen} simulation  at the start
 */
export async function loadPolicy(file, simulation) {
  const ort = await loadRuntime().catch(() => { throw new Error("The runtime of policies could not be loaded"); });
  try {
    return await Policy.open(ort, file, simulation);
  } catch (error) {
    throw new Error(`The policy cannot act here: ${error instanceof Error ? error.message : error}`);
  }
}

export class Policy {
  #ort; #session; #eye; #random;
  #step = -1;  // the step of the chosen action
  /** @type {number | null} */ #action = null;
  /** @type {unknown} */ #failure = null;

  /**
   * @param {any} ort  ONNX Runtime
   * @param {any} session  with the network
   * @param {Eye} eye
   * @param {() => number} random  a number in [0, 1)
   */
  constructor(ort, session, eye, random = Math.random) {
    this.#ort = ort;
    this.#session = session;
    this.#eye = eye;
    this.#random = random;
  }

  /** @param {any} ort @param {Uint8Array} file @param {Seen} simulation */
  static async open(ort, file, simulation) {
    const { preset } = metadata(file);
    if (!preset) throw new Error("it is not an ONNX file from magical-mj export-policy");
    const eye = preset === "State" ? states(simulation) : pictures(simulation, preset);
    const session = await ort.InferenceSession.create(file).catch(() => { throw new Error("its network cannot be run"); });
    return new Policy(ort, session, eye);
  }

  /** The action for this step. Null while the network computes. @param {number} step  the current one: 0, 1, ... */
  next(step) {
    if (this.#failure) throw this.#failure;
    if (step !== this.#step) {
      this.#step = step;
      this.#action = null;
      this.think().then((values) => { this.#action = drawn(values, this.#random()); }, (error) => { this.#failure = error; });
    }
    return this.#action;
  }

  /** Observes the current state, and returns the value of each action. @returns {Promise<Float32Array>} */
  async think() {
    const { type, dims, look } = this.#eye;
    const { logits } = await this.#session.run({ observations: new this.#ort.Tensor(type, look(), dims) });
    return logits.data;
  }
}

/** The latest states, oldest first. At the start, the first one is repeated. @param {Seen} simulation @returns {Eye} */
function states(simulation) {
  const seen = new Float32Array(HISTORY * SIZE);
  let begun = false;
  const look = () => {
    const state = simulation.state();
    seen.copyWithin(0, SIZE);
    for (let i = begun ? HISTORY - 1 : 0; i < HISTORY; i++) seen.set(state, i * SIZE);
    begun = true;
    return seen;
  };
  return { type: "float32", dims: [1, HISTORY, SIZE], look };
}

/** The latest pictures of some cameras, stacked along the channels, oldest first. @param {Seen} simulation @param {string} preset @returns {Eye} */
function pictures(simulation, preset) {
  const frames = Object.entries(PRESETS[/** @type {keyof typeof PRESETS} */ (preset)] ?? {});
  if (!frames.length) throw new Error(`it needs observations of the preset ${preset}, which are not available here`);
  const raster = simulation.raster(), depth = 3 * frames.reduce((sum, [, count]) => sum + count, 0);
  /** @type {Record<string, Uint8Array[]>} */
  const latest = {};
  const look = () => {
    for (const [camera, count] of frames) {
      const picture = raster.draw(simulation.data, camera, PIXELS);
      latest[camera] = latest[camera] ? [...latest[camera].slice(1), picture] : Array(count).fill(picture);
    }
    const stack = new Uint8Array(PIXELS * PIXELS * depth);
    frames.flatMap(([camera]) => latest[camera]).forEach((picture, i) => {
      for (let at = 3 * i, from = 0; from < picture.length; at += depth, from += 3) stack.set(picture.subarray(from, from + 3), at);
    });
    return stack;
  };
  return { type: "uint8", dims: [1, PIXELS, PIXELS, depth], look };
}

/**
 * The metadata of an ONNX file: the entries 14 of its protocol buffer, text by name. Empty for other files.
 * @param {Uint8Array} file
 * @returns {Record<string, string>}
 */
function metadata(file) {
  try {
    const texts = [...entries(file)].filter(([number]) => number === 14)
      .map(([, content]) => [...entries(content)].map(([, text]) => new TextDecoder().decode(text)));
    return Object.fromEntries(texts);
  } catch {
    return {};
  }
}

/** Yields the numbers and contents of length-delimited fields, and skips all others. @param {Uint8Array} bytes @returns {Generator<[number, Uint8Array]>} */
function* entries(bytes) {
  let at = 0;
  const number = () => {
    let value = 0, unit = 1;
    for (; bytes[at] > 127; unit *= 128) value += unit * (bytes[at++] & 127);
    return value + unit * bytes[at++];
  };
  while (at < bytes.length) {
    const tag = number(), size = number();
    if (tag % 8 === 0) continue;
    if (tag % 8 !== 2 || !(at + size <= bytes.length)) throw new Error("this is not an ONNX file");
    yield [Math.floor(tag / 8), bytes.subarray(at, at += size)];
  }
}

/** An action, sampled from the softmax of the values. @param {Float32Array} values @param {number} point  in [0, 1) */
function drawn(values, point) {
  const largest = Math.max(...values), weights = [...values].map((value) => Math.exp(value - largest));
  let left = point * weights.reduce((sum, weight) => sum + weight);
  const action = weights.findIndex((weight) => (left -= weight) < 0);
  return action < 0 ? weights.indexOf(1) : action;
}
