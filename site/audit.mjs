// @ts-check
/** Prints Lighthouse's figures for the built site on a simulated phone with 1.6 Mbit/s and a compressing server: node site/audit.mjs. */
import { fileURLToPath } from "node:url";
import lighthouse from "../out/audit/node_modules/lighthouse/core/index.js";
import { launch } from "../out/audit/node_modules/chrome-launcher/dist/index.js";
import { FLAGS, PAGES, serve } from "./tests/browser.mjs";

const CATEGORIES = ["performance", "accessibility", "best-practices", "seo"];
const MEASURES = { "first-contentful-paint": "first paint", "largest-contentful-paint": "largest paint", "total-blocking-time": "blocked",
  "cumulative-layout-shift": "shift", "total-byte-weight": "loaded" };

const site = await serve(fileURLToPath(new URL("../out/site", import.meta.url)), { compress: true });
const browser = await launch({ chromePath: process.env.CHROMIUM ?? "/usr/bin/chromium", chromeFlags: FLAGS });
console.log(["page", ...CATEGORIES, ...Object.values(MEASURES)].join(" | "));
for (const path of PAGES) {
  const result = await lighthouse(`${site.address}${path}`, { port: browser.port, onlyCategories: CATEGORIES, logLevel: "error" });
  if (!result) throw new Error(`${path} was not measured`);
  const { categories, audits, runtimeError } = result.lhr;
  const scores = CATEGORIES.map((name) => Math.round(100 * (categories[name].score ?? NaN)));
  console.log([path, ...scores, ...Object.keys(MEASURES).map((name) => audits[name].displayValue), runtimeError?.message ?? ""].join(" | "));
  for (const { id, score, scoreDisplayMode, title } of Object.values(audits)) {
    if (process.env.DETAILS && score !== null && score < 0.9 && scoreDisplayMode !== "informative") console.log(`    ${id} ${score}: ${title}`);
  }
}
browser.kill();
site.close();
