// @ts-check
/**
 * The language of intents, the same as in magical_mj/intents: texts, canonical forms and sentences. Tests compare them.
 * The relations and words are data from Python, of `magical_mj.web.grammar`.
 * @typedef {{name: string, value: string, equal: boolean}} Test
 * @typedef {{relation: string, tests: Test[], argument: string, number: number, some: boolean}} Part  a relation with its arguments
 * @typedef {Part[]} Intent  in canonical form
 * @typedef {{arguments: string[], quantified: boolean, ofBlocks: boolean, each: boolean, prefix: string, least: number}} Relation
 * @typedef {{relations: Record<string, Relation>, tests: Record<string, Test>, pairs: string[][], most: number, longest: number,
 *   nearly: number, time: Record<"least" | "rounded" | "rate" | "fetch" | "carry", number>, words: {clauses: Record<string, string>, nouns: Record<string, string[]>,
 *   references: Record<string, string>, numbers: string[], last: string[], pause: string}}} Grammar
 * @typedef {{word: string, text: string}} Choice  text: that with one more word
 * @typedef {{parts: Part[], next: Choice[], problem: string}} Reading
 *   parts: the complete relations; next: how it can go on; problem: why it is not an intent, "" if it is one
 */
const ALL = "all", OTHERS = "others", ANY = "any", HOME = "home";
export const END = ")";  // the word that ends a relation
const DIGITS = [..."123456789"];
const NAMED = 8;  // the most possible words that a message lists

/** @param {string[]} words */
const listed = (words) => `${words.slice(0, NAMED).join(", ")}${words.length > NAMED ? " …" : ""}`;

/** @param {Test} test */
const testText = ({ name, value, equal }) => `${name}${equal ? "=" : "!="}${value}`;
/** @param {Part} part */
const blocksText = ({ tests }) => tests.map((test) => test.name === OTHERS ? OTHERS : testText(test)).join(", ") || ALL;
/** @param {Part} part */
export const isRest = ({ tests }) => tests[0]?.name === OTHERS;
/** @param {Part} part */
const namesOne = ({ tests }) => ["odd", "nearest", "farthest"].includes(tests[0]?.name);

/** The text of an intent. @param {Intent} intent @param {Grammar} grammar */
export const textOf = (intent, grammar) => intent.map((part) => partText(part, grammar)).join(" & ");

/** @param {Part} part @param {Grammar} grammar */
function partText(part, { relations }) {
  const { relation, argument, number, some } = part, { ofBlocks, prefix } = relations[relation];
  const words = [number || "", some ? ANY : "", ofBlocks ? blocksText(part) : "", argument && prefix + argument];
  return `${relation}(${words.filter(Boolean).join(", ")})`;
}

/** The intent of a text. Throws an error that says what is wrong. @param {string} text @param {Grammar} grammar */
export function parsed(text, grammar) {
  const { parts, problem } = read(text, grammar);
  if (problem) throw new Error(problem);
  return canonical(parts, grammar);
}

/** Reads a text, which may be unfinished. @param {string} text @param {Grammar} grammar @returns {Reading} */
export function read(text, grammar) {
  const names = Object.keys(grammar.relations), parts = /** @type {Part[]} */ ([]), isTest = (/** @type {string} */ name) => Object.values(grammar.tests).some((test) => test.name === name);
  if (text.length > grammar.longest) return { parts, next: [], problem: `An intent has at most ${grammar.longest} characters` };
  for (let at = 0; ; at += 1) {
    const start = text.slice(0, at).trimEnd() + (at ? " " : ""), rest = text.slice(at);
    const [, name = "", inner = "", closed = "", after = ""] = /^\s*([a-z]+(?: [a-z]+)?)\s*\(([^()]*)(\)?)\s*(.?)/.exec(rest) ?? [];
    if (!name || !names.includes(name)) {
      const begun = rest.trim(), next = names.filter((one) => one.startsWith(begun)).map((word) => ({ word, text: `${start}${opened(word, grammar)}` }));
      return { parts, next, problem: next.length ? "Choose a relation" : `“${name || begun}” is not a relation: ${names.join(", ")}` };
    }
    const words = inner.split(",").map((word) => word.trim().replace(/\s+/g, " ")
      .replace(/^([a-z]+) ?(!?=) ?/, (found, test, sign) => isTest(test) ? test + sign : found)).filter(Boolean);
    const { part, done, options } = filled(name, words, grammar), given = words.slice(0, done);
    if (done < words.length || !closed) {
      const begun = words[done] ?? "", fits = words.length - done > 1 || closed ? [] : options.filter((one) => one.startsWith(begun));
      const next = fits.map((word) => ({ word, text: `${start}${name}(${[...given, word].join(", ")}${filled(name, [...given, word], grammar).options.length ? "" : ")"}` }));
      if (part && !begun && !closed) next.unshift({ word: END, text: `${start}${name}(${given.join(", ")})` });
      return { parts, next, problem: next.length ? `Complete ${name}(…)` : `“${begun}” is out of place in ${name}(…)${options.length ? `: there could be ${listed(options)}` : ""}` };
    }
    if (!part) return { parts, next: [], problem: `${name}(${inner}) lacks one of ${listed(options)}` };
    parts.push(part);
    at += /** @type {RegExpExecArray} */ (/^[^)]*\)\s*/.exec(rest))[0].length;
    if (after === "") return { parts, next: names.map((word) => ({ word, text: `${text.trimEnd()} & ${opened(word, grammar)}` })), problem: ruled(parts, grammar) };
    if (after !== "&") return { parts, next: [], problem: `“${text.slice(at)}” is out of place: only & and another relation can follow` };
  }
}

