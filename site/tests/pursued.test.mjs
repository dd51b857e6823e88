// @ts-check
/** What the page says at the end of an episode, a policy's or a person's: the sentences are Python's. */
import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { test } from "node:test";
import { barriers } from "./browser.mjs";
import { OUT, page, site } from "./opened.mjs";

/** @param {string} text */
const untilStatus = (text) => page.waitForFunction((text) => document.getElementById("status")?.textContent?.startsWith(text), text);
const picture = () => page.$eval("#allo", (canvas) => /** @type {HTMLCanvasElement} */ (canvas).toDataURL());

test("after a failure, the page says what was pursued, and outlines the blocks", async () => {
  for (const { address, watched, played } of JSON.parse(await readFile(`${OUT}site-test/watched.json`, "utf8"))) {
    await page.goto("about:blank");
    await page.goto(`${site.address}play/?speed=40#${address}@state-bc`);
    await untilStatus("Over: score 0.00");
    assert.equal(await page.textContent("#pursued-words"), watched, address);
    assert.match(await page.textContent("#compared") ?? "", /^The best of \d+ methods here scored 1.00 \(.+\); \w+ scored less than this episode.$/);
    await page.keyboard.press("r");
    await untilStatus("Press");
    assert.ok(await page.isHidden("#ended"), "nothing is said before the end");
    const before = await picture();
    await page.keyboard.press("Space");  // one action, after which the robot stays
    await untilStatus("Over: score 0.00");
    assert.equal(await page.textContent("#pursued-words"), played, address);
    assert.equal(await page.isVisible("#outlines"), played.startsWith("It moved no block"), address);
    if (await page.isVisible("#outlines")) assert.notEqual(await picture(), before, "blocks are outlined");
  }
  assert.deepEqual(await barriers(page), []);
});
