// @ts-check
/**
 * Actions as numbers and as letters. A number is 9 * grip + 3 * turn + drive, with turn 1 left and 2 right, and drive
 * 1 forward and 2 back. Lists of actions are stored as text, with "a" for 0.
 */

/** @typedef {"forward" | "back" | "left" | "right" | "grip"} Command */

/**
 * The action for commands that are given simultaneously. Opposite ones cancel each other.
 * @param {Set<Command>} commands
 */
export function action(commands) {
  const number = (/** @type {Command} */ one, /** @type {Command} */ other) =>
    commands.has(one) === commands.has(other) ? 0 : commands.has(one) ? 1 : 2;
  return 9 * Number(commands.has("grip")) + 3 * number("left", "right") + number("forward", "back");
}

/** @param {string} letters */
export const fromLetters = (letters) => [...letters].map((letter) => letter.charCodeAt(0) - "a".charCodeAt(0));

/**
 * The action that a robot with the shifts slip or latency executes instead of the commanded one.
 * @param {number[]} table  for each step, the delay of its command in steps, or -1 - n for the action n, independent of what was
 * @returns {(command: number) => number}
 */
export function taking(table) {
  /** @type {number[]} */
  const commands = [];
  return (command) => {
    const what = table[commands.length % table.length];  // episodes of a visitor's intent may be longer
    commands.push(command);
    return what < 0 ? -1 - what : commands[commands.length - 1 - what] ?? 0;
  };
}
