// @ts-check
/**
 * The page where visitors build an intent, word by word, and find scenes to play it in.
 * @typedef {import("./scene.js").Scene} Scene
 * @typedef {{task: string, variant: string, seed: number, scene: Scene}} Start
 */
import { addressOf } from "./address.js";
import { draw } from "./draw.js";
import { END, parsed, read, sentenceOf, textOf } from "./intent.js";
import { faults } from "./legal.js";
import { loadGrammar } from "./ownintent.js";
import { plannedEnd, randomFrom } from "./planned.js";
import { CHOICES, writeScene } from "./scenefile.js";
import { fetchJson } from "./scenes.js";
import { goalIn, lackOf } from "./selectors.js";

const EXAMPLES = ["in(colour=red, region) & untouched(others)", "corner(nearest=robot, top left)", "near(any, shape=star, to=red)", "line(all)"];
const SHOWN = 4, TRIED = 10, REDRAWN = 400;  // scenes
const FEW = 12;  // a group with more words is closed at first
/** @param {string} id */
const element = (id) => /** @type {any} */ (document.getElementById(id));
const [catalogue, grammar, starts] = /** @type {[any, import("./intent.js").Grammar, Start[]]} */ (
  await Promise.all([fetchJson("catalogue.json"), loadGrammar(), fetchJson("starts.json")]));
let searches = 0;  // only the last search shows its scenes

/** Shows a text, as far as it goes. @param {string} text */
function update(text) {
  const { parts, next, problem } = read(text, grammar), search = ++searches;
  if (element("text").value !== text) element("text").value = text;
  history.replaceState(null, "", text ? `#${encodeURI(text)}` : location.pathname);
  const intent = problem ? null : parsed(text, grammar), sentence = intent ?? parts.length ? sentenceOf(intent ?? parts, grammar) : "";
  element("sentence").textContent = problem && sentence ? `${sentence.slice(0, -1)} …` : sentence;
  element("problem").textContent = problem && text ? `${problem}.` : "";
  element("next").replaceChildren(...grouped(parts.length < grammar.most || problem ? next : []));
  element("next-title").textContent = intent ? "Or add another relation" : "Next word";
  element("next-title").parentElement.hidden = !element("next").children.length;
  element("scenes").replaceChildren();
  element("scenes-title").parentElement.hidden = !intent;
  if (intent) showScenes(intent, search);
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

/** Shows scenes where an intent can start and be reached, or says why there are none. @param {import("./intent.js").Intent} intent @param {number} search */
async function showScenes(intent, search) {
  const whys = /** @type {Record<string, number>} */ ({});
  let tried = 0, found = 0;
  for (const start of candidates(intent, whys)) {
    element("problem").textContent = "Looking for scenes …";
    await new Promise((resolve) => setTimeout(resolve));  // the page stays responsive
    if (search !== searches) return;
    const end = plannedEnd(goalIn(intent, start.scene, grammar), start.scene);
    tried += 1;
    if (end) element("scenes").append(card(intent, start, end));
    found += Number(end !== null);
    if (found === SHOWN || tried === TRIED) break;
  }
  element("scenes-title").parentElement.hidden = !found;
  const [[why] = [""]] = Object.entries(whys).sort((a, b) => b[1] - a[1]);
  element("problem").textContent = found ? "" : tried ? `No end was found that satisfies it, in any of ${tried} scenes: its relations may contradict each other.`
    : `It can start in none of this page's scenes; in most of them, ${why}.`;
}

/** The scenes where an intent can start: first those of the page, then such with other colours and shapes. @param {import("./intent.js").Intent} intent @param {Record<string, number>} whys  counts why others are not */
function* candidates(intent, whys) {
  const random = randomFrom(7), pick = (/** @type {string[]} */ all) => all[Math.floor(random() * all.length)];
  for (let i = 0; i < starts.length + REDRAWN; i++) {
    const start = starts[i % starts.length], isRedrawn = i >= starts.length, colours = [pick(CHOICES.colour), pick(CHOICES.colour)], shapes = [pick(CHOICES.shape), pick(CHOICES.shape)];
    const blocks = start.scene.blocks.map((block) => ({ ...block, colour: pick(random() < 0.5 ? colours : CHOICES.colour), shape: pick(random() < 0.5 ? shapes : CHOICES.shape) }));
    const scene = isRedrawn ? { ...start.scene, blocks } : start.scene, why = lackOf(intent, scene, grammar);
    if (why) whys[why] = (whys[why] ?? 0) + 1;
    else if (!isRedrawn || !faults(scene, catalogue.solids).length) yield { ...start, scene, isRedrawn };
  }
}

/** @param {import("./intent.js").Intent} intent @param {Start & {isRedrawn: boolean}} start @param {Scene} end */
function card(intent, { task, variant, seed, scene, isRedrawn }, end) {
  const link = document.createElement("a"), pair = document.createElement("div"), label = document.createElement("strong");
  link.href = `./#${addressOf({ task, variant, seed, shifts: "", scene: isRedrawn ? writeScene(scene) : "", intent: textOf(intent, grammar) })}`;
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
