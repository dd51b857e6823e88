// @ts-check
/** Puzzles in headless Chromium: two demonstrations, then own episodes, whose end shows the sentence. */
import assert from "node:assert/strict";
import { readFile, writeFile } from "node:fs/promises";
import { test } from "node:test";
import { goalScore, holds } from "../../magical_mj/web/page/goal.js";
import { parsed, read as readText, sentenceOf, textOf } from "../../magical_mj/web/page/intent.js";
import { goalIn, lackOf } from "../../magical_mj/web/page/selectors.js";
import { barriers, downloaded } from "./browser.mjs";
import { OUT, complaints, page, site } from "./opened.mjs";

/** @param {string} path */
const read = async (path) => JSON.parse(await readFile(OUT + path, "utf8"));
/** @param {string} selector @param {string} text */
const until = (selector, text) => page.waitForFunction(([selector, text]) => document.querySelector(selector)?.textContent?.startsWith(text), [selector, text]);

test("scores of intents equal Python's", async () => {
  const [cases, grammar] = await Promise.all([read("site-test/goals.json"), read("site/play/intents.json")]);
  let count = 0, held = 0, between = 0, grounded = 0;
  const seen = new Set();
  for (const { initial, final, goals } of cases) {
    for (const { intent, goal, score, held: right, starts } of goals) {
      if (starts !== null) {  // what a visitor's text selects
        const own = parsed(intent, grammar), select = () => goalIn(own, initial, grammar);
        if (goal) assert.deepEqual(select(), goal, intent);
        else assert.throws(select, Error, intent);
        assert.equal(lackOf(own, initial, grammar) === "", starts, intent);
        grounded += Number(starts);
      }
      const found = goalScore(goal, initial, final);
      assert.ok(Math.abs(found - score) < 1e-12, `${intent}: ${found}, in Python ${score}`);
      assert.equal(holds(goal, initial, final), right, intent);
      count += 1;
      held += Number(right);
      between += Number(score > 0 && score < 1);
      if (right) for (const { relation, some } of goal) seen.add(`${relation}${some ? " any" : ""}`);
    }
  }
  console.log(`${count} scores are equal: ${held} of 1, ${between} between 0 and 1; relations that held: ${[...seen].sort().join(", ")}`);
  assert.ok(held > 500 && between > 200 && grounded > 500);
  assert.ok(seen.size >= 17);  // of the 14 relations, and the six for which one of the blocks can be enough
});

test("texts of intents are read, ordered, refused and put into words as in Python", async () => {
  const [cases, grammar] = await Promise.all([read("site-test/language.json"), read("site/play/intents.json")]);
  for (const [text, canonical, sentence] of cases) {
    const { problem, next } = readText(text, grammar);
    assert.equal(problem === "", canonical !== null, `${text}: ${problem}`);
    for (const choice of next.slice(0, 3)) assert.notDeepEqual(readText(choice.text, grammar).next, [], `${text}, then ${choice.word}`);
    if (canonical === null) continue;
    const intent = parsed(text, grammar);
    assert.deepEqual([textOf(intent, grammar), sentenceOf(intent, grammar)], [canonical, sentence], text);
  }
  const refused = cases.filter((/** @type {string[]} */ [, canonical]) => canonical === null).length;
  console.log(`${cases.length} texts, of which ${refused} are refused`);
  assert.ok(refused > 500 && cases.length - refused > 500);
});

