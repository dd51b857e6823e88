// @ts-check
/**
 * An episode as it is played: actions at 8 Hz, and what to show at any moment in between.
 * @typedef {import("./scene.js").Scene} Scene
 * @typedef {{scene: Scene, act: (action: number) => Scene | Promise<Scene>, close: () => void}} Episode
 *   the scene that it starts in, and what simulates it
 */
import { between } from "./scene.js";

const RATE = 8;  // actions a second

export class Game {
  /**
   * @param {Episode} episode
   * @param {number} horizon  actions
   * @param {() => number | null} choose  the next action; null: wait
   * @param {number} speed  times real time
   */
  constructor(episode, horizon, choose, speed = 1) {
    this.episode = episode;
    this.horizon = horizon;
    this.choose = choose;
    this.period = 1000 / RATE / speed;  // milliseconds
    /** @type {number[]} */
    this.actions = [];
    this.initial = this.before = this.now = episode.scene;
    this.since = -Infinity;  // when the way from `before` to `now` began
    this.busy = false;
    /** @type {Error | null} */
    this.failure = null;
  }

  /** How long is left to act, in seconds. */
  get secondsLeft() {
    return (this.horizon - this.actions.length) / RATE;
  }

  get over() {
    return this.actions.length === this.horizon;
  }

  /**
   * Acts if it is time to.
   * @param {number} time  milliseconds
   */
  advance(time) {
    if (this.busy || this.over || this.failure || time - this.since < this.period) return;
    this.before = this.now;
    const action = this.choose();
    if (action === null) return;
    this.since = time - this.since < 2 * this.period ? this.since + this.period : time;
    this.busy = true;
    this.#act(action).catch((error) => { this.failure = error; }).finally(() => { this.busy = false; });
  }

  /** @param {number} action */
  async #act(action) {
    const scene = this.episode.act(action);
    this.now = scene instanceof Promise ? await scene : scene;
    this.actions.push(action);
  }

  /**
   * What to draw.
   * @param {number} time  milliseconds
   */
  shown(time) {
    return between(this.before, this.now, Math.min(1, Math.max(0, (time - this.since) / this.period)));
  }
}
