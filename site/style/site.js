// @ts-check
/** Tables that are sorted by their headings, rows that open, and a chart whose lines are switched. */
for (const table of /** @type {NodeListOf<HTMLTableElement>} */ (document.querySelectorAll("table.standings"))) {
  const headings = [...(table.tHead?.rows[0].cells ?? [])];
  headings.forEach((heading, column) => heading.querySelector("button")?.addEventListener("click", () => {
    const falls = heading.ariaSort !== "descending" && column > 0;
    const key = (/** @type {HTMLTableSectionElement} */ body) => body.rows[0].cells[column].textContent ?? "";
    const sign = falls || (column === 0 && heading.ariaSort === "ascending") ? -1 : 1;
    const sorted = [...table.tBodies].sort((one, other) => sign * (column
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
  const lines = document.querySelector(`[data-line="${box.value}"]`);
  box.addEventListener("change", () => lines?.classList.toggle("off", !box.checked));
}