test("an intent is built by buttons, found impossible or played, and shared", async () => {
  await page.goto(`${site.address}play/intents.html`);
  for (const word of ["in", "any", "shape=star", "region"]) await page.click(`#next button:text-is("${word}")`);
  assert.equal(await page.inputValue("#text"), "in(any, shape=star, region)");
  assert.equal(await page.textContent("#sentence"), "Bring at least one star into the region.");
  const link = page.locator("#scenes a").first();
  await link.waitFor();
  assert.deepEqual(await barriers(page), []);
  complaints.length = 0;  // those about axe's styles
  await page.fill("#text", "in(all, region) & out(all)");
  await page.waitForFunction(() => /^No end was found/.test(document.getElementById("problem")?.textContent ?? ""));
  await page.fill("#text", "in(all, wall)");
  await page.waitForFunction(() => document.getElementById("problem")?.textContent === "“wall” is out of place in in(…): there could be region, home.");
  await page.click("#back");
  assert.equal(await page.inputValue("#text"), "in(all");
  await page.fill("#text", "near(any, all, to=red)");
  const words = "Bring at least one block next to the red block.";
  assert.equal(await page.evaluate("location.hash"), "#near(any,%20all,%20to=red)");
  await link.click();
  await page.waitForFunction(() => location.hash.endsWith("intent=near(any,%20all,%20to=red)"));
  await until("#status", "Press");
  assert.equal(await page.textContent("#summary"), words);
  await page.goto(page.url().replace("play/#", "play/?speed=40#"));
  await until("#status", "Press");
  await page.keyboard.press("Space");  // one action, after which the robot stays
  await until("#status", "Over: score 0.00");
  assert.equal(await page.textContent("#pursued-words"), "What is missing: bring at least one block next to the red block.");
  assert.ok(await page.isDisabled("#save") && await page.isVisible("#share"));
  await page.keyboard.press("h");
  await until("#status", "The expert runs in Python");
  await page.click("#about");
  await page.waitForFunction(() => /** @type {HTMLInputElement | null} */ (document.getElementById("text"))?.value === "near(any, all, to=red)");
  assert.deepEqual(complaints, []);
});

test("a puzzle is drawn, watched, played and explained", async () => {
  await page.goto(`${site.address}play/?speed=40#FindDupe-Demo-0`);
  await until("#status", "Press");
  assert.ok(await page.isHidden("#puzzle"));
  await page.evaluate(() => { location.hash = "#puzzle"; });  // the link of the home page
  await until("#status", "Over: score 1.00");
  const name = await page.inputValue("#task");
  assert.match(name, /^Intent[0-9a-f]{10}$/);
  assert.equal(await page.evaluate("location.hash"), `#${name}-Demo-0@expert`);
  const { puzzle } = await page.evaluate(async (name) => (await fetch(`puzzles/${name}-All.json`)).json(), name);
  await page.click("text=Demonstration 2");
  await until("#status", "Watching demonstration 2");
  await until("#status", "Over: score 1.00");
  assert.equal(await page.textContent("#score"), "1.00");
  assert.ok(!(await page.textContent("body"))?.includes(puzzle.sentence), "the sentence is a secret");
  await page.click("text=Play: other blocks");
  await until("#status", "Press");
  assert.equal(await page.textContent("#score"), "?");
  await page.keyboard.down("ArrowUp");
  await until("#status", "Over");
  await page.keyboard.up("ArrowUp");
  assert.equal(await page.textContent("#summary"), puzzle.sentence);
  const score = Number(await page.textContent("#score")), words = await page.textContent("#words");
  const { name: file, text } = await downloaded(page, "#save"), saved = JSON.parse(text);
  assert.deepEqual([file, saved.task, saved.variant, saved.seed], [`${name}-All-0.json`, puzzle.task, "All", 0]);
  await writeFile(`${OUT}site-test/puzzle.json`, JSON.stringify({ saved, score, words }));
  assert.equal(words === "That is what you did.", score === 1);
  await page.keyboard.press("r");
  await until("#status", "Press");
  assert.equal(await page.textContent("#score"), "0.00", "the score is shown once the sentence is known");
  await page.selectOption("#task", "FindDupe");
  await page.waitForFunction(() => location.hash.startsWith("#FindDupe"));
  assert.ok(await page.isHidden("#puzzle"));
  await page.goBack();
  await page.waitForFunction((name) => /** @type {any} */ (document.getElementById("task")).value === name, name);
  await page.click("#want");
  await page.waitForFunction((name) => /** @type {any} */ (document.getElementById("task")).value !== name, name);
  await until("#status", "Over: score 1.00");
  assert.deepEqual(complaints, []);
  assert.deepEqual(await barriers(page), []);
});

test("questions are answered by keys and clicks, explained and saved", async () => {
  await page.goto(`${site.address}play/choose.html`);
  await page.waitForSelector("#options canvas");
  assert.deepEqual(await barriers(page), []);
  await page.keyboard.press("a");
  const wrong = /^(Yes|No, it is [B-D]): .+\./;
  assert.match(await page.textContent("#status") ?? "", wrong);
  await page.keyboard.press("n");
  assert.match(await page.textContent("#count") ?? "", /^Question 2 of/);
  await page.click("#options button:nth-child(4)");
  await page.keyboard.press("b");  // an answer counts once
  const answers = JSON.parse((await downloaded(page, "#save")).text);
  assert.deepEqual(answers.map((/** @type {{answer: string}} */ one) => one.answer), ["A", "D"]);
});
