// @ts-check
/** Answers with the stored pages, which site.js stores when they are visited, if the network does not answer. */
const worker = /** @type {any} */ (self);

worker.addEventListener("activate", (/** @type {any} */ event) => event.waitUntil(worker.clients.claim()));
worker.addEventListener("fetch", (/** @type {any} */ event) => {
  const { method, url } = event.request;
  if (method === "GET" && url.startsWith(worker.registration.scope)) event.respondWith(fetch(event.request).catch(() => stored(url)));
});

/** @param {string} url */
async function stored(url) {
  const cache = await caches.open(`${worker.registration.scope} pages`), other = url.endsWith("/") ? `${url}index.html` : url.replace(/index\.html$/, "");
  return await cache.match(url) ?? await cache.match(other) ?? Response.error();
}
