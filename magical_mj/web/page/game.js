// @ts-check
/**
 * A running episode: actions at 8 Hz, and interpolated scenes between them.
 * @typedef {import("./scene.js").Scene} Scene
 * @typedef {{scene: Scene, act: (action: number | number[]) => Scene | Promise<Scene>, close: () => void,
 *   simulation?: import("./simulation.js").Simulation, goal?: import("./goal.js").Goal}} Episode
 *   scene: the initial one; simulation: if the browser simulates; goal: of a puzzle, if the server simulates
 */
import { between } from "./scene.js";

const RATE = 8;  // actions a second
const PAUSE = 250;  // milliseconds: a longer delay is not caught up

export class Game {
  /**
   * @param {Episode} episode
   * @param {number} horizon  actions
   * @param {() => number | number[] | null} choose  the next action; null: wait
   * @param {number} speed  times real time
   */
  constructor(episode, horizon, choose, speed = 1) {
    this.episode = episode;
    this.horizon = horizon;
    this.choose = choose;
    this.period = 1000 / RATE / speed;  // milliseconds
    /** @type {(number | number[])[]} */
    this.actions = [];
    this.initial = this.before = this.now = episode.scene;
    this.since = -Infinity;  // when the interpolation from `before` to `now` began
    this.busy = false;
    /** @type {Error | null} */
    this.failure = null;
    this.sent = false;  // to the server of the study
  }

  /** The remaining time, in seconds. */
  get secondsLeft() {
    return (this.horizon - this.actions.length) / RATE;
  }

  get over() {
    return this.actions.length === this.horizon;
  }

  /**
   * Acts as often as it is time to: usually once in several frames. After a pause, time goes on from now.
   * @param {number} time  milliseconds
   */
  advance(time) {
    while (!this.busy && !this.over && !this.failure && time - this.since >= this.period) {
      this.before = this.now;
      const action = this.#chosen();
      if (action === null) return;
      const next = this.since + this.period;
      this.since = time - next > PAUSE ? time : next;
      this.#act(action);
    }
  }

  /** The next action. Null: wait. A policy may fail. */
  #chosen() {
    try {
      return this.choose();
    } catch (error) {
      this.failure = /** @type {Error} */ (error);
      return null;
    }
  }

  /** @param {number | number[]} action */
  #act(action) {
    const accept = (/** @type {Scene} */ scene) => {
      this.now = scene;
      this.actions.push(action);
    };
    const scene = this.episode.act(action);
    if (!(scene instanceof Promise)) return accept(scene);
    this.busy = true;
    scene.then(accept).catch((error) => { this.failure = error; }).finally(() => { this.busy = false; });
  }

  /**
   * What to draw.
   * @param {number} time  milliseconds
   */
  shown(time) {
    return between(this.before, this.now, Math.min(1, Math.max(0, (time - this.since) / this.period)));
  }
}
