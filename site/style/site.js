// @ts-check
/** Sorts tables, opens rows, shows and hides lines of charts, animates cards, and filters the gallery. */
const wide = new ResizeObserver((boxes) => {  // boxes that scroll can be focused by keyboard
  for (const { target } of boxes) /** @type {HTMLElement} */ (target).tabIndex = target.scrollWidth > target.clientWidth ? 0 : -1;
});
for (const box of document.querySelectorAll(".table-wrapper, pre, div.wide")) wide.observe(box);
const isNumber = (/** @type {number} */ column) => column > 1;  // after the method and what it may use
for (const table of /** @type {NodeListOf<HTMLTableElement>} */ (document.querySelectorAll("table.standings"))) {
  const headings = [...(table.tHead?.rows[0].cells ?? [])];
  headings.forEach((heading, column) => heading.querySelector("button")?.addEventListener("click", () => {
    const falls = heading.ariaSort !== "descending" && isNumber(column);
    const key = (/** @type {HTMLTableSectionElement} */ body) => body.rows[0].cells[column].textContent ?? "";
    const sign = falls || (!isNumber(column) && heading.ariaSort === "ascending") ? -1 : 1;
    const isPartial = (/** @type {HTMLTableSectionElement} */ body) => Number(body.classList.contains("partial"));
    const sorted = [...table.tBodies].sort((one, other) => isPartial(one) - isPartial(other) || sign * (isNumber(column)
      ? (Number.parseFloat(key(one)) || 0) - (Number.parseFloat(key(other)) || 0) : key(one).localeCompare(key(other))));
    for (const other of headings) other.ariaSort = "none";
    heading.ariaSort = sign < 0 ? "descending" : "ascending";
    table.append(...sorted);
  }));
}
for (const button of document.querySelectorAll("button.opens")) {
  button.addEventListener("click", () => {
    const details = /** @type {HTMLElement} */ (button.closest("tbody")?.querySelector(".details"));
    details.hidden = !details.hidden;
    button.ariaExpanded = String(!details.hidden);
  });
}
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
const kinds = /** @type {HTMLFormElement | null} */ (document.querySelector("form.kinds"));
kinds?.addEventListener("change", () => {  // methods of some kinds only
  const wanted = [...new FormData(kinds)].filter(([, value]) => value);
  const rows = /** @type {NodeListOf<HTMLElement>} */ (document.querySelectorAll("table.standings > tbody"));
  for (const row of rows) row.hidden = wanted.some(([name, value]) => row.dataset[name] !== value);
  for (const block of /** @type {NodeListOf<HTMLElement>} */ (document.querySelectorAll("section.block"))) {
    block.hidden = !block.querySelector("table.standings > tbody:not([hidden])");
  }
  const left = [...rows].filter((row) => !row.hidden).length;
  /** @type {HTMLElement} */ (kinds.querySelector("output")).textContent = `${left} method${left === 1 ? "" : "s"}`;
});
const compare = /** @type {HTMLFormElement | null} */ (document.querySelector("form.compare"));
if (compare) {
  const { scores, beats, watched } = JSON.parse(/** @type {HTMLElement} */ (document.getElementById("compared")).textContent ?? "");
  const field = (/** @type {string} */ name) => /** @type {HTMLSelectElement} */ (compare.elements.namedItem(name));
  const title = (/** @type {string} */ name) => field(name).selectedOptions[0]?.text ?? "";
  const sides = /** @type {HTMLElement} */ (document.querySelector(".watched"));
  const row = (/** @type {string[]} */ texts, /** @type {string} */ kind) => {
    const line = document.createElement("tr");
    line.append(...texts.map((text, i) => Object.assign(document.createElement(i ? kind : "th"), { textContent: text })));
    return line;
  };
  const show = () => {
    const [one, other] = [field("first").value, field("second").value];
    const rows = Object.keys(scores[one]).map((column) => row([column, scores[one][column], scores[other][column]], "td"));
    document.querySelector("table.compared")?.replaceChildren(row(["Score", title("first"), title("second")], "th"), ...rows);
    /** @type {HTMLElement} */ (document.querySelector(".chance")).textContent = one === other ? "Choose two methods."
      : beats[`${one} ${other}`] === "nan" ? "They cannot be compared: their scores are by different rules."
        : `The probability that a run of ${title("first")} beats a run of ${title("second")} in the same environment: ${beats[`${one} ${other}`]}.`;
    sides.replaceChildren();
  };
  compare.addEventListener("change", (event) => {
    if (["first", "second"].includes(/** @type {HTMLSelectElement} */ (event.target).name)) show();
  });
  compare.addEventListener("submit", (event) => {
    event.preventDefault();
    const place = field("environment").value, seed = place.includes("-Demo") ? "0" : field("seed").value;
    sides.replaceChildren(...["first", "second"].map((side) => {
      const name = field(side).value, figure = document.createElement("figure"), words = document.createElement("figcaption");
      words.textContent = `${title(side)}, ${place}, scene ${seed}`;
      figure.append(words);
      if (!watched[name].includes(place)) {
        words.textContent += ": its actions are not stored";
      } else {
        figure.append(Object.assign(document.createElement("iframe"), { src: `play/#${place}-${seed}@${name}`, title: words.textContent }));
      }
      return figure;
    }));
  });
  show();
}
