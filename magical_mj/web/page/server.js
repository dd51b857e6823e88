// @ts-check
/**
 * A connection to the server of `magical-mj serve` and `collect`: successive requests, each with one answer.
 * @typedef {import("./scenes.js").Opener} Opener
 */
import { moved } from "./scene.js";

/** There is no connection to the server, or it broke before the answer. */
class Disconnected extends Error {}
const GONE = "There is no connection to the server: trying again …";
const PAUSES = [500, 1000, 2000, 5000];  // milliseconds before each attempt to reconnect; the last one is repeated
/** Milliseconds without an answer before a connection counts as broken, because interrupted connections give no error. */
const PATIENCE = 20_000;
const REFUSED = "The server refuses this address: open the link that it printed; see also its option --origin";

export class Seat {
  /** @type {string | null} the participant's id, if the server runs a study */
  #participant = null;
  #connected = false;  // whether a connection was ever open
  #tell;

  /** @param {(text: string) => void} tell  called when the connection broke, and with "" when a request is answered again */
  constructor(tell) {
    this.#tell = tell;
    this.#connect();
  }

  #connect() {
    const address = new URL("socket", document.baseURI);
    address.protocol = address.protocol.replace("http", "ws");
    /** @type {{resolve: (reply: any) => void, reject: (error: Error) => void}[]} */
    const waiting = [];
    this.waiting = waiting;
    this.socket = new WebSocket(address);
    this.opened = new Promise((resolve, reject) => {
      this.socket.addEventListener("open", () => {
        this.#connected = true;
        resolve(null);
      });
      this.socket.addEventListener("close", () => reject(this.#connected ? new Disconnected(GONE) : new Error(REFUSED)));
    });
    this.opened.catch(() => {});  // requests report the error
    this.socket.addEventListener("message", ({ data }) => {
      const reply = JSON.parse(data), asked = waiting.shift();
      if (reply.error) asked?.reject(new Error(reply.error));
      else asked?.resolve(reply);
    });
    this.socket.addEventListener("close", () => {
      for (const { reject } of waiting.splice(0)) reject(new Disconnected(GONE));
    });
  }

  /** Sends a request. If the connection breaks, reconnects and sends it again, until it is answered. @param {object} question @returns {Promise<any>} */
  ask(question) {
    return this.#persist(async () => {
      if (this.socket.readyState > WebSocket.OPEN) {
        this.#connect();
        if (this.#participant) await this.#send({ return: this.#participant });
      }
      const reply = await this.#send(question);
      this.#participant = reply.participant ?? this.#participant;
      return reply;
    });
  }

  /** Repeats an attempt while there is no connection. @template T @param {() => Promise<T>} attempt @returns {Promise<T>} */
  async #persist(attempt) {
    for (let failures = 0; ; failures++) {
      try {
        const reply = await attempt();
        if (failures) this.#tell("");
        return reply;
      } catch (error) {
        if (!(error instanceof Disconnected)) throw error;
        this.#tell(GONE);
        await new Promise((resolve) => { setTimeout(resolve, PAUSES[Math.min(failures, PAUSES.length - 1)]); });
      }
    }
  }

  /** @param {object} question @returns {Promise<any>} */
  async #send(question) {
    const { socket, waiting, opened } = this;
    /** @type {ReturnType<typeof setTimeout> | undefined} */
    let late;
    try {
      return await new Promise((resolve, reject) => {
        late = setTimeout(() => {
          reject(new Disconnected(GONE));
          socket.close();
        }, PATIENCE);
        opened.then(() => {
          if (socket.readyState !== WebSocket.OPEN) throw new Disconnected(GONE);
          waiting.push({ resolve, reject });
          socket.send(JSON.stringify(question));
        }).catch(reject);
      });
    } finally {
      clearTimeout(late);
    }
  }

  /** @type {Opener} */
  open = async (_environment, { seed }, task, variant) => {
    const open = () => this.ask({ open: { task, variant, seed } });
    const { scene, goal } = await open();
    let { socket } = this, isOpen = true;  // the connection whose server simulates this episode
    /** @type {number[]} */
    const actions = [];
    const act = (/** @type {number} */ action) => this.#persist(async () => {
      if (!isOpen) throw new Error("this episode was left");
      if (this.socket !== socket || socket.readyState !== WebSocket.OPEN) {  // the episode is repeated up to here over a new connection
        await open();
        ({ socket } = this);
        for (const earlier of actions) await this.#send({ act: earlier });
      }
      const { poses } = await this.#send({ act: action });
      actions.push(action);
      return moved(scene, poses);
    });
    return { scene, goal, act, close: () => { isOpen = false; } };
  };
}

/** The participant's id, stored by the browser if it is allowed to. @param {string} [id]  to store */
export function remembered(id) {
  try {
    if (id) localStorage.setItem("participant", id);
    return localStorage.getItem("participant");
  } catch {
    return null;
  }
}
