// @ts-check
/** The leaderboard: its filters, order, opened rows and comparison are in the address, so a reload, a link and Back keep them. */
const kinds = /** @type {HTMLFormElement} */ (document.querySelector("form.kinds"));
const compare = /** @type {HTMLFormElement} */ (document.querySelector("form.compare"));
const tables = /** @type {HTMLTableElement[]} */ ([...document.querySelectorAll("table.standings")]);
const original = new Map(tables.map((table) => [table, [...table.tBodies]]));
const opened = (/** @type {URLSearchParams} */ wish) => new Set((wish.get("open") ?? "").split("|").filter(Boolean));

/** Changes the address, and then the page. @param {Record<string, string>} changes  "" for what is not chosen */
function wish(changes) {
  const address = new URL(location.href);
  for (const [name, value] of Object.entries(changes)) {
    if (value) address.searchParams.set(name, value);
    else address.searchParams.delete(name);
  }
  history.pushState(null, "", address);
  show();
}

/** Shows what the address says. */
function show() {
  const chosen = new URLSearchParams(location.search), open = opened(chosen);
  for (const form of [kinds, compare]) {
    form.reset();
    for (const field of /** @type {Iterable<any>} */ (form.elements)) {
      const value = chosen.get(field.name);
      if (field.type === "checkbox") field.checked = value === field.value;
      else if ([...field.options ?? []].some((one) => one.value === value)) field.value = value;
    }
  }
  for (const table of tables) order(table, chosen.get("order") ?? "");
  for (const body of tables.flatMap((table) => [...table.tBodies])) {
    const isOpen = open.has(body.dataset.name ?? ""), details = /** @type {HTMLElement} */ (body.querySelector(".details"));
    details.hidden = !isOpen;
    /** @type {HTMLElement} */ (body.querySelector("button.opens")).ariaExpanded = String(isOpen);
  }
  filter();
  if (chosen.has("first") || chosen.has("second")) /** @type {HTMLDetailsElement} */ (compare.closest("details")).open = true;
  showCompared();
}

/** Orders a table by a column, with a minus for the largest first. Methods without some environments stay last. @param {HTMLTableElement} table @param {string} by */
function order(table, by) {
  const name = by.replace(/^-/, ""), headings = [...table.tHead?.rows[0].cells ?? []], column = headings.findIndex((one) => one.dataset.column === name);
  const key = (/** @type {HTMLTableSectionElement} */ body) => body.rows[0].cells[column].textContent ?? "";
  const isPartial = (/** @type {HTMLTableSectionElement} */ body) => Number(body.classList.contains("partial")), sign = by === name ? 1 : -1;
  const bodies = [...original.get(table) ?? []];
  if (column >= 0) {
    bodies.sort((one, other) => isPartial(one) - isPartial(other) || sign * (column
      ? (Number.parseFloat(key(one)) || 0) - (Number.parseFloat(key(other)) || 0) : key(one).localeCompare(key(other))));
  }
  for (const heading of headings) heading.ariaSort = heading.dataset.column !== name ? "none" : sign < 0 ? "descending" : "ascending";
  table.append(...bodies);
}

/** Hides the methods of other kinds, and the blocks without any. */
function filter() {
  const wanted = [...new FormData(kinds)].filter(([name, value]) => value && name !== "columns");
  const rows = tables.flatMap((table) => [...table.tBodies]);
  for (const row of rows) row.hidden = wanted.some(([name, value]) => row.dataset[name] !== value);
  for (const block of /** @type {NodeListOf<HTMLElement>} */ (document.querySelectorAll("section.block"))) {
    block.hidden = !block.querySelector("table.standings > tbody:not([hidden])");
  }
  const left = rows.filter((row) => !row.hidden).length;
  /** @type {HTMLElement} */ (kinds.querySelector("output")).textContent = `${left} method${left === 1 ? "" : "s"}`;
}

const { scores, beats, watched } = JSON.parse(/** @type {HTMLElement} */ (document.getElementById("compared")).textContent ?? "");
const sides = /** @type {HTMLElement} */ (document.querySelector(".watched"));
const field = (/** @type {string} */ name) => /** @type {HTMLSelectElement} */ (compare.elements.namedItem(name));
const title = (/** @type {string} */ name) => field(name).selectedOptions[0]?.text ?? "";

/** The scores of both methods. */
function showCompared() {
  const row = (/** @type {string[]} */ texts, /** @type {string} */ kind) => {
    const line = document.createElement("tr");
    line.append(...texts.map((text, i) => Object.assign(document.createElement(i ? kind : "th"), { textContent: text })));
    return line;
  };
  const [one, other] = [field("first").value, field("second").value];
  const rows = Object.keys(scores[one]).map((column) => row([column, scores[one][column], scores[other][column]], "td"));
  document.querySelector("table.compared")?.replaceChildren(row(["Score", title("first"), title("second")], "th"), ...rows);
  /** @type {HTMLElement} */ (document.querySelector(".chance")).textContent = one === other ? "Choose two methods."
    : beats[`${one} ${other}`] === "nan" ? "They cannot be compared: their scores are by different rules."
      : `The probability that a run of ${title("first")} beats a run of ${title("second")} in the same environment: ${beats[`${one} ${other}`]}.`;
}

/** Plays an episode of each of both methods. */
function watchBoth() {
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
}

for (const table of tables) {
  for (const heading of table.tHead?.rows[0].cells ?? []) {
    const { column = "" } = heading.dataset, rises = column === "Method" || column === "Rank";
    heading.querySelector("button")?.addEventListener("click", () => {
      const isFirst = heading.ariaSort === "none";
      wish({ order: (isFirst ? rises : heading.ariaSort === "descending") ? column : `-${column}` });
    });
  }
}
for (const body of tables.flatMap((table) => [...table.tBodies])) {
  body.querySelector("button.opens")?.addEventListener("click", () => {
    const open = opened(new URLSearchParams(location.search)), { name = "" } = body.dataset;
    if (!open.delete(name)) open.add(name);
    wish({ open: [...open].join("|") });
  });
}
for (const form of [kinds, compare]) {
  form.addEventListener("change", (event) => {
    const { name, type, checked, value } = /** @type {any} */ (event.target);
    if (form === compare) sides.replaceChildren();
    wish({ [name]: type === "checkbox" && !checked ? "" : value });
  });
}
compare.addEventListener("submit", (event) => {
  event.preventDefault();
  watchBoth();
});
addEventListener("popstate", show);
show();
