// @ts-check
/**
 * Scenes as JSON, as `magical_mj.Scene.to_json` writes them and `Scene.from_json` reads them.
 * @typedef {import("./scene.js").Scene} Scene
 */
const FORMAT = 1, LARGEST = 1e10;
const COLOURS = ["red", "green", "blue", "yellow"], SHAPES = ["square", "pentagon", "star", "circle"];
/** @type {Record<string, string[]>} the possible values of fields that are not numbers */
export const CHOICES = { shape: SHAPES, colour: COLOURS, border: ["dashed", "solid"] };
/** @type {Record<string, [string[], string[]]>} the fields that an object needs, and those that it may have */
const FIELDS = {
  robot: [["x", "y", "angle"], ["fingers", "body"]], blocks: [["shape", "colour", "x", "y", "angle"], ["mass"]],
  regions: [["colour", "x_min", "y_min", "x_max", "y_max"], ["border"]], pebbles: [["x", "y"], []],
  dynamics: [[], ["drive_force", "turn_torque", "finger_torque", "block_friction_force", "block_friction_torque", "veer"]],
  scene: [["robot"], ["blocks", "regions", "dynamics", "half_width", "pebbles"]],
};
const OPEN = Math.PI / 8;  // of a finger, by default

/** A scene as one line of JSON. @param {Scene} scene */
export function writeScene({ stains, ...scene }) {  // stains are only in pictures
  return JSON.stringify({ format: FORMAT, ...scene });
}

/**
 * The scene in a text. Throws an error if `Scene.from_json` would.
 * @param {string} text
 * @param {string[]} bodies  the possible bodies of the robot
 * @returns {Scene}
 */
export function readScene(text, bodies) {
  const { format, ...scene } = check("scene", parsed(text), ["format"]);
  if (format !== FORMAT) throw new Error(`A scene must have "format": ${FORMAT}, as magical_mj.Scene.to_json writes it`);
  const { robot, blocks = [], regions = [], dynamics = {}, half_width: half, pebbles } = scene;
  check("robot", robot);
  check("dynamics", dynamics);
  for (const [name, all] of Object.entries({ blocks, regions, pebbles: pebbles ?? [] })) {
    if (!Array.isArray(all)) throw new Error(`${name} must be a list`);
    for (const one of all) check(name, one);
  }
  const { fingers = [OPEN, -OPEN], body = "gripper" } = robot;
  if (!Array.isArray(fingers) || fingers.length !== 2 || !fingers.every(isNumber)) throw new Error("fingers must be two angles");
  if (!bodies.includes(body)) throw new Error(`The body of a robot must be one of ${bodies.join(", ")}, not ${JSON.stringify(body)}`);
  if (half !== undefined && !(isNumber(half) && half >= 0.5 && half <= 2)) throw new Error("half_width must be in 0.5..2");
  for (const { mass = 1 } of blocks) if (mass <= 0) throw new Error("mass must be positive");
  for (const { x_min, y_min, x_max, y_max } of regions) if (!(x_min < x_max && y_min < y_max)) throw new Error("A region needs x_min < x_max and y_min < y_max");
  for (const [name, value] of Object.entries(dynamics)) if (value <= 0 && name !== "veer") throw new Error(`${name} must be positive`);
  return { ...scene, robot: { ...robot, fingers }, blocks, regions };
}

/** @param {string} text */
function parsed(text) {
  try {
    return JSON.parse(text);
  } catch (error) {
    throw new Error(`A scene must be JSON, as magical_mj.Scene.to_json writes it (${/** @type {Error} */ (error).message})`);
  }
}

/** @param {any} value */
const isNumber = (value) => typeof value === "number" && Math.abs(value) <= LARGEST;

/** Checks the fields of an object, and their types. @param {string} kind @param {any} value @param {string[]} more  further fields @returns {any} */
function check(kind, value, more = []) {
  if (typeof value !== "object" || value === null || Array.isArray(value)) throw new Error(`${kind} must be an object`);
  const [needed, possible] = FIELDS[kind];
  const unknown = Object.keys(value).find((name) => ![...needed, ...possible, ...more].includes(name));
  if (unknown !== undefined) throw new Error(`${kind} must not have a field ${unknown}`);
  const missing = needed.find((name) => !(name in value));
  if (missing) throw new Error(`${kind} lacks the field ${missing}`);
  if (kind === "scene") return value;
  for (const [name, one] of Object.entries(value)) {
    if (name in CHOICES && !CHOICES[name].includes(one)) throw new Error(`${name} must be one of ${CHOICES[name].join(", ")}, not ${JSON.stringify(one)}`);
    if (!(name in CHOICES) && name !== "fingers" && name !== "body" && !isNumber(one)) throw new Error(`${kind}: ${name} must be a number`);
  }
  return value;
}
