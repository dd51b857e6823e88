// @ts-check
/** Compares the page's simulation, scores and pictures with Python's, on the cases of cases.py. */
import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { readFile } from "node:fs/promises";
import { test } from "node:test";
import loadMujoco from "../../out/npm/node_modules/@mujoco/mujoco/mujoco.js";
import * as ort from "../../out/npm/node_modules/onnxruntime-web/dist/ort.wasm.min.mjs";
import { taking } from "../../magical_mj/web/page/actions.js";
import { faults, label } from "../../magical_mj/web/page/legal.js";
import { mjcfOf } from "../../magical_mj/web/page/mjcf.js";
import { Policy } from "../../magical_mj/web/page/policy.js";
import { pursued } from "../../magical_mj/web/page/pursued.js";
import { firstReached } from "../../magical_mj/web/page/rivals.js";
import { poses } from "../../magical_mj/web/page/scene.js";
import { readScene, writeScene } from "../../magical_mj/web/page/scenefile.js";
import { lack, score } from "../../magical_mj/web/page/score.js";
import { Simulation } from "../../magical_mj/web/page/simulation.js";

/** Compared arrays and numbers of models. */
const MODEL = ["nq", "nbody", "ngeom", "nmesh", "nmat", "npair", "ntendon", "nsensor", "names", "body_pos", "body_quat", "body_mass", "body_inertia", "jnt_type", "jnt_axis",
  "qpos0", "dof_frictionloss", "geom_type", "geom_size", "geom_pos", "geom_quat", "geom_rgba", "geom_matid", "geom_dataid", "geom_contype", "geom_friction", "mat_rgba",
  "mesh_vert", "mesh_face", "pair_friction", "pair_solref", "tendon_frictionloss", "key_qpos", "key_ctrl", "numeric_data", "sensor_objid"];

/** Parts of the sentences about what an episode pursued. */
const KINDS = ["It did what was intended.", "as intended, but", "It also moved", "It moved no block", "began where the", "began where a block", "colour of", "shape of", "the colour and the shape",
  "nearest to the robot", "is unlike", "stayed where it began", "where the demonstrations' region was", "drove elsewhere", "Intended: the goal region", "Intended: a ", "another ", "all blocks", "two "];

/** @param {string} name */
const read = async (name) => JSON.parse(await readFile(new URL(`../../out/site-test/${name}.json`, import.meta.url), "utf8"));

/** The largest difference of two scenes' poses. @param {any} one @param {any} other */
function distance(one, other) {
  const numbers = (/** @type {any} */ scene) => Object.values(poses(scene)).flat(2);
  const [a, b] = [numbers(one), numbers(other)];
  return Math.max(...a.map((value, i) => Math.abs(value - b[i])));
}

test("scores equal Python's", async () => {
  const cases = await read("scores");
  let worst = 0, worstOfReference = 0;
  for (const { task, initial, final, score: right, reference = right } of cases) {
    const found = score(task, initial, final);
    worst = Math.max(worst, Math.abs(found - right));
    worstOfReference = Math.max(worstOfReference, Math.abs(found - reference));
  }
  console.log(`${cases.length} states: scores differ from Python's by at most ${worst}, from the reference's by ${worstOfReference}`);
  assert.ok(worst < 1e-12 && worstOfReference < 1e-8);
});

test("what an episode pursued equals Python's", async () => {
  const [cases, demonstrated, grammar, rivals] = await Promise.all([read("pursuits"), read("demonstrated"), read("../site/play/intents"), read("../site/play/rivals")]);
  const kinds = new Set(), reached = new Set();
  for (const { task, initial, final, score: points, pursued: right, rival } of cases) {
    assert.equal(firstReached(rivals[task], grammar, initial, final), rival, task);
    reached.add(rival);
    assert.deepEqual(pursued(task, demonstrated[task], initial, final, points), right, task);
    for (const part of KINDS) if (right.sentence.includes(part)) kinds.add(part);
  }
  console.log(`${cases.length} episodes, ${new Set(cases.map((/** @type {any} */ one) => one.pursued.sentence)).size} different sentences, ${reached.size} rivals`);
  assert.ok(reached.size > 20);
  assert.deepEqual([...kinds].sort(), [...KINDS].sort());
});

test("episodes equal Python's", async () => {
  const [mujoco, episodes] = await Promise.all([loadMujoco(), read("episodes")]);
  const kinds = { demonstration: 0, expert: 0, "rough drive": 0.02, "shifted drive": 0.02 };  // the share of episodes with another score: heaps of blocks are chaotic
  for (const [kind, share] of Object.entries(kinds)) {
    const chosen = episodes.filter((/** @type {any} */ { name }) => name.startsWith(kind));
    /** @type {Record<string, number>} */
    const worst = { 1: 0, 20: 0, 100: 0, end: 0 };
    const unequal = [];
    for (const { name, task, scene, mjcf, taken, actions, glances, score: right } of chosen) {
      const simulation = new Simulation(mujoco, mjcf, scene), [done = (/** @type {any} */ action) => action] = taken?.map(taking) ?? [];
      let now = scene;
      actions.forEach((/** @type {number | number[]} */ action, /** @type {number} */ i) => {
        now = simulation.act(done(action));
        if (!(i + 1 in glances)) return;
        const moment = i + 1 === actions.length ? "end" : i + 1;
        worst[moment] = Math.max(worst[moment], distance(now, glances[i + 1]));
      });
      if (Math.abs(score(task, scene, now) - right) > 1e-4) unequal.push(name);
      simulation.close();
    }
    const figures = Object.entries(worst).map(([step, value]) => `${step}: ${value.toExponential(1)}`).join(", ");
    console.log(`${chosen.length} of ${kind}: largest difference of a pose after steps ${figures}; scores differ in ${unequal.length}`);
    assert.ok(worst[1] < 1e-10 && worst[20] < 1e-6, kind);
    assert.ok(unequal.length <= share * chosen.length, unequal.join(", "));
  }
});

