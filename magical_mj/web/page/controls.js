// @ts-check
/**
 * Keys and touch buttons: the current commands.
 * @typedef {import("./actions.js").Command} Command
 */
import { action } from "./actions.js";

/** @type {Record<string, Command>} */
const KEYS = {
  ArrowUp: "forward", ArrowDown: "back", ArrowLeft: "left", ArrowRight: "right",
  KeyW: "forward", KeyS: "back", KeyA: "left", KeyD: "right", Space: "grip",
};

export class Controls {
  /**
   * @param {HTMLElement} arena  keys count while it, or nothing, has the focus
   * @param {Iterable<HTMLButtonElement>} buttons  each with a command as data-command
   */
  constructor(arena, buttons) {
    /** @type {Map<string | HTMLElement, Command>} by key or button: two keys may give the same command */
    this.held = new Map();
    /** @type {Set<Command>} all commands that were given since the last action */
    this.tapped = new Set();
    addEventListener("keydown", (event) => {
      const command = KEYS[event.code];
      const elsewhere = event.target !== document.body && event.target !== arena;
      if (!command || elsewhere || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();  // the page must not scroll
      this.held.set(event.code, command);
      if (!event.repeat) this.tapped.add(command);  // a repeated event would count a released key in the next action
    });
    addEventListener("keyup", (event) => this.held.delete(event.code));
    addEventListener("blur", () => this.held.clear());
    for (const button of buttons) this.#touch(button, /** @type {Command} */ (button.dataset.command));
  }

  /** @param {HTMLButtonElement} button @param {Command} command */
  #touch(button, command) {
    button.addEventListener("pointerdown", (event) => {
      event.preventDefault();
      button.setPointerCapture(event.pointerId);
      this.held.set(button, command);
      this.tapped.add(command);
    });
    for (const end of ["pointerup", "pointercancel"]) button.addEventListener(end, () => this.held.delete(button));
    button.addEventListener("contextmenu", (event) => event.preventDefault());  // the menu of a long press
    button.addEventListener("click", (event) => event.detail || this.tapped.add(command));  // by keyboard or screen reader
  }

  /** Whether a key or button was pressed since the last action. */
  get touched() {
    return this.held.size + this.tapped.size > 0;
  }

  /** The action to take now. */
  next() {
    const commands = new Set([...this.held.values(), ...this.tapped]);
    this.tapped.clear();
    return action(commands);
  }
}
