// @ts-check
/**
 * The pictures that policies observe: the same bytes as those of magical_mj's software renderer for the same poses. Flat convex polygons
 * are painted in order, with four samples per pixel. Corners are rounded to a grid of 256 x 256 points per sample. All further
 * calculations use integers, which doubles represent exactly.
 */
const GRID = 256, HALF = GRID / 2;
const DRAWN = [0, 2, 4];  // the groups of geoms that are drawn
const MESH = 7;
/** Borders of goal regions: their index, and the corners, four for each dash, as x, y, z. */
const BORDERS = /<mesh name="region(\d+)_border"[^>]*?vertex="([^"]+)"/g;

/** @typedef {{body: number, colour: number, corners: Float64Array}} Polygon  colour: 0xAABBGGRR; corners: u, v, u, v, ... in the body's frame, counter-clockwise */

export class Raster {
  /**
   * @param {any} mujoco  the module
   * @param {any} model  of a scene
   * @param {string} mjcf  its file, with all digits
   * @param {import("./scene.js").Scene} scene
   */
  constructor(mujoco, model, mjcf, scene) {
    if (scene.stains?.length) throw new Error("it acts from images, and these cannot show stains here: choose a scene without clutter");
    this.mujoco = mujoco;
    this.model = model;
    this.polygons = polygonsOf(model, mjcf, scene);
    /** @type {Record<string, number>} */
    this.cameras = Object.fromEntries(["ego", "allo"].map((name) => [name, mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA.value, name)]));
  }

  /**
   * Red, green and blue of each pixel, from the top left.
   * @param {any} data  the state
   * @param {string} camera  "ego" or "allo"
   * @param {number} size  pixels a side
   */
  draw(data, camera, size) {
    this.mujoco.mj_kinematics(this.model, data);  // MuJoCo's step leaves the positions before the step
    this.mujoco.mj_camlight(this.model, data);
    const id = this.cameras[camera], side = 2 * size, field = this.model.cam_fovy[id];
    const view = { position: data.cam_xpos.slice(3 * id, 3 * id + 2), axes: data.cam_xmat.slice(9 * id, 9 * id + 9) };
    const { xpos, xmat } = data;
    const samples = new Uint32Array(side * side);
    for (const { body, colour, corners } of this.polygons) {
      const frame = relative(xpos.subarray(3 * body, 3 * body + 2), xmat.subarray(9 * body, 9 * body + 9), view);
      fill(samples, side, onGrid(corners, frame, GRID * side / field, 0.5 * GRID * side), colour);
    }
    return averaged(samples, size);
  }
}

/**
 * The drawn polygons of a model in drawing order: static ones, then moving ones.
 * @param {any} model @param {string} mjcf @param {import("./scene.js").Scene} scene
 */
function polygonsOf(model, mjcf, { regions }) {
  const borders = [...mjcf.matchAll(BORDERS)].map(([, , text]) => Float64Array.from(text.trim().split(/\s+/), (word) => Math.fround(Number(word))));
  /** @type {Polygon[][]} */
  const kinds = [[], []];
  let region = 0;
  const meshes = [...model.mesh_vertadr];
  const first = meshes.length - borders.length;  // the meshes of borders are the last ones
  for (let geom = 0; geom < model.ngeom; geom++) {
    if (!DRAWN.includes(model.geom_group[geom])) continue;
    const body = model.geom_bodyid[geom], mesh = model.geom_dataid[geom], material = model.geom_matid[geom];
    const colour = packed(model.mat_rgba.subarray(4 * material, 4 * material + 4));
    let parts;
    if (model.geom_type[geom] !== MESH) parts = [filling(regions[region++])];
    else if (mesh >= first) parts = dashes(borders[mesh - first]);
    else parts = convexParts(model, geom, mesh);
    kinds[Number(model.body_weldid[body] !== 0)].push(...parts.map((corners) => ({ body, colour, corners })));
  }
  return kinds.flat();
}

