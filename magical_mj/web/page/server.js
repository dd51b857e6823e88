// @ts-check
/**
 * A connection to the server of `magical-mj play --web`: successive requests, each with one answer.
 * @typedef {import("./scenes.js").Opener} Opener
 */
import { moved } from "./scene.js";

const GONE = "There is no connection to the server: try again";
const LOST = "The connection to the server was lost: play this scene again (R)";
/** Milliseconds without an answer before a connection counts as broken, because interrupted connections give no error. */
const PATIENCE = 20_000;
const REFUSED = "The server refuses this address: open the link that it printed; see also its option --origin";

export class Seat {
  /** @type {string | null} the participant's id, if the server runs a study */
  #participant = null;
  #connected = false;  // whether a connection was ever open

  constructor() {
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
      this.socket.addEventListener("close", () => reject(new Error(this.#connected ? GONE : REFUSED)));
    });
    this.opened.catch(() => {});  // requests report the error
    this.socket.addEventListener("message", ({ data }) => {
      const reply = JSON.parse(data), asked = waiting.shift();
      if (reply.error) asked?.reject(new Error(reply.error));
      else asked?.resolve(reply);
    });
    this.socket.addEventListener("close", () => {
      for (const { reject } of waiting.splice(0)) reject(new Error(GONE));
    });
  }

  /** Sends a request, over a new connection if the last one broke. @param {object} question @returns {Promise<any>} */
  async ask(question) {
    if (this.socket.readyState > WebSocket.OPEN) {
      this.#connect();
      if (this.#participant) await this.#send({ return: this.#participant });
    }
    const reply = await this.#send(question);
    this.#participant = reply.participant ?? this.#participant;
    return reply;
  }

  /** @param {object} question @returns {Promise<any>} */
  async #send(question) {
    const { socket, waiting, opened } = this;
    /** @type {ReturnType<typeof setTimeout> | undefined} */
    let late;
    try {
      return await new Promise((resolve, reject) => {
        late = setTimeout(() => {
          reject(new Error(GONE));
          socket.close();
        }, PATIENCE);
        opened.then(() => {
          if (socket.readyState !== WebSocket.OPEN) throw new Error(GONE);
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
    const { scene } = await this.ask({ open: { task, variant, seed } });
    const { socket } = this;  // the connection whose server simulates this episode
    const act = async (/** @type {number} */ action) => {
      if (this.socket !== socket || socket.readyState !== WebSocket.OPEN) throw new Error(LOST);
      return moved(scene, (await this.#send({ act: action })).poses);
    };
    return { scene, act, close: () => {} };
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