/** A relation with its bracket, which is closed if it has no arguments. @param {string} name @param {Grammar} grammar */
const opened = (name, grammar) => `${name}(${filled(name, [], grammar).options.length ? "" : ")"}`;

/** What is wrong with complete relations together; "" if nothing. @param {Part[]} parts @param {Grammar} grammar */
function ruled(parts, grammar) {
  try {
    canonical(parts, grammar);
    return "";
  } catch (error) {
    return /** @type {Error} */ (error).message;
  }
}

/**
 * A relation with the words in its brackets. part: null if it is not complete; done: the number of words that fit; options: what may follow them.
 * @param {string} relation @param {string[]} words @param {Grammar} grammar
 * @returns {{part: Part | null, done: number, options: string[]}}
 */
function filled(relation, words, { relations, tests, pairs }) {
  const { arguments: all, quantified, ofBlocks, prefix } = relations[relation], part = /** @type {Part} */ ({ relation, tests: [], argument: "", number: 0, some: false });
  let done = 0;
  const taken = (/** @type {string[]} */ options) => options.includes(words[done]) ? words[done++] : null;
  const stopped = (/** @type {string[]} */ options) => ({ part: null, done, options });
  const ends = all.length > 1 || all[0] ? all.map((value) => prefix + value) : [];
  if (relation === "exactly") {
    const number = taken(DIGITS);
    if (!number) return stopped(DIGITS);
    part.number = Number(number);
  }
  if (quantified && words[done] === ANY) part.some = Boolean(taken([ANY]));
  let further = /** @type {string[]} */ ([]);
  if (ofBlocks) {
    const selectors = [ALL, OTHERS, ...Object.keys(tests)], first = taken(selectors);
    if (!first) return stopped([...quantified && !part.some ? [ANY] : [], ...selectors]);
    if (first === OTHERS) part.tests = [{ name: OTHERS, value: "", equal: true }];
    else if (first !== ALL) {
      const { name } = tests[first], partners = pairs.filter((pair) => pair.includes(name)).flat().filter((one) => one !== name);
      further = Object.keys(tests).filter((text) => partners.includes(tests[text].name));
      const second = taken(further);
      const chosen = second ? [first, second] : [first];
      part.tests = Object.keys(tests).filter((text) => chosen.includes(text)).map((text) => tests[text]);
      if (second) further = [];
    }
  }
  if (!ends.length) return { part, done, options: further };
  const word = words[done]?.startsWith(prefix) ? prefix + words[done].slice(prefix.length).trim() : "";
  if (!ends.includes(word)) return stopped([...ends, ...further]);
  return { part: { ...part, argument: word.slice(prefix.length) }, done: done + 1, options: [] };
}

/** The canonical form of an intent: in order, without relations that follow from others. @param {Part[]} parts @param {Grammar} grammar @returns {Intent} */
function canonical(parts, grammar) {
  const names = Object.keys(grammar.relations), text = (/** @type {Part} */ part) => partText(part, grammar);
  const kept = withoutRepetition(parts.map((part) => ({ ...part, some: part.some && !namesOne(part) })), grammar);
  kept.sort((a, b) => names.indexOf(a.relation) - names.indexOf(b.relation) || (text(a) < text(b) ? -1 : 1));
  if (kept.length > grammar.most) throw new Error(`An intent has at most ${grammar.most} relations, and this has ${kept.length}`);
  const naming = kept.filter((part) => grammar.relations[part.relation].ofBlocks && !isRest(part));
  if (!kept.some(isRest)) return kept;
  if (!naming.length && kept.length > 1) return canonical(kept.map((part) => isRest(part) ? { ...part, tests: [] } : part), grammar);
  const hasAll = naming.some(({ tests }) => !tests.length);
  if (kept.length > 1 && !hasAll) return kept;
  throw new Error(`Others are the blocks that no other relation selects: ${hasAll ? "another relation selects all blocks" : "add a relation that selects some"}`);
}

