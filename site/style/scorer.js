// @ts-check
/** The order of search results: first what has the words of the query in its title, and the API last. Sphinx reads this global object. */
var Scorer = {
  /** @param {any[]} result */
  score: ([, title, anchor, , score, file, kind]) => {
    if (kind === "object" || kind === "index" || file.startsWith("api.")) return score / 100 - 1000;
    const query = new URLSearchParams(location.search).get("q") ?? "", names = title.toLowerCase().split(/\W+/);
    const starts = query.toLowerCase().split(/\W+/).filter((word) => word.length > 2).map((word) => word.slice(0, Math.max(3, word.length - 3)));
    const found = starts.filter((start) => names.some((/** @type {string} */ name) => name.startsWith(start))).length;
    return score / 10 + 100 * found / (starts.length || 1) - names.length - (anchor ? 5 : 0);
  },
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: { 0: 15, 1: 5, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
