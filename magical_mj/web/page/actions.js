// @ts-check
/**
 * Actions as numbers and as letters. A number is 9 * grip + 3 * turn + drive, with turn 1 left and 2 right, and drive
 * 1 forward and 2 back; lists of actions are stored as texts, with "a" for 0.
 */

/** @typedef {"forward" | "back" | "left" | "right" | "grip"} Command */

/**
 * The action of the commands that are given at once; opposite ones cancel each other.
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
 * What a worn or slow robot does instead of what it is told.
 * @param {number[]} table  for each step, how many steps before the command was given, or -1 - n for the action n, whatever was
 * @returns {(command: number) => number}
 */
export function taking(table) {
  /** @type {number[]} */
  const commands = [];
  return (command) => {
    const what = table[commands.length];
    commands.push(command);
    return what < 0 ? -1 - what : commands[commands.length - 1 - what] ?? 0;
  };
}
