// @ts-check
/**
 * The scores of the eight tasks and of SweepToTop by the paper's rules, the same as in magical_mj/tasks. Tests compare them.
 * @typedef {import("./scene.js").Scene} Scene
 * @typedef {import("./scene.js").Block} Block
 * @typedef {import("./scene.js").Region} Region
 */

/** @param {Region} region @param {{x: number, y: number}} body */
export const contains = (region, { x, y }) => region.x_min <= x && x <= region.x_max && region.y_min <= y && y <= region.y_max;

/** Indices of the blocks in a region. @param {Region} region @param {Block[]} blocks */
export const inside = (region, blocks) => [...blocks.keys()].filter((i) => contains(region, blocks[i]));

/** @param {Block} one @param {Block} other */
export const alike = (one, other) => one.shape === other.shape && one.colour === other.colour;

/** @type {Record<string, (initial: Scene, final: Scene) => number>} */
const RULES = {
  MoveToCorner(_, { blocks: [block] }) {
    const distance = Math.hypot(block.x + 1, block.y - 1), none = Math.SQRT2, full = Math.SQRT2 / 2;
    return Math.min(1, Math.max(0, (none - distance) / (none - full)));
  },

  MoveToRegion: (_, { regions: [region], robot }) => Number(contains(region, robot)),

  MatchRegions(_, { regions: [region], blocks }) {
    const found = inside(region, blocks);
    if (found.length === 0) return 0;
    const targets = [...blocks.keys()].filter((i) => blocks[i].colour === region.colour);
    const reached = found.filter((i) => targets.includes(i)).length;
    return (reached / targets.length) * (reached / found.length);
  },

  MakeLine(_, { blocks }) {
    const missing = blocks.length - longestLine(blocks);
    return missing === 0 ? 1 : missing === 1 ? 0.5 : 0;
  },

  FindDupe(initial, { regions: [region], blocks }) {
    const [query] = inside(initial.regions[0], initial.blocks);
    const found = inside(region, blocks);
    const right = found.filter((i) => alike(blocks[i], blocks[query]));
    return right.length >= 2 && found.includes(query) ? right.length / found.length : 0;
  },

  FixColour(initial, final) {
    const homes = initial.regions.map((region) => inside(region, initial.blocks));
    const odd = homes.findIndex(([block], i) => initial.blocks[block].colour !== initial.regions[i].colour);
    return Number(final.regions.every((region, i) => {
      const found = inside(region, final.blocks), [own] = homes[i];
      return i === odd ? !found.includes(own) : found.length === 1 && found[0] === own;
    }));
  },

  SweepToTop: (_, { blocks, regions: [zone] }) => blocks.filter((block) => isWithin(zone, block)).length / blocks.length,

  ClusterColour: (_, { blocks }) => clusters(blocks, (block) => block.colour),
  ClusterShape: (_, { blocks }) => clusters(blocks, (block) => block.shape),
};

const count = (/** @type {any[]} */ all) => `but this has ${all.length}`;
/** What a scene with another number of goal regions lacks. @param {Region[]} regions @param {0 | 1} number */
const lacksRegions = (regions, number) => regions.length === number ? "" : `${number ? "exactly one goal region" : "no goal regions"}, ${count(regions)}`;

/** What a scene to cluster lacks. @param {Scene} scene @param {"colour" | "shape"} attribute */
function lacksKinds({ blocks, regions }, attribute) {
  const { size } = new Set(blocks.map((block) => block[attribute]));
  return size < 2 ? `blocks of at least two different ${attribute}s, but this has ${size}` : lacksRegions(regions, 0);
}

/** What scenes need for a task, and what one has instead; "" if it has that. @type {Record<string, (scene: Scene) => string>} */
const NEEDS = {
  MoveToCorner: ({ blocks, regions }) => blocks.length === 1 ? lacksRegions(regions, 0) : `exactly one block, ${count(blocks)}`,

  MoveToRegion: ({ blocks, regions }) => lacksRegions(regions, 1) || (blocks.length ? `no blocks, ${count(blocks)}` : ""),

  MatchRegions: ({ blocks, regions }) => lacksRegions(regions, 1) || (blocks.some(({ colour }) => colour === regions[0].colour) ? ""
    : `at least one block of the goal region's colour, which is ${regions[0].colour}`),

  MakeLine: ({ blocks, regions }) => blocks.length < 3 ? `at least 3 blocks, ${count(blocks)}` : lacksRegions(regions, 0),

  FindDupe({ blocks, regions }) {
    if (regions.length !== 1) return lacksRegions(regions, 1);
    const found = inside(regions[0], blocks), query = blocks[found[0]];
    if (found.length !== 1) return `exactly one block (the query) in the goal region, ${count(found)}`;
    return blocks.filter((block) => alike(block, query)).length > 1 ? "" : `another ${query.colour} ${query.shape}, like the query, outside the goal region`;
  },

  FixColour({ blocks, regions }) {
    if (!regions.length) return "at least one goal region, but this has none";
    const homes = regions.map((region) => inside(region, blocks)), numbers = homes.map(({ length }) => length);
    const isOneEach = numbers.every((number) => number === 1) && new Set(homes.flat()).size === homes.length;
    if (!isOneEach) return `exactly one block of its own in every goal region, but the numbers are [${numbers.join(", ")}]`;
    const odd = homes.filter(([block], i) => blocks[block].colour !== regions[i].colour);
    return odd.length === 1 ? "" : `exactly one block whose colour differs from its goal region's, ${count(odd)}`;
  },

  SweepToTop: ({ blocks, regions }) => lacksRegions(regions, 1) || (blocks.length === 3 ? "" : `three blocks, ${count(blocks)}`),

  ClusterColour: (scene) => lacksKinds(scene, "colour"),
  ClusterShape: (scene) => lacksKinds(scene, "shape"),
};