/** @param {Part[]} parts @param {Grammar} grammar */
function withoutRepetition(parts, grammar) {
  const text = (/** @type {Part} */ part) => partText(part, grammar), all = Object.fromEntries(parts.map((part) => [text(part), part]));
  let kept = Object.values(all);
  const withOthers = kept.some(isRest);
  for (const name of Object.keys(all).sort()) {
    const rest = kept.filter((other) => text(other) !== name);
    const follows = (/** @type {Part} */ other) => (!withOthers || narrower(all[name], other)) && implies(other, all[name], grammar) && appliesWhere(all[name], other, grammar);
    if (rest.some(follows)) kept = rest;
  }
  return kept;
}

/** Whether the form of two relations shows that the other holds if one does. @param {Part} one @param {Part} other @param {Grammar} grammar */
function implies(one, other, { relations }) {
  if (one.relation === "exactly" && other.relation === "in") return other.some && other.argument === "region" && narrower(one, other);
  const isNear = one.relation === "corner" && other.relation === "near corner";
  if ((one.relation !== other.relation && !isNear) || one.number !== other.number || isRest(one) || isRest(other)) return false;
  if (one.argument !== other.argument && (other.argument !== ANY || !["wall", "corner", "robot wall"].includes(one.relation))) return false;
  const { each, ofBlocks } = relations[one.relation];
  if (!each) return !ofBlocks;
  return other.some ? narrower(one, other) : !one.some && narrower(other, one);
}

/** Whether all blocks of one selector are also blocks of the other. @param {Part} one @param {Part} other */
function narrower(one, other) {
  if (blocksText(one) === blocksText(other)) return true;
  return !isRest(one) && !isRest(other) && other.tests.every((wider) => one.tests.some((test) => passes(test, wider)));
}

/** Whether every block that passes a test also passes a wider one. @param {Test} test @param {Test} wider */
function passes(test, wider) {
  if (testText(test) === testText(wider)) return true;
  if (test.name !== wider.name) return false;
  if (test.name === "starts") return wider.value === "in" && ["matched", "mismatched"].includes(test.value);
  if (test.name === "like") {
    const [strict, loose] = test.equal ? [test, wider] : [wider, test];
    return test.equal === wider.equal && strict.value === "both" && loose.value !== "both";
  }
  return ["colour", "shape"].includes(test.name) && test.equal && !wider.equal && test.value !== wider.value && ![test.value, wider.value].includes("region");
}

/** Whether a relation that follows from another applies to an object wherever the other does. @param {Part} part @param {Part} other @param {Grammar} grammar */
function appliesWhere(part, other, { relations }) {
  if (blocksText(part) === blocksText(other) || part.some) return true;
  return part.tests.every(({ name, value }) => ["colour", "shape"].includes(name) && value !== "region") && relations[part.relation].least === 0;
}

/** An intent in English. @param {Part[]} intent @param {Grammar} grammar */
export function sentenceOf(intent, grammar) {
  const last = (/** @type {Part} */ part) => 2 * Number(isRest(part)) + Number(part.relation === "untouched");
  const clauses = [...intent].sort((a, b) => last(a) - last(b)).map((part) => clauseOf(part, intent, grammar)), final = clauses.pop() ?? "";
  const text = clauses.length ? `${clauses.join(", ")}, and ${final}` : final;
  return `${text[0].toUpperCase()}${text.slice(1)}.`;
}

/** One relation of an intent in English. @param {Part} part @param {Part[]} intent @param {Grammar} grammar */
export function clauseOf(part, intent, { relations, words }) {
  const { relation, tests, argument, number, some } = part, { ofBlocks } = relations[relation], isSingle = namesOne(part);
  const startsIn = tests.some(({ name, value }) => name === "starts" && value !== "out");
  const isOne = some || isSingle || number === 1 || !ofBlocks, [singular, plural] = words.nouns[blocksText(part)];
  const blocks = !ofBlocks ? "" : number ? `exactly ${words.numbers[number]} ${number > 1 ? plural : singular}`
    : isSingle ? `the ${singular}` : some ? `at least one ${singular}` : `all ${plural}`;
  const several = intent.some((one) => one.argument === HOME || one.tests.some(({ value }) => ["matched", "mismatched"].includes(value)));
  const side = (/** @type {string} */ kind) => argument !== ANY ? `the ${argument} ${kind}` : isOne ? `a ${kind}` : `${kind}s`;
  /** @type {Record<string, string>} */
  const filling = { argument, blocks, any: blocks.replace(/^all /, "any "), they: isOne ? "it" : "they", are: isOne ? "is" : "are",
    wall: side("wall"), corner: side("corner"), reference: words.references[argument], region: several ? "a region" : "the region" };
  const clause = words.clauses[argument === HOME ? HOME : relation === "in" && startsIn ? "kept" : relation], [verb, rest] = clause.split("{blocks}");
  const isLast = words.last.some((word) => blocks.includes(word)) && rest && !/\{(they|are)\}/.test(rest);
  const text = (isLast ? `${verb}${rest.trim()} {blocks}` : clause).replace(/\{(\w+)\}/g, (_, name) => filling[name]);
  return text.replace(new RegExp(`(${words.pause}) (?=\\w)`), "$1, ");
}
