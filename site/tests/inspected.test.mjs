/** The files of models that the page for inspecting opens. */
import assert from "node:assert/strict";
import test from "node:test";

import loadMujoco from "../../out/npm/node_modules/@mujoco/mujoco/mujoco.js";
import { placed } from "../../magical_mj/web/page/inspected.js";

const mujoco = await loadMujoco();
const encode = (/** @type {string} */ text) => new TextEncoder().encode(text);

/** A tetrahedron with this edge, as OBJ. @param {number} edge */
const solid = (edge) => encode(`v 0 0 0\nv ${edge} 0 0\nv 0 ${edge} 0\nv 0 0 ${edge}\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n`);

/** A model with meshes of these files. @param {string[]} files @param {string} [settings] */
const withMeshes = (files, settings = "") => `<mujoco>${settings}<asset>${files.map((file, i) => `<mesh name="${i}" file="${file}"/>`).join("")}</asset>
  <worldbody>${files.map((_, i) => `<body><freejoint/><geom type="mesh" mesh="${i}"/></body>`).join("")}</worldbody></mujoco>`;

/** The masses of the bodies. @param {string} text @param {Record<string, Uint8Array>} files @param {boolean} [isFlat] */
function masses(text, files, isFlat = false) {
  const vfs = new mujoco.MjVFS();
  for (const [path, content] of placed(text, new Map(Object.entries(files)), isFlat)) vfs.addBuffer(path, content);
  const model = mujoco.MjModel.from_xml_string(text, vfs), found = [...model.body_mass].slice(1);
  model.delete();
  vfs.delete();
  return found;
}

test("meshes with one name in two folders stay apart", () => {
  const files = { "shapes/m/base.obj": solid(0.1), "shapes/n/base.obj": solid(0.2) };
  const [small, large] = masses(withMeshes(["m/base.obj", "./m/../n/base.obj"], '<compiler meshdir="shapes"/>'), files);
  assert.ok(Math.abs(large / small - 8) < 1e-3);
});

test("dropped files, which have no folders, are found by their names unless two have the same", () => {
  const one = { "base.obj": solid(0.1) };
  assert.equal(masses(withMeshes(["m/base.obj", "./m/base.obj"], '<compiler meshdir="shapes"/>'), one, true).length, 2);
  assert.throws(() => masses(withMeshes(["m/base.obj", "n/base.obj"]), one, true), /two files with the name base.obj: m\/base.obj and n\/base.obj/);
});
