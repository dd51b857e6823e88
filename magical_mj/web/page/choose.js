// @ts-check
/**
 * Questions about demonstrations: four ends of a new scene, one of which has the demonstrated goal.
 * In a study, the server keeps the answers. Otherwise the page tells which is right, and saves the answers as a file.
 * @typedef {import("./scene.js").Scene} Scene
 * @typedef {{id: string, demonstrations: [Scene, Scene][], scene: Scene, options: Scene[], answer?: string, readings?: string[]}} Question
 *   answer, readings: the right letter, and what each end follows; not in studies
 */
import { agreement } from "./agreement.js";
import { draw, fitToScreen } from "./draw.js";
import { save } from "./recording.js";
import { fetchJson } from "./scenes.js";
import { remembered, Seat } from "./server.js";

const LETTERS = "ABCD";
/** @param {string} id */
const element = (id) => /** @type {any} */ (document.getElementById(id));
const [catalogue, questions] = /** @type {[any, Question[]]} */ (await Promise.all([fetchJson("catalogue.json"), fetchJson("questions.json")]));
const seat = catalogue.collects ? new Seat((text) => { element("status").textContent = text; }) : null;
/** @type {{question: string, answer: string, seconds: number}[]} */
const answers = [];
let left = questions, since = 0;

/** A picture of a scene. @param {Scene} scene @param {string} words */
function picture(scene, words) {
  const figure = document.createElement("figure"), canvas = document.createElement("canvas"), caption = document.createElement("figcaption");
  canvas.role = "img";
  canvas.ariaLabel = described(scene, words);
  caption.textContent = words;
  figure.append(canvas, caption);
  fitToScreen([canvas], () => draw(canvas, catalogue.look, scene, "allo"));
  return figure;
}

/** The scene in words, for people who cannot see it. @param {Scene} scene @param {string} words */
function described({ robot, regions, blocks }, words) {
  const at = (/** @type {{x: number, y: number}} */ { x, y }) => `at ${x.toFixed(2)}, ${y.toFixed(2)}`;
  return [
    `${words}: robot ${at(robot)}`,
    ...regions.map(({ colour, x_min, x_max, y_min, y_max }) => `${colour} region ${at({ x: (x_min + x_max) / 2, y: (y_min + y_max) / 2 })}`),
    ...blocks.map((block) => `${block.colour} ${block.shape} ${at(block)}`),
  ].join("; ");
}

/** Shows the first question that is left. */
function ask() {
  const [question] = left;
  for (const id of ["demonstrations", "scene", "options"]) element(id).replaceChildren();
  element("next").hidden = true;
  element("count").textContent = question ? `Question ${questions.length - left.length + 1} of ${questions.length}` : "";
  element("status").textContent = question ? "" : "That was everything. Thank you!";
  if (!question) return;
  element("demonstrations").append(...question.demonstrations.flatMap(([start, end], i) => [picture(start, `${i + 1}: start`), picture(end, `${i + 1}: end`)]));
  element("scene").append(picture(question.scene, "start"));
  element("options").append(...question.options.map((end, i) => {
    const button = document.createElement("button");
    button.append(picture(end, LETTERS[i]));
    button.onclick = () => answer(question, LETTERS[i]);
    return button;
  }));
  since = performance.now();
}

/** @param {Question} question @param {string} letter */
async function answer(question, letter) {
  const buttons = [...element("options").children], seconds = Math.round(performance.now() - since) / 1000;
  if (question !== left[0]) return;
  for (const button of buttons) button.disabled = true;
  buttons[LETTERS.indexOf(letter)].ariaPressed = "true";
  try {
    if (seat) await seat.ask({ answer: letter, question: question.id, seconds });
  } catch (error) {
    element("status").textContent = /** @type {Error} */ (error).message;
    for (const button of buttons) button.disabled = false;
    return;
  }
  answers.push({ question: question.id, answer: letter, seconds });
  left = left.slice(1);
  if (seat) return ask();
  const { answer: right = "", readings = [] } = question, goal = readings[LETTERS.indexOf(right)];
  buttons[LETTERS.indexOf(right)].classList.add("right");
  element("status").textContent = letter === right ? `Yes: ${goal}` : `No, it is ${right}: ${goal} You chose: ${readings[LETTERS.indexOf(letter)]}`;
  element("next").hidden = element("save").hidden = false;
  element("next").focus();
}

element("next").onclick = ask;
element("save").onclick = () => save(answers, "answers");
addEventListener("keydown", ({ key, ctrlKey, metaKey, altKey }) => {
  if (ctrlKey || metaKey || altKey) return;
  if (key.toLowerCase() === "n" && !element("next").hidden) ask();
  const index = LETTERS.indexOf(key.toUpperCase());
  if (key.length === 1 && index >= 0) element("options").children[index]?.click();
});
if (seat) {
  let reply = await seat.ask({ arrive: remembered() });
  remembered(reply.participant);
  if (reply.consent) {
    await agreement(reply.consent);
    reply = await seat.ask({ arrive: reply.participant, agree: true });
  }
  const known = new Set((await seat.ask({ answered: true })).answered);
  left = questions.filter(({ id }) => !known.has(id));
}
ask();