/** What a scene lacks to be one of a task; "" if nothing, and for other tasks. @param {string} task @param {Scene} scene */
export const lack = (task, scene) => NEEDS[task]?.(scene) ?? "";

/**
 * The score of the final scene, in [0, 1].
 * @param {string} task
 * @param {Scene} initial
 * @param {Scene} final
 */
export const score = (task, initial, final) => RULES[task](initial, final);

const SIZE = 0.12, SQUARE = Math.sqrt(Math.PI) * SIZE / 2, PENTAGON = SIZE * Math.sqrt(Math.PI / (2.5 * Math.sin(0.4 * Math.PI))), STAR = 1.3 * SIZE;
const ring = (/** @type {number} */ corners, /** @type {number} */ radius) => Array.from(
  { length: corners }, (_, i) => [radius * Math.cos(Math.PI / 2 + 2 * Math.PI * i / corners), radius * Math.sin(Math.PI / 2 + 2 * Math.PI * i / corners)]);
/** @type {Record<string, number[][]>} the outermost corners of blocks; a circle has none */
const CORNERS = { square: [[SQUARE, SQUARE], [-SQUARE, SQUARE], [-SQUARE, -SQUARE], [SQUARE, -SQUARE]], pentagon: ring(5, PENTAGON), star: ring(5, STAR), circle: [[0, 0]] };
/** @type {Record<string, number>} the radius of the blocks' rounded margins */
const MARGINS = { square: 0.02 * SQUARE, circle: SIZE };

/** Whether the bounding box of a block is in a region. @param {Region} region @param {Block} block */
function isWithin(region, { shape, x, y, angle }) {
  const margin = MARGINS[shape] ?? 0, cosine = Math.cos(angle), sine = Math.sin(angle);
  return CORNERS[shape].every(([a, b]) => {
    const right = x + cosine * a - sine * b, up = y + sine * a + cosine * b;
    return region.x_min <= right - margin && right + margin <= region.x_max && region.y_min <= up - margin && up + margin <= region.y_max;
  });
}

/** The number of blocks in the longest line. @param {Block[]} blocks */
export function longestLine(blocks) {
  let longest = 1;
  for (const one of blocks) for (const other of blocks.slice(blocks.indexOf(one) + 1)) {
    const length = Math.hypot(other.x - one.x, other.y - one.y);
    if (length === 0) continue;
    const ux = (other.x - one.x) / length, uy = (other.y - one.y) / length;
    const along = blocks.map(({ x, y }) => [x - one.x, y - one.y])
      .filter(([x, y]) => Math.abs(ux * y - uy * x) <= 0.18)
      .map(([x, y]) => ux * x + uy * y)
      .sort((a, b) => a - b);
    let run = 1;
    for (let i = 1; i < along.length; i++) {
      run = along[i] - along[i - 1] <= 0.42 ? run + 1 : 1;
      longest = Math.max(longest, run);
    }
  }
  return longest;
}

/** The share of correct blocks, from 0 for a half of them to 1. @param {Block[]} blocks @param {(block: Block) => string} kind */
function clusters(blocks, kind) {
  const right = rightBlocks(blocks, kind).filter(Boolean);
  return Math.max(0, (right.length / blocks.length - 0.5) / 0.5);
}

/**
 * Whether each block is correct: its squared distance to the centroid of its kind is less than a third of that to any other.
 * @param {Block[]} blocks
 * @param {(block: Block) => string} kind
 */
export function rightBlocks(blocks, kind) {
  const kinds = [...new Set(blocks.map(kind))];
  const centroids = kinds.map((name) => {
    const members = blocks.filter((block) => kind(block) === name);
    const mean = (/** @type {(block: Block) => number} */ of) => members.reduce((sum, block) => sum + of(block), 0) / members.length;
    return [mean(({ x }) => x), mean(({ y }) => y)];
  });
  return blocks.map((block) => {
    const squares = centroids.map(([x, y]) => (block.x - x) ** 2 + (block.y - y) ** 2);
    const own = squares[kinds.indexOf(kind(block))];
    return squares.every((square, i) => kinds[i] === kind(block) || own < square / 3);
  });
}
