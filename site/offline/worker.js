// @ts-check
/** Stores the pages for offline visits. Other files are stored after their first use. Built by site/play.py. */
const HASH = "@HASH@", FILES = "@FILES@".split(" ");
const worker = /** @type {any} */ (self), name = `${worker.registration.scope} ${HASH}`;

worker.addEventListener("install", (/** @type {any} */ event) => event.waitUntil(keep()));
worker.addEventListener("activate", (/** @type {any} */ event) => event.waitUntil(tidy()));
worker.addEventListener("fetch", (/** @type {any} */ event) => {
  const { method, url } = event.request;
  if (method === "GET" && url.startsWith(worker.registration.scope)) event.respondWith(answer(event.request));
});

async function keep() {
  const cache = await caches.open(name);
  await cache.addAll(FILES.map((file) => new Request(file, { cache: "no-cache" })));  // otherwise the browser's cache might return files of an older build
}

/** Deletes older builds. */
async function tidy() {
  const others = (await caches.keys()).filter((one) => one.startsWith(`${worker.registration.scope} `) && one !== name);
  await Promise.all(others.map((one) => caches.delete(one)));
  await worker.clients.claim();
}

/** @param {Request} request */
async function answer(request) {
  const cache = await caches.open(name), kept = await cache.match(request, { ignoreSearch: true });
  if (kept) return kept;
  const reply = await fetch(request);
  if (reply.ok) await cache.put(request, reply.clone());
  return reply;
}
