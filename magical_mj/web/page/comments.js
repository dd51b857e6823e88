// @ts-check
/**
 * The comments in a model file about its bodies and geoms: those before bodies and before classes of geoms.
 * @typedef {{file: string, bodies: string[], geoms: string[]}} Comments  by MuJoCo's ids; "" without a comment
 */

/** The descendants of an element with this name. @param {Element} parent @param {string} name */
const children = (parent, name) => [...parent.children].filter(({ tagName }) => tagName === name);

/**
 * Reads a file's comments. Ids follow from the order in the file. If the compiled model has more bodies or geoms than the
 * file lists, for example from includes, the result is empty.
 * @param {string} text  MJCF
 * @param {number} bodyCount  of the compiled model
 * @param {number} geomCount
 * @returns {Comments}
 */
export function readComments(text, bodyCount, geomCount) {
  const root = new DOMParser().parseFromString(text, "text/xml");
  const file = [...root.childNodes].filter((node) => node instanceof Comment).map(words).join("\n\n");
  const world = root.querySelector("worldbody");
  if (!world) return { file, bodies: [], geoms: [] };
  const bodies = [world, ...world.querySelectorAll("body")];
  const geoms = bodies.flatMap((body) => children(body, "geom"));
  const classes = new Map([...root.querySelectorAll("default[class]")].map((one) => [one.getAttribute("class"), before(one)]));
  return {
    file,
    bodies: bodies.length === bodyCount ? bodies.map((body) => body === world ? "The world" : before(body)) : [],
    geoms: geoms.length === geomCount ? geoms.map((geom) => classes.get(geom.getAttribute("class")) ?? "") : [],
  };
}

/** The texts under `<custom>`, by name. @param {string} text  MJCF @returns {Record<string, string>} */
export function readTexts(text) {
  const texts = new DOMParser().parseFromString(text, "text/xml").querySelectorAll("mujoco > custom > text");
  return Object.fromEntries([...texts].map((one) => [one.getAttribute("name") ?? "", one.getAttribute("data") ?? ""]));
}

/** The comment before an element, or before the sequence of similar elements that contains it. @param {Element} element */
function before(element) {
  for (let node = element.previousSibling; node; node = node.previousSibling) {
    if (node instanceof Comment) return words(node);
    if (node instanceof Element && node.tagName !== element.tagName) return "";
  }
  return "";
}

/** @param {Node} comment */
const words = (comment) => (comment.nodeValue ?? "").trim().replace(/[ \t]+/g, " ");
