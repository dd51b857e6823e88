// @ts-check
/** The page where visitors build an intent, word by word, and find scenes to play it in. @typedef {import("./scene.js").Scene} Scene */
import { addressOf } from "./address.js";
import { draw } from "./draw.js";
import { END, parsed, read, sentenceOf, textOf } from "./intent.js";
import { loadGrammar } from "./ownintent.js";
import { writeScene } from "./scenefile.js";
import { fetchJson } from "./scenes.js";

const EXAMPLES = ["in(colour=red, region) & untouched(others)", "corner(nearest=robot, top left)", "near(any, shape=star, to=red)", "line(all)"];
const FEW = 12;  // a group with more words is closed at first
/** @param {string} id */
const element = (id) => /** @type {any} */ (document.getElementById(id));
const [catalogue, grammar] = /** @type {[any, import("./intent.js").Grammar]} */ (await Promise.all([fetchJson("catalogue.json"), loadGrammar()]));
const worker = new Worker("scenesearch.js", { type: "module" });
let searched = "";  // the canonical text of the intent whose scenes are shown
worker.onmessage = showFound;
worker.onerror = () => { element("problem").textContent = "The search for scenes could not be loaded. Reload the page to try again."; };

/** Shows a text, as far as it goes. @param {string} text */
function update(text) {
  const { parts, next, problem } = read(text, grammar);
  if (element("text").value !== text) element("text").value = text;
  history.replaceState(null, "", text ? `#${encodeURI(text)}` : location.pathname);
  const intent = problem ? null : parsed(text, grammar), sentence = intent ?? parts.length ? sentenceOf(intent ?? parts, grammar) : "";
  element("sentence").textContent = problem && sentence ? `${sentence.slice(0, -1)} …` : sentence;
  element("problem").textContent = problem && text ? `${problem}.` : "";
  element("next").replaceChildren(...grouped(parts.length < grammar.most || problem ? next : []));
  element("next-title").textContent = intent ? "Or add another relation" : "Next word";
  element("next-title").parentElement.hidden = !element("next").children.length;
  const asked = intent ? textOf(intent, grammar) : "";
  if (asked === searched) return;
  searched = asked;
  element("scenes").replaceChildren();
  element("scenes-title").parentElement.hidden = !asked;
  worker.postMessage(asked);
}

/** Buttons for words, those of each test together. @param {import("./intent.js").Choice[]} choices */
function grouped(choices) {
  const groups = /** @type {Map<string, HTMLElement[]>} */ (new Map());
  for (const { word, text } of choices) {
    const button = document.createElement("button"), name = /^(\w+)!?=/.exec(word)?.[1] ?? "";
    button.textContent = word === END ? "That is all" : word;
    button.onclick = () => update(text);
    groups.set(name, [...groups.get(name) ?? [], button]);
  }
  return [...groups].map(([name, buttons]) => {
    const isLong = name && buttons.length > FEW, box = document.createElement(isLong ? "details" : "fieldset"), words = document.createElement("div");
    const title = document.createElement(isLong ? "summary" : "legend");
    title.textContent = name;
    words.className = "words";
    words.append(...buttons);
    box.append(...name ? [title] : [], words);
    return box;
  });
}

/** Shows what the worker found of the last text. @param {MessageEvent<import("./scenesearch.js").Found>} event */
function showFound({ data: { text, start, end, problem, isLast } }) {
  if (text !== searched) return;
  element("problem").textContent = problem;
  if (start && end) element("scenes").append(card(text, start, end));
  element("scenes-title").parentElement.hidden = isLast && !element("scenes").children.length;
}

/** @param {string} text  of the intent @param {import("./scenesearch.js").Start} start @param {Scene} end */
function card(text, { task, variant, seed, scene, isRedrawn }, end) {
  const link = document.createElement("a"), pair = document.createElement("div"), label = document.createElement("strong");
  link.href = `./#${addressOf({ task, variant, seed, shifts: "", scene: isRedrawn ? writeScene(scene) : "", intent: text })}`;
  pair.className = "pair";
  for (const [words, shown] of /** @type {[string, Scene][]} */ ([["start", scene], ["an end", end]])) {
    const figure = document.createElement("span"), canvas = document.createElement("canvas");
    canvas.width = canvas.height = 240;
    draw(canvas, catalogue.look, shown, "allo");
    figure.append(canvas, words);
    pair.append(figure);
  }
  label.textContent = "Play";
  link.append(pair, label, ` in ${task}-${variant}-${seed}${isRedrawn ? ", changed" : ""}`);
  return link;
}

const textInAddress = () => {
  try {
    return decodeURIComponent(location.hash.slice(1));
  } catch {
    return location.hash.slice(1);
  }
};
for (const example of EXAMPLES) {
  const button = document.createElement("button");
  button.textContent = example;
  button.onclick = () => update(example);
  element("examples").append(button, " ");
}
element("text").oninput = () => update(element("text").value);
element("back").onclick = () => update(element("text").value.replace(/(^|[,(&])[^,(&]*[,(&)]?\s*$/, "$1").replace(/[,&]\s*$/, ""));
element("share").onclick = () => navigator.clipboard.writeText(location.href)
  .then(() => { element("problem").textContent = "The link was copied."; }, () => { element("problem").textContent = location.href; });
addEventListener("hashchange", () => update(textInAddress()));
update(textInAddress());
