// @ts-check
/** Puzzles in headless Chromium: two demonstrations, then own episodes, whose end shows the sentence. */
import assert from "node:assert/strict";
import { readFile, writeFile } from "node:fs/promises";
import { fileURLToPath } from "node:url";
import { after, before, test } from "node:test";
import { goalScore, holds } from "../../magical_mj/web/page/goal.js";
import { barriers, downloaded, launch, serve } from "./browser.mjs";

const OUT = fileURLToPath(new URL("../../out/", import.meta.url));
/** @type {Awaited<ReturnType<typeof serve>>} */
let site;
/** @type {Awaited<ReturnType<typeof launch>>} */
let browser;
/** @type {import("playwright-core").Page} */
let page;
/** @type {string[]} */
const complaints = [];

before(async () => {
  site = await serve(`${OUT}site`);
  browser = await launch();
  page = await browser.context.newPage();
  page.on("console", (message) => { if (["error", "warning"].includes(message.type())) complaints.push(message.text()); });
  page.on("pageerror", (error) => complaints.push(error.message));
});
after(async () => {
  await browser.close();
  site.close();
});

/** @param {string} selector @param {string} text */
const until = (selector, text) => page.waitForFunction(([selector, text]) => document.querySelector(selector)?.textContent?.startsWith(text), [selector, text]);

test("scores of intents equal Python's", async () => {
  const cases = JSON.parse(await readFile(`${OUT}site-test/goals.json`, "utf8"));
  let count = 0, held = 0, between = 0;
  const seen = new Set();
  for (const { initial, final, goals } of cases) {
    for (const { intent, goal, score, held: right } of goals) {
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
  assert.ok(held > 500 && between > 200);
  assert.ok(seen.size >= 17);  // of the 14 relations, and the six for which one of the blocks can be enough
});

test("a puzzle is drawn, watched, played and explained", async () => {
  await page.goto(`${site.address}play/?speed=40#FindDupe-Demo-0`);
  await until("#status", "Press");
  assert.ok(await page.isHidden("#puzzle"));
  await page.click("#want");
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