/** A region's corners in single precision, as in environments. @param {import("./scene.js").Region} region */
function filling({ x_min, y_min, x_max, y_max }) {
  return Float64Array.from([x_max, y_max, x_min, y_max, x_min, y_min, x_max, y_min], Math.fround);
}

/** @param {Float64Array} points  x, y, z of four corners of each */
function dashes(points) {
  return Array.from({ length: points.length / 12 }, (_, dash) => flat(points.subarray(12 * dash, 12 * dash + 12)));
}

/** @param {Float64Array} points */
const flat = (points) => points.filter((_, i) => i % 3 < 2);

/**
 * The outlines of a geom's mesh in its body's frame. If they are not convex, its triangles.
 * @param {any} model @param {number} geom @param {number} mesh
 */
function convexParts(model, geom, mesh) {
  const { mesh_vertadr, mesh_vertnum, mesh_vert, mesh_faceadr, mesh_facenum, mesh_face, geom_quat, geom_pos } = model;
  const [w, x, y, z] = geom_quat.subarray(4 * geom, 4 * geom + 4), [px, py] = geom_pos.subarray(3 * geom, 3 * geom + 2);
  const rows = [[w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)], [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)]];
  const vertices = Array.from({ length: mesh_vertnum[mesh] }, (_, i) => {
    const [a, b, c] = mesh_vert.subarray(3 * (mesh_vertadr[mesh] + i), 3 * (mesh_vertadr[mesh] + i + 1));
    return rows.map(([ra, rb, rc], k) => a * ra + b * rb + c * rc + [px, py][k]);
  });
  const faces = Array.from({ length: mesh_facenum[mesh] }, (_, i) => [...mesh_face.subarray(3 * (mesh_faceadr[mesh] + i), 3 * (mesh_faceadr[mesh] + i + 1))]);
  const cornersOf = (/** @type {number[]} */ loop) => Float64Array.from(loop.flatMap((vertex) => vertices[vertex]));
  const outlines = loops(faces).map(cornersOf);
  return outlines.every(isConvex) ? outlines : faces.map(cornersOf);
}

/** The edges of only one triangle, chained into closed loops of vertices. @param {number[][]} faces */
function loops(faces) {
  const edges = faces.flatMap(([a, b, c]) => [[a, b], [b, c], [c, a]]);
  const all = new Set(edges.map(String));
  const after = new Map(edges.filter(([start, end]) => !all.has(String([end, start]))).map(([start, end]) => [start, end]));
  const found = [];
  while (after.size) {
    const loop = [];
    let [at] = after.keys();
    for (let next; (next = after.get(at)) !== undefined; at = next) {
      loop.push(at);
      after.delete(at);
    }
    found.push(loop);
  }
  return found;
}

/** Whether a polygon turns left at each corner. @param {Float64Array} corners */
function isConvex(corners) {
  const n = corners.length, ahead = (/** @type {number} */ i) => [corners[(i + 2) % n] - corners[i % n], corners[(i + 3) % n] - corners[(i + 1) % n]];
  for (let i = 0; i < n; i += 2) {
    const [[ax, ay], [bx, by]] = [ahead(i), ahead(i + 2)];
    if (ax * by - ay * bx <= 0) return false;
  }
  return true;
}

/** Red, green and blue in [0, 1] as an opaque pixel 0xAABBGGRR, or 0 if alpha is 0. @param {Float32Array} rgba */
function packed([red, green, blue, alpha]) {
  const level = (/** @type {number} */ value) => Math.floor(255 * value + 0.5);
  return alpha === 0 ? 0 : (255 << 24 | level(blue) << 16 | level(green) << 8 | level(red)) >>> 0;
}

/**
 * The frame of a body, relative to a camera that looks straight down: x, y, cosine and sine of the angle.
 * @param {Float64Array} position @param {Float64Array} axes  of the body @param {{position: Float64Array, axes: Float64Array}} camera
 */
