// @ts-check
/**
 * Writes the model of any scene as MJCF: the file of `magical_mj.export_mjcf`. A test compares both.
 * Its parts are taken from a sample by Python, which has an object of each kind, and the default dynamics.
 * @typedef {import("./scene.js").Scene} Scene
 * @typedef {{x: number, y: number, angle: number}} Pose
 * @typedef {{line: number, dash: number, heights: number[]}} RegionStyle
 */
import { writeScene } from "./scenefile.js";

const SPEEDS = `Actions are speeds: write into ctrl the speeds of
    both wheels (units/s), of both rotors (rad/s) and, with fingers, of both finger motors (rad/s)`;

/**
 * The model of a scene.
 * @param {string} sample  with the scene's body and arena @param {Scene} scene @param {RegionStyle} style
 * @param {{task?: string, horizon?: number, speeds?: boolean}} [about]  of an episode; speeds: whether actions are speeds
 */
export function mjcfOf(sample, scene, style, { task, horizon, speeds } = {}) {
  const { robot, blocks, regions, pebbles = [] } = scene;
  const sampled = JSON.parse(/<text name="scene" data='([^']*)'/.exec(sample)?.[1] ?? "{}"), { veer = 0, ...dynamics } = scene.dynamics ?? {};
  const caps = Object.fromEntries(Object.entries(sampled.dynamics).map(([name, value]) => [name, (dynamics[name] ?? value) / Number(value)]));
  /** @type {Record<string, string>} */
  const parts = {};
  let text = sample;
  const cut = (/** @type {string} */ name, /** @type {RegExp} */ pattern) => {
    text = text.replace(pattern, (found) => {
      parts[name] = found;
      return `@${name}@`;
    });
  };
  cut("regions", /\n *<!-- Goal region 0[^]*?(?=\n *<\/body>)/);
  cut("blocks", /\n *<!-- Block 0[^]*?(?=\n *<!-- The robot -->)/);
  cut("robot", /\n *<!-- The robot -->[^]*?(?=\n *<!-- Pebble 0)/);
  cut("pebbles", /\n *<!-- Pebble 0[^]*?(?=\n *<\/worldbody>)/);
  cut("blockPairs", /\n *<pair name="block0[^]*?(?=\n *<!-- The wheels)/);
  cut("pebblePairs", /\n *<pair name="pebble0[^]*?\/>/);
  cut("sensors", /\n *<jointpos[^]*?(?=\n *<\/sensor>)/);
  cut("state", /(?<=<key name="now") [^]*?(?=\/>)/);
  cut("borders", /\n *<mesh name="region0_border[^]*?(?=\n *<\/asset>)/);
  const kinds = Object.fromEntries(parts.blocks.split(/(?=\n *<!-- Block)/).map((one) => [/: \w+, (\w+) -->/.exec(one)?.[1], one]));
  const [region] = parts.regions.split(/(?=\n *<!-- Goal region 1)/), [pair] = parts.blockPairs.split(/(?=\n *<pair name="block1)/);
  if (blocks.some(({ mass }) => mass !== sampled.blocks[0].mass)) throw new Error("This page can simulate only blocks with the mass of this arena");
  const fill = {
    regions: regions.map((one, i) => regionMjcf(region, i, one, style)).join(""),
    blocks: blocks.map((block, i) => {
      const named = recoloured(kinds[block.shape].replace(/([Bb]lock ?)\d/g, `$1${i}`), block.colour);
      return scaled(planar(named, `block${i}`, block), `joint name="block${i}_angle"`, "frictionloss", caps.block_friction_torque);
    }).join(""),
    robot: robotMjcf(parts.robot, robot),
    pebbles: pebbles.map((pebble, i) => planar(parts.pebbles.replace(/(pebble|Pebble )0/g, `$1${i}`), `pebble${i}`, { ...pebble, angle: 0 })).join(""),
    blockPairs: blocks.map((_, i) => scaled(pair.replace(/block0/g, `block${i}`), "pair", "friction", caps.block_friction_force)).join(""),
    pebblePairs: pebbles.map((_, i) => parts.pebblePairs.replace(/pebble0/g, `pebble${i}`)).join(""),
    sensors: sensors(parts.sensors, blocks.length, pebbles.length),
    state: state(parts.state, scene),
    borders: regions.map((one, i) => borderMjcf(i, one, style)).join(""),
  };
  text = text.replace(/@(\w+)@/g, (_, name) => fill[/** @type {keyof typeof fill} */ (name)]);
  for (const name of ["wheel", "loaded_wheel"]) text = scaled(text, `pair name="${name}"`, "friction", caps.drive_force);
  for (const name of ["rotor", "loaded_rotor"]) text = scaled(text, `fixed name="${name}"`, "frictionloss", caps.turn_torque);
  for (const name of ["left_motor", "right_motor"]) text = scaled(text, `fixed name="${name}"`, "frictionloss", caps.finger_torque);
  text = text.replace(/(<numeric name="controls" data=")([^"]*)/, (_, start, rows) => start + rows.trim().split("\n").map((/** @type {string} */ row) => {
    const [speed, loaded, turn, loadedTurn, ...grip] = numbersIn(row);
    return `\n        ${[speed, loaded, turn + veer * speed, loadedTurn + veer * loaded, ...grip].join(" ")}`;
  }).join(""));
  const episode = task ? `<text name="task" data="${task}"/>\n    <text name="rules" data="paper"/>\n    <numeric name="horizon" data="${horizon}"/>\n    ` : "";
  text = text.replace(/<text name="scene"[^]*?\/>/, () => `${episode}<text name="scene" data='${writeScene(scene)}'/>`);
  if (task) text = text.replace("A scene, as", `${task}, as`);
  if (speeds) {
    text = text.replace(/\n *<numeric name="controls"[^>]*\/>/, "").replace(/"controls": a row[^]*?(?= -->)/, SPEEDS);
    text = text.replace('its row of the numeric "controls"', "its speeds");
  }
  return used(text);
}

/** @param {string} text */
const numbersIn = (text) => text.trim().split(/\s+/).map(Number);

/** Sets attributes of the first element that starts in this way. @param {string} text @param {string} start @param {Record<string, number[]>} values */
function set(text, start, values) {
  return text.replace(new RegExp(`<${start}[^>]*`), (tag) => Object.entries(values).reduce(
    (tag, [name, list]) => tag.replace(new RegExp(`(?<=\\s${name}=)"[^"]*"`), `"${list.join(" ")}"`), tag));
}

/** Multiplies an attribute of the first element that starts in this way. @param {string} text @param {string} start @param {string} name @param {number} by */
function scaled(text, start, name, by) {
  const [, values] = new RegExp(`<${start}[^>]*\\s${name}="([^"]*)"`).exec(text) ?? [];
  return values ? set(text, start, { [name]: numbersIn(values).map((value) => value * by) }) : text;
}

/** The quaternion of a turn. @param {number} angle */
const quaternion = (angle) => [Math.cos(angle / 2), 0, 0, Math.sin(angle / 2)];

/** A body with planar joints, at another pose. @param {string} text @param {string} name @param {Pose} pose */
function planar(text, name, { x, y, angle }) {
  const cosine = Math.cos(angle), sine = Math.sin(angle);
  return [
    [`body name="${name}"`, { pos: [x, y, 0], quat: quaternion(angle) }], [`joint name="${name}_x"`, { axis: [cosine, -sine, 0], ref: [x] }],
    [`joint name="${name}_y"`, { axis: [sine, cosine, 0], ref: [y] }], [`joint name="${name}_angle"`, { ref: [angle] }],
  ].reduce((text, [start, values]) => set(text, String(start), /** @type {any} */ (values)), text);
}

/** @param {string} text @param {Scene["robot"]} robot */
function robotMjcf(text, robot) {
  return ["left", "right"].reduce((text, side, i) => set(set(
    text, `body name="${side}_finger"`, { quat: quaternion(robot.fingers[i]) }), `joint name="${side}_finger"`, { ref: [robot.fingers[i]] }),
  planar(text, "robot", robot));
}

/** @param {string} text @param {string} colour */
const recoloured = (text, colour) => text.replace(/(?<=["_ ])(red|green|blue|yellow)(?=[_,]| -->)/g, colour);

/** @param {string} text @param {number} i @param {import("./scene.js").Region} region @param {RegionStyle} style */
function regionMjcf(text, i, { colour, x_min, y_min, x_max, y_max }, { heights: [ground, step] }) {
  const named = recoloured(text.replace(/region0|region 0/g, (one) => one.replace("0", String(i))), colour);
  return set(named, "geom", { pos: [(x_min + x_max) / 2, (y_min + y_max) / 2, ground + i * step], size: [(x_max - x_min) / 2, (y_max - y_min) / 2, 1] });
}

/** The mesh of a region's border. @param {number} i @param {import("./scene.js").Region} region @param {RegionStyle} style */
function borderMjcf(i, region, style) {
  const [ground, step, above] = style.heights, quads = dashes(region, style), z = ground + i * step + above;
  const vertices = quads.flat().flatMap(([x, y]) => [x, y, z]).map(Math.fround), faces = quads.flatMap((_, k) => [0, 1, 2, 0, 2, 3].map((corner) => 4 * k + corner));
  return `\n    <mesh name="region${i}_border" inertia="shell" vertex="${vertices.join(" ")}" face="${faces.join(" ")}"/>`;
}

/**
 * The corners of each dash of a border, clockwise from the top left corner; a dash around a corner is two quads. A solid border has one for each side.
 * @param {import("./scene.js").Region} region @param {RegionStyle} style
 */
function dashes({ x_min: x0, y_min: y0, x_max: x1, y_max: y1, border }, { line, dash }) {
  const sides = [[x0, y1, 1, 0, x1 - x0], [x1, y1, 0, -1, y1 - y0], [x1, y0, -1, 0, x1 - x0], [x0, y0, 0, 1, y1 - y0]], half = line / 2;
  const ends = sides.reduce((/** @type {number[]} */ sums, side) => [...sums, (sums.at(-1) ?? 0) + side[4]], []);
  const starts = border === "solid" ? [-1] : Array.from({ length: Math.ceil(ends[3] / (2 * dash)) }, (_, k) => 2 * dash * k);
  return starts.flatMap((start) => sides.flatMap(([x, y, ahead, up, length], i) => {
    const end = border === "solid" ? ends[3] : start + dash, begin = ends[i] - length;
    if (Math.min(end, ends[i]) <= Math.max(start, begin)) return [];
    const first = Math.max(start, begin) - (start < begin ? half : 0) - begin, last = Math.min(end, ends[i]) + (end > ends[i] && i < 3 ? half : 0) - begin;
    const out = [-up * half, ahead * half];  // from the centre line to the outer edge
    return [[[first, -1], [last, -1], [last, 1], [first, 1]].map(([along, side]) => [x + along * ahead + side * out[0], y + along * up + side * out[1]])];
  }));
}

/** The sensors of another number of objects. @param {string} sample @param {number} blocks @param {number} pebbles */
function sensors(sample, blocks, pebbles) {
  const lines = sample.split(/(?=\n)/), ofRobot = lines.filter((line) => !/block|pebble/.test(line));
  const some = (/** @type {string} */ name, /** @type {string} */ kind, /** @type {number} */ count) => Array.from({ length: count }, (_, i) => lines.filter(
    (line) => line.includes(`${name}0_`) && line.includes(kind)).map((line) => line.replaceAll(`${name}0`, `${name}${i}`))).flat();
  return ["jointpos", "jointvel"].flatMap((kind) => [...ofRobot.filter((line) => line.includes(kind)), ...some("block", kind, blocks), ...some("pebble", kind, pebbles)]).join("");
}

/** The attributes of the keyframe with the initial state. @param {string} sample @param {Scene} scene */
function state(sample, { robot, blocks, pebbles = [] }) {
  const values = (/** @type {string} */ name) => numbersIn(new RegExp(`${name}="([^"]*)"`).exec(sample)?.[1] ?? "");
  const own = values("qpos").slice(12, -3), { length } = own;  // the sample has four blocks and a pebble
  own.splice(0, 3, robot.x, robot.y, robot.angle);
  if (length > 9) own.splice(-2, 2, ...robot.fingers);
  const qpos = [...blocks.flatMap(({ x, y, angle }) => [x, y, angle]), ...own, ...pebbles.flatMap(({ x, y }) => [x, y, 0])];
  return ` time="0" qpos="${qpos.join(" ")}" qvel="${qpos.map(() => 0).join(" ")}"${sample.slice(sample.indexOf(" act="))}`;
}

/** The same model without materials and meshes that nothing uses. @param {string} text */
function used(text) {
  const names = new Set([...text.matchAll(/\s(?:material|mesh)="([^"]*)"/g)].map(([, name]) => name));
  return text.replace(/\n *<(?:material|mesh) name="([^"]*)"[^>]*\/>/g, (all, name) => names.has(name) ? all : "");
}
