// @ts-check
/** Policies that act here: ONNX networks from the last four states to a value for each action, in ONNX Runtime's WebAssembly build. */
import { SIZE } from "./state.js";

const HISTORY = 4;
/** @type {Promise<any> | null} */
let runtime = null;

/** The runtime; it is fetched when it is first asked for, and again after a failure. */
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
 * @param {string | Uint8Array} file  its address, or its content
 * @param {() => Float32Array} observe  the present state
 */
export async function loadPolicy(file, observe) {
  try {
    const ort = await loadRuntime();
    const session = await ort.InferenceSession.create(file).catch(() => { throw new Error("it is no ONNX model, or did not arrive"); });
    const { inputNames: [input], outputNames: [output], inputMetadata: [{ type, shape }] } = session;
    if (input !== "observations" || output !== "logits") throw new Error("it is none that magical-mj export-policy wrote");
    if (type !== "float32" || shape?.at(-1) !== SIZE) throw new Error("it acts from pictures, and here are states only");
    return new Policy(ort, session, observe);
  } catch (error) {
    throw new Error(`The policy could not be loaded (${error instanceof Error ? error.message : error}): try again`);
  }
}

export class Policy {
  #ort; #session; #observe; #random;
  /** @type {Float32Array[]} the latest, oldest first */ #states = [];
  #step = -1;  // for which an action is chosen
  /** @type {number | null} */ #action = null;
  /** @type {unknown} */ #failure = null;

  /**
   * @param {any} ort  ONNX Runtime
   * @param {any} session  with the network
   * @param {() => Float32Array} observe  the present state
   * @param {() => number} random  a number in [0, 1)
   */
  constructor(ort, session, observe, random = Math.random) {
    this.#ort = ort;
    this.#session = session;
    this.#observe = observe;
    this.#random = random;
  }

  /** The action for this step; null while the network computes. @param {number} step  which was reached: 0, 1, ... */
  next(step) {
    if (this.#failure) throw this.#failure;
    if (step !== this.#step) {
      this.#step = step;
      this.#action = null;
      this.think().then((values) => { this.#action = drawn(values, this.#random()); }, (error) => { this.#failure = error; });
    }
    return this.#action;
  }

  /** Takes in the present state; returns the value of each action. @returns {Promise<Float32Array>} */
  async think() {
    const state = this.#observe();
    this.#states = this.#states.length ? [...this.#states.slice(1), state] : Array(HISTORY).fill(state);
    const seen = new Float32Array(HISTORY * SIZE);
    this.#states.forEach((one, i) => seen.set(one, i * SIZE));
    const { logits } = await this.#session.run({ observations: new this.#ort.Tensor("float32", seen, [1, HISTORY, SIZE]) });
    return logits.data;
  }
}

/** An action by the softmax of the values. @param {Float32Array} values @param {number} point  in [0, 1) */
function drawn(values, point) {
  const largest = Math.max(...values), weights = [...values].map((value) => Math.exp(value - largest));
  let left = point * weights.reduce((sum, weight) => sum + weight);
  const action = weights.findIndex((weight) => (left -= weight) < 0);
  return action < 0 ? weights.indexOf(1) : action;
}
