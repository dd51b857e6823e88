// @ts-check
/** A page in a browser with the built site, for all tests of the file that imports this. */
import { after } from "node:test";
import { fileURLToPath } from "node:url";
import { launch, serve } from "./browser.mjs";

export const OUT = fileURLToPath(new URL("../../out/", import.meta.url));
export const site = await serve(`${OUT}site`), browser = await launch(), page = await browser.context.newPage();
/** The errors and warnings of the page. @type {string[]} */
export const complaints = [];

const complain = (/** @type {string} */ text) => { if (!/blocked an inline style|GPU stall/.test(text)) complaints.push(text); };  // about Playwright's screenshots, and slow drawing by software
page.on("console", (message) => { if (["error", "warning"].includes(message.type())) complain(message.text()); });
page.on("pageerror", (error) => complain(error.message));
after(async () => {
  await browser.close();
  site.close();
});
