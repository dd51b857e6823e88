// @ts-check
/**
 * A seat at the server of `magical-mj play --web`: one question after the other, each with one answer.
 * @typedef {import("./scenes.js").Opener} Opener
 */
import { moved } from "./scene.js";

export class Seat {
  constructor() {
    const address = new URL("socket", document.baseURI);
    address.protocol = address.protocol.replace("http", "ws");
    this.socket = new WebSocket(address);
    /** @type {{resolve: (reply: any) => void, reject: (error: Error) => void}[]} */
    this.waiting = [];
    this.opened = new Promise((resolve, reject) => {
      this.socket.addEventListener("open", resolve);
      this.socket.addEventListener("close", () => {
        reject(new Error("The server refuses this address: open the link that it printed; see also its option --origin"));
      });
    });
    this.opened.catch(() => {});  // whoever asks is told
    this.socket.addEventListener("message", ({ data }) => {
      const reply = JSON.parse(data), asked = this.waiting.shift();
      if (reply.error) asked?.reject(new Error(reply.error));
      else asked?.resolve(reply);
    });
    this.socket.addEventListener("close", () => {
      for (const { reject } of this.waiting.splice(0)) reject(new Error("The server is gone: reload the page"));
    });
  }

  /** @param {object} question @returns {Promise<any>} */
  async ask(question) {
    await this.opened;
    return new Promise((resolve, reject) => {
      if (this.socket.readyState !== WebSocket.OPEN) return reject(new Error("The server is gone: reload the page"));
      this.waiting.push({ resolve, reject });
      this.socket.send(JSON.stringify(question));
    });
  }

  /** @type {Opener} */
  open = async (_environment, { seed }, task, variant) => {
    const { scene } = await this.ask({ open: { task, variant, seed } });
    const act = async (/** @type {number} */ action) => moved(scene, (await this.ask({ act: action })).poses);
    return { scene, act, close: () => {} };
  };
}
