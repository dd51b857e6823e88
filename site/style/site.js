// @ts-check
/** Stores visited pages, shows and hides lines of charts, animates cards, and filters the gallery. */
navigator.serviceWorker?.register("worker.js").then(async ({ scope }) => {  // visited pages can be read without a network
  const cache = await caches.open(`${scope} pages`);
  const keep = async (/** @type {string} */ url) => {
    const reply = await fetch(url, { cache: "force-cache" }).catch(() => null);  // the browser has just loaded it
    if (reply?.ok) await cache.put(url, reply);
  };
  keep(location.href.split(/[?#]/)[0]);
  new PerformanceObserver((loaded) => {
    const files = /** @type {PerformanceResourceTiming[]} */ (loaded.getEntries());
    for (const { name, initiatorType } of files) if (name.startsWith(scope) && initiatorType !== "fetch") keep(name);
  }).observe({ type: "resource", buffered: true });
}).catch(() => {});  // some browsers forbid it
const wide = new ResizeObserver((boxes) => {  // boxes that scroll can be focused by keyboard
  for (const { target } of boxes) /** @type {HTMLElement} */ (target).tabIndex = target.scrollWidth > target.clientWidth ? 0 : -1;
});
for (const box of document.querySelectorAll(".table-wrapper, pre, div.wide")) wide.observe(box);
for (const box of /** @type {NodeListOf<HTMLInputElement>} */ (document.querySelectorAll(".chart input"))) {
  const parts = /** @type {HTMLElement} */ (box.closest(".chart")).querySelectorAll(`[data-line="${CSS.escape(box.value)}"]`);
  box.addEventListener("change", () => parts.forEach((part) => part.classList.toggle("off", !box.checked)));
}
const move = (/** @type {Element} */ card, /** @type {boolean} */ isMoving) => {
  const picture = /** @type {HTMLImageElement | null} */ (card.querySelector("[data-moving]"));
  if (!picture || matchMedia("(prefers-reduced-motion: reduce)").matches) return;
  picture.dataset.still ??= picture.src;
  picture.src = (isMoving ? picture.dataset.moving : picture.dataset.still) ?? "";
};
const middle = new IntersectionObserver((cards) => {  // without a pointer, cards in the centre of the screen are animated
  for (const { target, isIntersecting } of cards) move(target, isIntersecting);
}, { rootMargin: "-35% 0px" });
for (const card of document.querySelectorAll(".card:has([data-moving])")) {
  if (matchMedia("(hover: none)").matches) middle.observe(card);
  for (const event of ["pointerenter", "focusin"]) card.addEventListener(event, () => move(card, true));
  for (const event of ["pointerleave", "focusout"]) card.addEventListener(event, () => move(card, false));
}
const filter = /** @type {HTMLFormElement | null} */ (document.querySelector("form.filter"));
if (filter) {
  const cards = /** @type {NodeListOf<HTMLElement>} */ (document.querySelectorAll(".gallery .card"));
  for (const [name, value] of new URLSearchParams(location.hash.slice(1))) {
    const field = /** @type {HTMLSelectElement | null} */ (filter.elements.namedItem(name));
    if (field) field.value = value;
  }
  const choose = () => {
    const { task, axis } = /** @type {Record<string, string>} */ (Object.fromEntries(new FormData(filter)));
    for (const card of cards) {
      const { task: its, axes = "" } = card.dataset;
      card.hidden = Boolean((task && task !== its) || (axis && !axes.split(" ").includes(axis)));
    }
    const left = [...cards].filter((card) => !card.hidden).length;
    /** @type {HTMLElement} */ (filter.querySelector("output")).textContent = `${left} environment${left === 1 ? "" : "s"}`;
    history.replaceState(null, "", task || axis ? `#${new URLSearchParams({ task, axis })}` : location.pathname);
  };
  filter.addEventListener("change", choose);
  choose();
}