test("states and policies equal Python's", async () => {
  const [mujoco, cases] = await Promise.all([loadMujoco(), read("policies")]);
  ort.env.wasm.numThreads = 1;
  let worst = 0, count = 0;
  for (const { task, scene, mjcf, actions, states, best } of cases) {
    const network = await readFile(new URL(`../policies/${task}.onnx`, import.meta.url));
    const simulation = new Simulation(mujoco, mjcf, scene);
    const policy = await Policy.open(ort, network, simulation);
    for (const [i, state] of states.entries()) {
      const seen = simulation.state();
      worst = Math.max(worst, ...state.map((/** @type {number} */ value, /** @type {number} */ k) => Math.abs(value - seen[k])));
      const values = await policy.think();
      assert.equal(values.indexOf(Math.max(...values)), best[i], `${task}, state ${i}`);
      simulation.act(actions[i]);
      count += 1;
    }
    simulation.close();
  }
  console.log(`${count} states: they differ by at most ${worst.toExponential(1)}, the preferred actions do not`);
  assert.equal(count, 200);
  assert.ok(worst < 1e-6);
});

test("pictures equal those of Python's software renderer, byte for byte", async () => {
  const [mujoco, cases] = await Promise.all([loadMujoco(), read("looks")]);
  let count = 0, taken = 0;
  for (const { name, scene, mjcf, moments } of cases) {
    const simulation = new Simulation(mujoco, mjcf, scene), raster = simulation.raster();
    for (const moment of moments) {
      simulation.data.qpos.set(moment.qpos);
      for (const camera of ["ego", "allo"]) {
        const since = performance.now(), picture = raster.draw(simulation.data, camera, 96);
        taken += performance.now() - since;
        count += 1;
        assert.equal(createHash("sha256").update(picture).digest("hex"), moment[camera], `${name}, ${camera}`);
      }
    }
    simulation.close();
  }
  console.log(`${count} pictures of ${cases.length} scenes are equal; one takes ${(taken / count).toFixed(1)} ms`);
});

test("policies from images choose the same actions as in Python", async () => {
  const [mujoco, cases] = await Promise.all([loadMujoco(), read("looking")]);
  ort.env.wasm.numThreads = 1;
  let count = 0;
  for (const { preset, scene, mjcf, actions, best } of cases) {
    const network = await readFile(new URL(`../../out/site-test/${preset}.onnx`, import.meta.url));
    const simulation = new Simulation(mujoco, mjcf, scene);
    const policy = await Policy.open(ort, network, simulation);
    for (const [i, right] of best.entries()) {
      const values = await policy.think();
      assert.equal(values.indexOf(Math.max(...values)), right, `${preset}, step ${i}`);
      simulation.act(actions[i]);
      count += 1;
    }
    simulation.close();
  }
  console.log(`${count} stacks of pictures: the preferred actions are Python's`);
  assert.ok(count >= 200);
});

test("edited scenes: what is illegal, what tasks lack, and their models equal Python's", async () => {
  const [mujoco, cases, solids, samples, look] = await Promise.all([loadMujoco(), ...["edits", "solids", "samples", "look"].map(read)]);
  let illegal = 0, fitting = 0, compared = 0;
  for (const { scene: text, fault, lacks, mjcf } of cases) {
    const scene = readScene(text, Object.keys(solids.robots)), [first] = faults(scene, solids);
    const named = [...fault?.matchAll(/(?<=^| and )(robot|(?:block|region|pebble) \d+)/g) ?? []].map(([name]) => name);
    assert.deepEqual(first?.names ?? [], named, `${fault} ${first?.words} ${text}`);
    if (first) illegal += 1;
    for (const [task, right] of Object.entries(lacks)) {
      assert.equal(lack(task, scene), right ?? "", `${task}: ${text}`);
      if (right === null) fitting += 1;
    }
    if (!mjcf) continue;
    compared += 1;
    const ours = mjcfOf(samples[`${scene.robot.body ?? "gripper"}-${scene.half_width ?? 1}`], scene, look.regions);
    const [own, right] = [ours, mjcf].map((one) => mujoco.MjModel.from_xml_string(one));
    for (const name of MODEL) {
      const [a, b] = [own[name], right[name]];
      const worst = typeof a === "number" ? Math.abs(a - b) : Math.max(0, Math.abs(a.length - b.length), ...Array.from(a, (value, i) => Math.abs(value - b[i])));
      assert.ok(worst < 1e-12, `${name} differs by ${worst}: ${text}`);
    }
    own.delete();
    right.delete();
  }
  console.log(`${cases.length} scenes, ${illegal} of them illegal; ${fitting} fit a task; ${compared} models are equal`);
  assert.ok(illegal > 300 && fitting > 300 && compared > 60);
  assert.equal(label("block 0", true), "Block 1");
});

test("a scene from Python and back is the same, and what Python refuses is refused", async () => {
  const cases = await read("edits"), bodies = ["gripper", "shortstick", "mediumstick", "longstick"];
  for (const { scene } of cases) {
    const { format, ...plain } = JSON.parse(scene);
    assert.deepEqual(readScene(writeScene(readScene(scene, bodies)), bodies), plain);
  }
  const { accepted, refused } = await read("texts");
  for (const text of accepted) assert.ok(readScene(text, bodies), text);
  for (const text of refused) assert.throws(() => readScene(text, bodies), Error, text);
  assert.ok(refused.length > 20);
});