function relative(position, axes, camera) {
  const dx = position[0] - camera.position[0], dy = position[1] - camera.position[1];
  const [cosA, sinA, cosB, sinB] = [camera.axes[0], camera.axes[3], axes[0], axes[3]];
  return [cosA * dx + sinA * dy, cosA * dy - sinA * dx, cosA * cosB + sinA * sinB, cosA * sinB - sinA * cosB];
}

/**
 * A polygon's corners on the picture's grid, y upwards.
 * @param {Float64Array} corners @param {number[]} frame @param {number} scale  steps of the grid per world unit @param {number} middle
 */
function onGrid(corners, [tx, ty, c, s], scale, middle) {
  return corners.map((_, i) => {
    const u = corners[i & ~1], v = corners[i | 1];
    return Math.floor(scale * (i % 2 ? ty + s * u + c * v : tx + c * u - s * v) + middle + 0.5);
  });
}

/** The first sample whose centre is not before a position on the grid. @param {number} position */
const firstCentre = (position) => Math.floor((position + HALF - 1) / GRID);

/**
 * Colours the samples with centres in a convex polygon, including its left and lower edges.
 * @param {Uint32Array} samples  row by row from below @param {number} side  samples in a row
 * @param {Float64Array} corners  x, y, x, y, ... on the grid, counter-clockwise @param {number} colour
 */
function fill(samples, side, corners, colour) {
  const n = corners.length;
  let low = corners[1], high = low;
  for (let i = 3; i < n; i += 2) {
    low = Math.min(low, corners[i]);
    high = Math.max(high, corners[i]);
  }
  const first = Math.max(firstCentre(low), 0), last = Math.min(firstCentre(high), side);
  if (first >= last) return;
  const left = new Int32Array(last), right = new Int32Array(last);
  for (let i = 0; i < n; i += 2) {
    const [xa, ya, xb, yb] = [corners[i], corners[i + 1], corners[(i + 2) % n], corners[(i + 3) % n]];
    if (yb > ya) follow(xa, ya, xb, yb, first, last, side, right);
    else if (yb < ya) follow(xb, yb, xa, ya, first, last, side, left);
  }
  for (let row = first; row < last; row++) if (left[row] < right[row]) samples.fill(colour, row * side + left[row], row * side + right[row]);
}

/**
 * Writes, for each row that an edge crosses, the first sample with a centre not left of it: n / d, rounded up.
 * @param {number} xa @param {number} ya  where the edge begins @param {number} xb @param {number} yb  where it ends, above that
 * @param {number} first @param {number} last @param {number} side @param {Int32Array} ends
 */
function follow(xa, ya, xb, yb, first, last, side, ends) {
  const start = Math.max(firstCentre(ya), first), stop = Math.min(firstCentre(yb), last);
  const dx = xb - xa, dy = yb - ya, d = GRID * dy;
  for (let row = start, n = (xa - HALF) * dy + (GRID * start + HALF - ya) * dx; row < stop; row++, n += GRID * dx) {
    ends[row] = Math.min(Math.max(Math.ceil(n / d), 0), side);
  }
}

/** The picture of painted samples: averaged 2 x 2, rounded, on white paper, top row first. @param {Uint32Array} samples @param {number} size */
function averaged(samples, size) {
  const pixels = new Uint8Array(3 * size * size), side = 2 * size;
  for (let row = 0, at = 0; row < size; row++) {
    for (let column = 0; column < size; column++, at += 3) {
      const below = 2 * (size - 1 - row) * side + 2 * column, above = below + side;
      const four = [samples[below], samples[below + 1], samples[above], samples[above + 1]];
      const mean = (/** @type {number} */ shift) => four.reduce((sum, one) => sum + (one >>> shift & 255), 2) >> 2;
      const paper = 255 - mean(24);
      for (let k = 0; k < 3; k++) pixels[at + k] = mean(8 * k) + paper;
    }
  }
  return pixels;
}
